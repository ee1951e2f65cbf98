"""Trigger and range settings from one strike of each transducer: slope, level, ranges, pre-trigger, holdoff.

Slope, level, pre-trigger and holdoff are those of all transducers of a rig, a range is each one's own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from analysis.waves.coil_spike import (
    EARLIEST_FALL,
    FITTING_LEVEL,
    HOLDOFF_DIGITS,
    HOLDOFF_PART,
    LEVEL_OF_WAVE,
    SMALLEST_ROOM,
    WAVE_BLOCK_S,
    SpikeSurvey,
    measure_coil_spike,
)
from analysis.waves.record_reduction import STANDS_OUT, FloatArray, median
from hardware_drivers.measurement import Waveform

HEADROOM = 1.5
"""A range over the highest voltage of a shot: a drop height that scatters by 8 % (one SD) lets the wave
scatter by 5 %, and a coupling that gets better has room."""
LEVEL_OF_NOISE = 8.0
"""A trigger level is at least this times the noise's rms, so that crests (`STANDS_OUT`) leave it alone."""
SHORTEST_PRETRIGGER_S = 100e-6
"""The paper's."""
QUIET_S = 50e-6
"""Of the pre-trigger, before the wave begins: the quiet level and the noise are read there."""

Trouble = Literal["noise", "ringing", "no_wave", "inverted", "level", "range"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StruckTransducer:
    """Recorded strike of one transducer.

    Attributes
    ----------
    noise
        A record with the coil at rest.
    strike
        From the coil's switching on to after the wave, without a trigger.
    ranges_v
        Ranges -r .. +r of its board, rising.
    """

    noise: Waveform
    strike: Waveform
    ranges_v: Sequence[float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Proposal:
    """Proposed settings of a rig.

    Attributes
    ----------
    trigger_level_v, holdoff_s
        None where there is none to make; `troubles` has the reason.
    ringing_s
        Longest of all transducers, rounded up to 0.1 ms.
    range_v
        By position: the smallest range with headroom.
    surveys
        By position, with the proposed level.
    again
        Positions whose record is clipped where the wave is: take their new range, then strike again.
    troubles
        What prevents the proposal, by position: the ``noise`` leaves no room for a level, the ``ringing``
        none for a holdoff, there is ``no_wave``, it goes down (``inverted``, which the quality gate refuses),
        its height fits no ``level`` of all, or no ``range`` of the board holds it.
    """

    rising: bool
    trigger_level_v: float | None
    pretrigger_s: float
    holdoff_s: float | None
    ringing_s: float
    range_v: Mapping[str, float]
    surveys: Mapping[str, SpikeSurvey]
    again: tuple[str, ...]
    troubles: Mapping[str, Trouble]


def propose_settings(struck: Mapping[str, StruckTransducer], *, pulse_s: float, fall_s: float) -> Proposal:
    """Propose settings from one strike of each transducer, at least one; obstacles are `troubles`.

    Parameters
    ----------
    pulse_s, fall_s
        Time the coil is on; nominal fall of the striker.

    Raises
    ------
    RecordError
        A record ends before a wave could have come.
    """
    earliest_s = pulse_s + EARLIEST_FALL * fall_s
    crests_v = {name: _find_crest(one, earliest_s) for name, one in struck.items()}
    offsets_v = {name: median(one.noise.volts()) for name, one in struck.items()}
    noises_v = {name: float(one.noise.volts().std()) for name, one in struck.items()}

    falling = {name for name, v in crests_v.items() if v < -LEVEL_OF_NOISE * noises_v[name]}
    sign = -1.0 if len(falling) == len(struck) else 1.0

    def survey_all(pretrigger_s: float, above_v: Mapping[str, float]) -> dict[str, SpikeSurvey]:
        """Survey the coil spike of every transducer at a level ``above_v`` its quiet level, by name."""
        return {
            name: measure_coil_spike(
                one.strike,
                one.noise,
                pulse_s=pulse_s,
                fall_s=fall_s,
                pretrigger_s=pretrigger_s,
                trigger_level_v=offsets_v[name] + sign * above_v[name],
                rising=sign > 0.0,
            )
            for name, one in struck.items()
        }

    # What stands out of the noise is a wave; the level follows from it.
    found = survey_all(SHORTEST_PRETRIGGER_S, {name: LEVEL_OF_NOISE * v for name, v in noises_v.items()})
    troubles: dict[str, Trouble] = dict.fromkeys(sorted(falling), "inverted")
    for name, survey in found.items():
        if survey.wave_v is None:
            troubles.setdefault(name, "no_wave")
    waves_v = {
        name: abs(survey.wave_v)
        for name, survey in found.items()
        if survey.wave_v is not None and (sign < 0.0 or name not in falling)
    }
    level_v = _choose_trigger_level(waves_v, noises_v, sum(offsets_v.values()) / len(struck), sign)
    pretrigger_s, holdoff_s, ringing_s = SHORTEST_PRETRIGGER_S, None, 0.0
    if level_v is None:
        troubles |= dict.fromkeys(waves_v, "noise")
    else:
        above_v = {name: sign * (level_v - offsets_v[name]) for name in struck}
        for name, wave_v in waves_v.items():
            if above_v[name] <= STANDS_OUT * noises_v[name]:
                troubles.setdefault(name, "noise")
            elif not FITTING_LEVEL[0] <= above_v[name] / wave_v <= FITTING_LEVEL[1]:
                troubles.setdefault(name, "level")
        rises_s = [_rise_s(struck[name], earliest_s, above_v[name], noises_v[name], sign) for name in waves_v]
        pretrigger_s = max(SHORTEST_PRETRIGGER_S, math.ceil((max(rises_s) + QUIET_S) * 1e5) / 1e5)
        found = survey_all(pretrigger_s, above_v)
        holdoff_s, ringing_s, loudest = _choose_holdoff(found, fall_s)
        if holdoff_s is None:
            troubles.setdefault(loudest, "ringing")
    listens_s = earliest_s if holdoff_s is None else pulse_s + holdoff_s
    ranges = {name: _choose_range(one, listens_s) for name, one in struck.items()}
    for name, (_, again, holds) in ranges.items():
        if again and not holds:
            troubles.setdefault(name, "range")
    return Proposal(
        rising=sign > 0.0,
        trigger_level_v=level_v,
        pretrigger_s=pretrigger_s,
        holdoff_s=holdoff_s,
        ringing_s=ringing_s,
        range_v={name: range_v for name, (range_v, _, _) in ranges.items()},
        surveys=found,
        again=tuple(name for name, (_, again, holds) in ranges.items() if again and holds),
        troubles=troubles,
    )


def cut_triggered_record(
    strike: Waveform, *, after_s: float, level_v: float, rising: bool, pretrigger_samples: int, samples: int
) -> Waveform | None:
    """Cut the record that the trigger would start out of a strike; None if the level is not crossed in time.

    Return None, too, if the record does not fit into the strike's.

    Parameters
    ----------
    after_s
        Time from the start of the strike's record until the trigger is armed.
    level_v, rising
        Trigger level in V, and whether on a rising edge.
    pretrigger_samples, samples
        Samples of the record before the trigger, and in all.
    """
    sign = 1.0 if rising else -1.0
    first = round(after_s * strike.sample_rate_hz)
    above = sign * (strike.volts()[first:] - level_v) >= 0.0
    passed = np.flatnonzero(above[1:] & ~above[:-1])
    if not passed.size:
        return None
    begin = first + 1 + int(passed[0]) - pretrigger_samples
    if begin < 0 or begin + samples > strike.counts.size:
        return None
    return replace(
        strike, counts=strike.counts[begin : begin + samples], pretrigger_samples=pretrigger_samples
    )


def _average_blocks(volts: FloatArray, rate_hz: float) -> tuple[FloatArray, int]:
    """Average volts in blocks of 10 us that hide electrical spikes; return means and samples per block.

    Samples after the last full block are left out.
    """
    block = max(1, round(WAVE_BLOCK_S * rate_hz))
    n_blocks = volts.size // block
    return volts[: n_blocks * block].reshape(n_blocks, block).mean(axis=1), block


def _find_crest(one: StruckTransducer, earliest_s: float) -> float:
    """Return the largest deviation of a 10-us mean from the quiet level in V, with its sign.

    Only means from ``earliest_s`` on count, in s from the start of the strike's record.
    """
    rate_hz = one.strike.sample_rate_hz
    means, _ = _average_blocks(one.strike.volts()[round(earliest_s * rate_hz) :], rate_hz)
    departures = means - median(one.noise.volts())
    return float(departures[np.abs(departures).argmax()])


def _choose_trigger_level(
    waves_v: Mapping[str, float], noises_v: Mapping[str, float], offset_v: float, sign: float
) -> float | None:
    """Choose one trigger level in V, two digits, for all transducers; None without a wave or a level.

    It depends on the smallest of the wave heights ``waves_v`` and the largest noise RMS; ``offset_v`` is the
    mean quiet level, ``sign`` 1 for a rising slope, -1 for a falling one.
    """
    if not waves_v:
        return None
    smallest_v, noise_v = min(waves_v.values()), max(noises_v[name] for name in waves_v)
    above_v = max(LEVEL_OF_WAVE * smallest_v, LEVEL_OF_NOISE * noise_v)
    return float(f"{offset_v + sign * above_v:.2g}") if above_v <= FITTING_LEVEL[1] * smallest_v else None


def _rise_s(one: StruckTransducer, earliest_s: float, above_v: float, noise_v: float, sign: float) -> float:
    """Return the time in s from the last quiet block before the wave until it reaches the level ``above_v``.

    Return 0 if no block before it is quiet. The wave is sought from ``earliest_s`` on; ``above_v`` counts
    from the quiet level in the direction of ``sign``.
    """
    rate_hz = one.strike.sample_rate_hz
    volts = sign * (one.strike.volts()[round(earliest_s * rate_hz) :] - median(one.noise.volts()))
    means, block = _average_blocks(volts, rate_hz)
    passed = int((means >= above_v).argmax())
    quiet = np.flatnonzero(means[:passed] < noise_v)
    return (passed - int(quiet[-1]) if quiet.size else 0) * block / rate_hz


def _choose_holdoff(surveys: Mapping[str, SpikeSurvey], fall_s: float) -> tuple[float | None, float, str]:
    """Choose one holdoff in s for all transducers; None if the coil rings for too long.

    Return also the ringing time in s (0 without a holdoff), and the transducer whose coil rings longest.
    """
    loudest = max(surveys, key=lambda name: surveys[name].off.ringing_s)
    ringing_s = math.ceil(surveys[loudest].off.ringing_s * 1e4) / 1e4
    room_s = min(survey.latest_holdoff_s for survey in surveys.values()) - ringing_s
    if room_s < SMALLEST_ROOM * fall_s:
        return None, 0.0, loudest
    return round(ringing_s + HOLDOFF_PART * room_s, HOLDOFF_DIGITS), ringing_s, loudest


def _choose_range(one: StruckTransducer, listens_s: float) -> tuple[float, bool, bool]:
    """Choose the smallest input range in V of at least 1.5 times the voltages from ``listens_s`` on.

    Return the largest range if none fits, then whether these samples were clipped, and whether a range fits.
    """
    first = round(listens_s * one.strike.sample_rate_hz)
    part = replace(one.strike, counts=one.strike.counts[first:])
    needed_v = HEADROOM * float(np.abs(part.volts()).max())
    fitting = [range_v for range_v in one.ranges_v if range_v >= needed_v]
    # Where even the largest has no headroom, that one is what there is.
    return (fitting[0] if fitting else max(one.ranges_v)), part.clipped, bool(fitting)
