"""Voltage that a striker's coil couples into the sensor's input, and the holdoff that it requires.

The record begins as the coil goes on and ends after the wave; no trigger takes part in it. A departure from
the quiet level rings from half of the trigger level on, or from six times the noise where that is more:
below it nothing triggers. It is seen from six times the noise on.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from analysis.errors import RecordError
from analysis.waves.record_reduction import STANDS_OUT, FloatArray, median
from hardware_drivers.measurement import Waveform

LEVEL_PART, SEEN_PART = 0.5, 0.05
WAVE_BLOCK_S = 10e-6
"""Mean in which the wave is looked for: an electrical spike hardly shows in it."""
WAVE_FRONT_S = 0.3e-3
"""Before the wave's peak: its front, which is no longer spike."""
EARLIEST_FALL = 0.6
"""No wave comes before this part of the nominal fall: a third of the drop height."""
HOLDOFF_PART = 1.0 / 3.0
"""Where a holdoff is put between ringing and wave: ringing repeats from strike to strike, a fall scatters."""
SMALLEST_ROOM = 0.2
"""Part of the fall that must lie between them: two thirds of it are 3.5 SD of the time of a fall whose height
scatters by 8 % (one SD)."""
LEVEL_OF_WAVE = 0.1
"""Trigger level that is proposed, as a part of the incident wave."""
FITTING_LEVEL = (0.02, 0.5)
"""A trigger level between these parts of the incident wave is passed once, early and safely above noise."""
HOLDOFF_DIGITS = 4
"""A proposal is rounded to 0.1 ms."""

Obstacle = Literal["", "noise", "ringing", "no_wave"]


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeSpike:
    """Voltage after one edge of the coil's pulse.

    Attributes
    ----------
    height_v
        Largest departure from the quiet level, with its sign; 0 where none is seen.
    duration_s
        From the edge until it stays below half of that height.
    ringing_s
        From the edge until nothing is left that could trigger.
    flyback_v
        Largest departure of the other sign; 0 where none is seen.
    triggers
        The trigger level is passed in the trigger's direction.
    """

    height_v: float = 0.0
    duration_s: float = 0.0
    ringing_s: float = 0.0
    flyback_v: float = 0.0
    triggers: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class SpikeSurvey:
    """Result of the spike measurement of one strike.

    Attributes
    ----------
    noise_rms_v
        Before it, hum included.
    limit_v
        What rings.
    wave_v, wave_after_s
        Height of the incident wave, and the time of its front's beginning from the coil's switching off; None
        where no wave is above the limit.
    latest_holdoff_s
        Fall less the pre-trigger: of the nominal height, or as measured where that was shorter.
    holdoff_s, trigger_level_v
        Proposals; None where there is none to make.
    obstacle
        Why no holdoff is proposed: the ``noise`` alone passes the trigger level, the ``ringing`` leaves no
        room for one, or there is ``no_wave``; empty where one is proposed.
    """

    noise_rms_v: float
    limit_v: float
    on: EdgeSpike = field(default_factory=EdgeSpike)
    off: EdgeSpike = field(default_factory=EdgeSpike)
    wave_v: float | None = None
    wave_after_s: float | None = None
    latest_holdoff_s: float
    holdoff_s: float | None = None
    trigger_level_v: float | None = None
    obstacle: Obstacle = ""

    @property
    def takes_the_trigger(self) -> bool:
        """Return whether the spike at either edge of the coil's pulse would trigger an armed record."""
        return self.on.triggers or self.off.triggers


