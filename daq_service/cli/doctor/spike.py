"""Measure what a coil couples into its sensor, and propose a holdoff, from one strike without a trigger."""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import replace

from analysis.errors import AnalysisError
from analysis.waves.coil_spike import EdgeSpike, SpikeSurvey, measure_coil_spike
from daq_service.cli.doctor.check import Check, build_error_check
from hardware_drivers.daqmx.parameters import DaqmxParameters
from hardware_drivers.errors import ConfigurationError, InstrumentError

HARDWARE_CURE = (
    "put a flyback diode across the coil, screen the PZT's cable, lead coil and sensor wires apart, or let "
    "the ball fall from higher; then look again"
)


def strike_and_survey_coil(parameters: DaqmxParameters, position: str, timeout_s: float) -> SpikeSurvey:
    """Strike once and analyze the complete record for the ringing of the coil.

    Blocks at most about ``timeout_s`` seconds per record: one with the coil at rest, one of the strike.

    Raises
    ------
    InstrumentError
        As for a shot; also if the coil's counter cannot start the acquisition.
    AnalysisError
        The record cannot be analyzed.
    """
    from hardware_drivers.daqmx.pulse_record import FreeInput

    with closing(FreeInput(parameters, position, timeout_s)) as free:
        noise, strike = free.record_quiet_input(), free.strike()
    return measure_coil_spike(
        strike,
        noise,
        pulse_s=parameters.pulse_s,
        fall_s=parameters.fall_s,
        pretrigger_s=parameters.pretrigger_samples / parameters.sample_rate_hz,
        trigger_level_v=parameters.trigger_level_v,
        rising=parameters.trigger_slope == "rising",
    )


def strike_and_check_coil(
    parameters: DaqmxParameters, position: str, timeout_s: float
) -> tuple[Check, SpikeSurvey | None]:
    """Strike a transducer once and assess its coil's spike; return the check and the survey.

    The survey is None if the strike or its analysis failed: an instrument error gives a failed check (a
    warning if only the counter cannot start the board and no holdoff is set), an analysis error a warning.
    """
    name = f"strike {position}: coil's spike"
    try:
        survey = strike_and_survey_coil(parameters, position, timeout_s)
    except InstrumentError as error:
        check = build_error_check(name, error, "fix what failed above, then strike")
        if isinstance(error, ConfigurationError) and parameters.holdoff_s is None:
            # A board that its counter cannot start takes shots all the same.
            check = replace(check, area="rig", state="warn")
        return check, None
    except AnalysisError as error:
        found = f"the record of a complete strike cannot be assessed: {error}"
        return Check("rig", name, "warn", found, "see the log"), None
    return _build_spike_check(name, parameters, survey), survey


def _build_spike_check(name: str, parameters: DaqmxParameters, survey: SpikeSurvey) -> Check:
    """Convert a survey of the coil to a check, with proposed settings in its values.

    Fails if the spike would trigger the record or the holdoff ends too late; warns of any other obstacle.
    """
    holdoff_s, off = parameters.holdoff_s, survey.off
    armed_over = survey.takes_the_trigger if holdoff_s is None else holdoff_s <= off.ringing_s
    too_late = holdoff_s is not None and holdoff_s >= survey.latest_holdoff_s
    is_lost = armed_over or too_late
    wave_text = (
        f"the wave came {_format_time(survey.wave_after_s)} after off with {survey.wave_v:.3g} V"
        if survey.wave_after_s is not None
        else "no wave detected"
    )
    holdoff_text = "no holdoff" if holdoff_s is None else f"held off for {_format_time(holdoff_s)}"
    return Check(
        "rig",
        name,
        "fail" if is_lost else "warn" if survey.obstacle else "ok",
        f"on: {describe_spike(survey.on)}; off: {describe_spike(off)}; {wave_text} (expected "
        f"{_format_time(parameters.fall_s)}); trigger level {parameters.trigger_level_v:g} V, {holdoff_text}",
        _describe_spike_remedy(parameters, survey),
        {
            "on_height_v": survey.on.height_v,
            "off_height_v": off.height_v,
            "off_ringing_s": off.ringing_s,
            "takes_the_trigger": survey.takes_the_trigger,
            "holdoff_s": holdoff_s,
            "latest_holdoff_s": survey.latest_holdoff_s,
            "proposed_holdoff_s": survey.holdoff_s,
            "proposed_ringing_s": None if survey.holdoff_s is None else propose_ringing_s(survey),
            "proposed_trigger_level_v": survey.trigger_level_v,
            "wave_v": survey.wave_v,
            "wave_after_s": survey.wave_after_s,
            "expected_wave_after_s": parameters.fall_s,
        },
    )


def propose_ringing_s(survey: SpikeSurvey) -> float:
    """Compute the setting ``ringing_s`` from a survey: the measured ringing in s, rounded up to 0.1 ms."""
    return math.ceil(survey.off.ringing_s * 1e4) / 1e4


def _describe_spike_remedy(parameters: DaqmxParameters, survey: SpikeSurvey) -> str:
    """Describe the remedy for the obstacle of a survey; without one, the proposed settings."""
    if survey.obstacle == "ringing":
        return (
            f"it rings for {_format_time(survey.off.ringing_s)} and a holdoff ends "
            f"{_format_time(survey.latest_holdoff_s)} after the pulse at the latest: {HARDWARE_CURE}"
        )
    if survey.obstacle == "noise":
        return (
            f"the noise of {survey.noise_rms_v:.3g} V rms reaches the trigger level by itself: check cable, "
            "screen and grounding of the PZT"
        )
    if survey.obstacle == "no_wave":
        return "see whether the striker lifts and falls, then the sensor's cable and trigger_slope"
    level_v = survey.trigger_level_v
    level = "" if level_v is None else f", trigger_level_v = {level_v:g}"
    proposal = f"set holdoff_s = {survey.holdoff_s:g}, ringing_s = {propose_ringing_s(survey):g}{level}"
    return f"{proposal} in [rig.daqmx] (the longest ringing of all transducers)"


def describe_spike(edge: EdgeSpike) -> str:
    """Describe the spike at an edge of the coil's pulse: height (V), duration, ringing, flyback, trigger."""
    if not edge.height_v:
        return "no spike"
    flyback = f", flyback {edge.flyback_v:.3g} V" if edge.flyback_v else ""
    takes = ", takes the trigger" if edge.triggers else ""
    spike = f"spike {edge.height_v:.3g} V for {_format_time(edge.duration_s)}"
    return f"{spike}, rings {_format_time(edge.ringing_s)}{flyback}{takes}"


def _format_time(time_s: float) -> str:
    """Format a time in s with three digits, in us below 1 ms and in ms otherwise."""
    return f"{time_s * 1e6:.3g} us" if 0.0 < time_s < 1e-3 else f"{time_s * 1e3:.3g} ms"
