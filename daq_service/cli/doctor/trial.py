"""Test strikes: on boards one without a trigger, then a normal shot: arm, strike, read, make safe."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

import click
from pydantic import TypeAdapter

from analysis.waves.coil_spike import FITTING_LEVEL, SpikeSurvey
from analysis.waves.features import ShotFeatures
from daq_service.acquisition.shot_features import derive_extraction_settings, extract_shot_features
from daq_service.cli.doctor.check import Check, build_error_check
from daq_service.cli.doctor.spike import strike_and_check_coil
from daq_service.clock import WallClock, parse_utc, read_boot_id
from daq_service.errors import UsageError
from daq_service.rig.open_rig import open_rig
from daq_service.settings.rig import RigSettings
from daq_service.settings.tree import Settings
from daq_service.shared_file import load_module_toml
from hardware_drivers.daqmx.parameters import DaqmxParameters
from hardware_drivers.errors import InstrumentError
from hardware_drivers.measurement import DueSet, MissedShot, Shot, Waveform
from hardware_drivers.methods import SOLITARY_WAVE
from hardware_drivers.take_set import SetPlan, take_set
from simulator.clock import SimulatedClock

PRINT_REQUEST = partial(click.echo, err=True)
REMEDIES = TypeAdapter(dict[str, str]).validate_python(load_module_toml(__file__))


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """Result of a test strike.

    Attributes
    ----------
    features
        Features of the record; None where there is none.
    record
        None where there is none.
    settings
         Instrument settings of the record.
    spike
         Survey of a strike without a trigger; None if not taken.
    """

    position: str
    checks: tuple[Check, ...]
    features: ShotFeatures | None = None
    record: Waveform | None = None
    settings: Mapping[str, float | str] = field(default_factory=dict)
    spike: SpikeSurvey | None = None

    def as_row(self) -> dict[str, Any]:
        """Convert the result to a JSON object: position, features without outline, settings, spike.

        Missing parts are None; checks and record are left out.
        """
        features = self.features
        return {
            "position": self.position,
            "features": features
            and {name: value for name, value in asdict(features).items() if name != "outline"},
            "settings": dict(self.settings),
            "spike": None if self.spike is None else asdict(self.spike),
        }


def check_strike_position(settings: Settings, position: str) -> None:
    """Raise an error for a position that cannot be struck.

    Raises
    ------
    UsageError
        It is no solitary-wave transducer, the rig plays back a recording, or ``dry_run`` is set.
    """
    names = settings.list_positions(SOLITARY_WAVE)
    if position not in names:
        raise UsageError(
            f"--strike is {position!r}; solitary-wave transducers are: {', '.join(names) or 'none'}"
        )
    if settings.rig.kind == "playback":
        raise UsageError(
            "--strike: rig.kind is 'playback', which strikes nothing; use the rig's configuration"
        )
    if settings.rig.dry_run:
        raise UsageError(
            "--strike: dry_run is true, so no coil is energized; set it to false when all "
            "hands are out of the rig"
        )


def strike_transducer(
    settings: Settings, position: str, *, report: Callable[[str], None] = PRINT_REQUEST
) -> Trial:
    """Strike one transducer and return checks, features and record; an error gives a failed check.

    Boards (``daqmx``) strike twice: first without a trigger to survey the coil, then a normal shot.

    Parameters
    ----------
    report
        Shows the person at the rig what to do, if a person is the striker.
    """
    settings = _select_position_settings(settings, position)
    boards = settings.rig.daqmx
    if settings.rig.kind != "daqmx" or boards is None:
        return _take_shot(settings, position, None, report)
    survey_check, spike = strike_and_check_coil(boards, position, settings.rig.read_timeout_s)
    trial = _take_shot(settings, position, spike, report)
    return replace(trial, checks=(survey_check, *trial.checks), spike=spike)


def _take_shot(
    settings: Settings, position: str, spike: SpikeSurvey | None, report: Callable[[str], None]
) -> Trial:
    """Strike once and return the checks, the features and the record of the shot.

    An instrument error or a strike without a record gives a failed check and no features. ``spike`` is the
    survey of an earlier strike or None; ``report`` shows a request to the person at the rig.
    """
    clock = WallClock() if settings.clock.kind == "wall" else SimulatedClock(parse_utc(settings.clock.epoch))
    plan = SetPlan(
        due=DueSet(set_index=0, due_h=0.0, due_utc_ns=clock.utc_ns()),
        positions={position: SOLITARY_WAVE},
        shots_per_set=1,
        shot_interval_s=settings.schedule.shot_interval_s,
        read_timeout_s=settings.rig.read_timeout_s,
    )
    started_s = time.monotonic()
    try:
        with open_rig(settings, clock, clock.utc_ns()) as rig:
            # An empty text withdraws the request; the following check contains more.
            rig.asking.listen(lambda text, key: report(text) if text else None)
            measurements = list(
                take_set(rig, plan, first_sequence=0, boot_id=read_boot_id(), idle=lambda: True)
            )
    except InstrumentError as error:
        failed_check = build_error_check(
            f"strike {position}: record", error, "fix what failed above, then strike"
        )
        return Trial(position=position, checks=(failed_check,))
    took_s = time.monotonic() - started_s
    (measurement,) = measurements
    if isinstance(measurement, MissedShot):
        return Trial(position=position, checks=(_build_missed_strike_check(measurement),))
    assert isinstance(measurement, Shot), "a solitary-wave position gives a shot or a miss"
    features = extract_shot_features(measurement, derive_extraction_settings(settings.positions))
    level_v = _read_trigger_level_v(settings.rig, settings.twin.adc.trigger_level_v, measurement)
    return Trial(
        position=position,
        checks=(
            _check_record_flags(measurement, features, took_s),
            _check_trigger_level(level_v, measurement, features, spike),
        ),
        features=features,
        record=measurement.waveform,
        settings=measurement.settings,
    )


def _select_position_settings(settings: Settings, position: str) -> Settings:
    """Return the settings for one position only: faults of other instruments must not prevent the strike."""
    used = settings.rig.positions.get(position)
    needed = {name: item for name, item in settings.rig.instruments.items() if used and name in used.names}
    unneeded = dict.fromkeys(("niscope", "supply", "drive", "climate", "air"))
    rig = settings.rig.model_copy(update={**unneeded, "instruments": needed})
    if rig.daqmx is not None:
        rig = rig.model_copy(update={"daqmx": _select_position_boards(rig.daqmx, position)})
    positions = {position: settings.positions[position]}
    return settings.model_copy(update={"rig": rig, "positions": positions})


def _select_position_boards(boards: DaqmxParameters, position: str) -> DaqmxParameters:
    """Return the parameters of the boards with the wiring and the watchdog of one transducer only.

    Raises KeyError if it is not wired.
    """
    wiring = boards.transducers[position]
    watchdog = boards.find_watchdog(wiring.coil_serial)
    return replace(boards, transducers={position: wiring}, watchdog=watchdog, watchdogs=None)


def _build_missed_strike_check(missed: MissedShot) -> Check:
    """Create the failed check for a strike without a record, with the reason of the miss."""
    found = f"no record ({missed.reason}): {missed.cause}"
    remedy = (
        "see whether the striker lifts and falls, then the sensor's cable, trigger_level_v and trigger_slope"
    )
    return Check(
        "rig", f"strike {missed.key.position}: record", "fail", found, remedy, {"reason": missed.reason}
    )


def _check_record_flags(shot: Shot, features: ShotFeatures, took_s: float) -> Check:
    """Create the check of a record from its quality flags: a warning if there are any.

    ``took_s`` is the duration of the trial in s. The finding has amplitudes (V), time of flight (us) and
    noise (V rms).
    """
    flags = features.flags
    incident = "no incident wave, "
    if not math.isnan(features.isw_amplitude_v):
        filled = features.isw_amplitude_v / shot.waveform.calibration.range_v
        incident = f"incident wave {features.isw_amplitude_v:.3g} V ({filled:.0%} of the range), "
    reflected = f"reflected {features.psw_amplitude_v:.3g} V after {features.tof_pp_s * 1e6:.1f} us, "
    return Check(
        "rig",
        f"strike {shot.key.position}: record",
        "warn" if flags else "ok",
        f"{features.quality}, flags: {', '.join(flags) or 'none'}; {incident}"
        f"{'' if math.isnan(features.psw_amplitude_v) else reflected}noise {features.noise_rms_v:.2g} V rms; "
        f"in {took_s:.1f} s",
        "; ".join(REMEDIES.get(flag, "see docs/explanation/detection.md") for flag in flags),
        {"flags": ",".join(flags), "quality": features.quality},
    )


def _read_trigger_level_v(rig: RigSettings, simulated_v: float, shot: Shot) -> float:
    """Return the trigger level of a shot in V; NaN if the instrument of a mixed rig does not report it.

    Other rigs have the level of the board's configuration, without boards ``simulated_v``.
    """
    if rig.kind == "mixed":
        return float(shot.settings.get("trigger_level_v", math.nan))
    return simulated_v if rig.daqmx is None else rig.daqmx.trigger_level_v


def _check_trigger_level(
    level_v: float, shot: Shot, features: ShotFeatures, spike: SpikeSurvey | None
) -> Check:
    """Warn if the ratio of trigger level and incident wave is outside `FITTING_LEVEL`.

    The amplitude is that of the shot if valid, otherwise that of the survey ``spike``, if any. Skipped if the
    amplitude or the level (V) is unknown (NaN).
    """
    name = f"strike {shot.key.position}: trigger level"
    incident_v = features.isw_amplitude_v
    if (math.isnan(incident_v) or not features.valid) and spike is not None and spike.wave_v is not None:
        incident_v = abs(spike.wave_v)
    values = {"trigger_level_v": level_v}
    if math.isnan(incident_v):
        found = f"{level_v:g} V; there is no incident wave to compare it with"
        return Check("rig", name, "skipped", found, "fix what the record lacks, then strike again", values)
    proposal = f"a tenth of the incident wave, {0.1 * incident_v:.2g} V"
    if math.isnan(level_v):
        found = "the instrument does not report at what level it triggered"
        return Check("rig", name, "skipped", found, f"see that it is {proposal}", values)
    part = abs(level_v) / incident_v
    fits = FITTING_LEVEL[0] <= part <= FITTING_LEVEL[1]
    found, remedy = f"{level_v:g} V is {part:.0%} of the incident wave", f"set trigger_level_v to {proposal}"
    values |= {"isw_amplitude_v": incident_v}
    return Check("rig", name, "ok" if fits else "warn", found, remedy, values)