def measure_coil_spike(
    strike: Waveform,
    noise: Waveform,
    *,
    pulse_s: float,
    fall_s: float,
    pretrigger_s: float,
    trigger_level_v: float,
    rising: bool = True,
) -> SpikeSurvey:
    """Assess the coil spike of one strike: height, ringing, and whether it would trigger a record.

    A holdoff is proposed only if it has room and a wave is seen; else ``obstacle`` states why not.

    Parameters
    ----------
    strike
        From the coil's switching on to after the wave, without a trigger.
    noise
        A record with the coil at rest.
    pulse_s
        Time the coil is on.
    fall_s
        Nominal fall of the striker.
    pretrigger_s
        Time that must be recorded before the wave.
    trigger_level_v, rising
        Level in V that triggers a record, and whether on a rising edge.

    Raises
    ------
    RecordError
        The record ends before a wave could have come.
    """
    rate_hz = strike.sample_rate_hz
    sign = 1.0 if rising else -1.0
    level = median(noise.volts())
    noise_rms_v = float(noise.volts().std())
    volts = sign * (strike.volts() - level)
    trigger_v = sign * (trigger_level_v - level)
    limit_v = max(LEVEL_PART * abs(trigger_v), STANDS_OUT * noise_rms_v)
    off, nominal = round(pulse_s * rate_hz), round((pulse_s + fall_s) * rate_hz)
    earliest = off + round(EARLIEST_FALL * fall_s * rate_hz)
    if nominal >= volts.size:
        raise RecordError(
            f"the record of a strike is {volts.size / rate_hz:.4g} s long and the wave comes "
            f"{pulse_s + fall_s:.4g} s after the coil goes on: record longer"
        )
    front, wave_v = _find_wave_front(volts, earliest, rate_hz)
    seen = wave_v > limit_v
    end = front if seen else nominal
    seen_v = max(SEEN_PART * abs(trigger_v), STANDS_OUT * noise_rms_v)
    on, after = (
        _measure_edge(part, rate_hz, seen_v, limit_v, trigger_v) for part in (volts[:off], volts[off:end])
    )
    latest_s = min(fall_s, (end - off) / rate_hz) - pretrigger_s
    holdoff_s: float | None = None
    obstacle: Obstacle = ""
    if limit_v >= abs(trigger_v):
        obstacle = "noise"
    elif latest_s - after.ringing_s < SMALLEST_ROOM * fall_s:
        obstacle = "ringing"
    elif not seen:
        obstacle = "no_wave"
    else:
        room_s = latest_s - after.ringing_s
        holdoff_s = round(after.ringing_s + HOLDOFF_PART * room_s, HOLDOFF_DIGITS)
    return SpikeSurvey(
        noise_rms_v=noise_rms_v,
        limit_v=limit_v,
        on=_apply_sign(on, sign),
        off=_apply_sign(after, sign),
        wave_v=sign * wave_v if seen else None,
        wave_after_s=(front - off) / rate_hz if seen else None,
        latest_holdoff_s=latest_s,
        holdoff_s=holdoff_s,
        trigger_level_v=_propose_trigger_level(trigger_v, wave_v, noise_rms_v, sign) if seen else None,
        obstacle=obstacle,
    )


def _find_wave_front(volts: FloatArray, earliest: int, rate_hz: float) -> tuple[int, float]:
    """Find the sample where the incident wave's front starts, and the wave's height in V above that level.

    The wave is sought from sample ``earliest`` on; without one, the result is the largest rise of the noise.
    """
    block = max(1, round(WAVE_BLOCK_S * rate_hz))
    n_blocks = (volts.size - earliest) // block
    means = volts[earliest : earliest + n_blocks * block].reshape(n_blocks, block).mean(axis=1)
    # A wave rises within its front, what decays does not: compare each mean with the one before the front.
    reach = min(round(WAVE_FRONT_S / WAVE_BLOCK_S), n_blocks - 1)
    steepest = int((means[reach:] - means[: n_blocks - reach]).argmax())
    peak = steepest + int(means[steepest : steepest + 2 * reach + 1].argmax())
    front = max(peak - reach, 0)
    return earliest + front * block, float(means[peak] - means[front])


def _measure_edge(
    volts: FloatArray, rate_hz: float, seen_v: float, limit_v: float, trigger_v: float
) -> EdgeSpike:
    """Measure the coil's voltage after an edge at the first sample; zeros if it stays below ``seen_v``.

    It rings until the last sample of at least ``limit_v`` in magnitude, and triggers if it starts at
    ``trigger_v`` or above, or rises to it.
    """
    departed = np.abs(volts)
    if departed.max() < seen_v:
        return EdgeSpike()
    ringing = np.flatnonzero(departed >= limit_v)
    height_v = float(volts[departed.argmax()])
    other_v = float(volts.max() if height_v < 0.0 else volts.min())
    above = volts >= trigger_v
    return EdgeSpike(
        height_v=height_v,
        duration_s=float(np.flatnonzero(departed >= 0.5 * abs(height_v))[-1] + 1) / rate_hz,
        ringing_s=float(ringing[-1] + 1) / rate_hz if ringing.size else 0.0,
        flyback_v=other_v if abs(other_v) >= seen_v else 0.0,
        triggers=bool(above[0] or (above[1:] & ~above[:-1]).any()),
    )


def _apply_sign(edge: EdgeSpike, sign: float) -> EdgeSpike:
    """Return an edge's spike with both its heights multiplied by the trigger's sign, 1 or -1."""
    return replace(edge, height_v=sign * edge.height_v, flyback_v=sign * edge.flyback_v)


def _propose_trigger_level(trigger_v: float, wave_v: float, noise_rms_v: float, sign: float) -> float | None:
    """Propose a trigger level in V, two digits; None if the present one fits or none clears the noise.

    ``trigger_v``, the present level, and ``wave_v`` count from the quiet level in the direction of the slope
    ``sign``, 1 or -1; the proposal counts from the quiet level with its sign.
    """
    lowest, highest = FITTING_LEVEL
    proposed_v = max(LEVEL_OF_WAVE * wave_v, STANDS_OUT * noise_rms_v)
    if lowest <= trigger_v / wave_v <= highest or proposed_v > highest * wave_v:
        return None
    return sign * float(f"{proposed_v:.2g}")
