"""Incident and reflected solitary wave in a simulated force: peaks and times.

ISW: the first local maximum of at least half the largest force above the preload; a chain of equal
spheres brings its strongest pulse first, and what precedes it is ripple.

PSW: a wave that came back from the specimen cannot be there before the incident wave turned round.
The incident wave took from the sensor to the turn (the largest force on the specimen, known in a
simulation) as long as the reflected one takes back at the least, so only maxima later than the turn
plus half of that are reflected; ripple behind the ISW comes earlier or is weak. Among them the
first pulse of at least half the strongest one is the PSW; a weaker, later one is the SSW. A pulse
ends where the force above the preload falls below a fifth of the strongest. PSW is the highest
local maximum of its pulse: a thin patch may rebound twice within one.

Peaks are interpolated by a parabola through three samples. Forces keep the static preload.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulator.errors import NoSolitaryWaveError
from simulator.numerics.arrays import FloatArray, IntArray
from simulator.shot.model import ShotForce

LEADING_FRACTION = 0.5
"""A pulse this strong, compared with the strongest candidate, may be the wave looked for."""

PULSE_EDGE_FRACTION = 0.2
"""Below this part of the strongest reflected force one pulse ends and another begins."""

REFLECTED_FRACTION = 0.05
"""Weakest reflected wave, relative to the ISW; weaker maxima are ripple."""

RETURN_FRACTION = 0.5
"""Part of the way back to the sensor, in units of the way down, before a maximum counts as reflected."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PulseSummary:
    """Interpolated maxima of one shot; the fields of the PSW are None where nothing came back."""

    isw_peak_n: float
    isw_time_us: float
    psw_peak_n: float | None
    psw_time_us: float | None
    tof_us: float | None
    amplitude_ratio: float | None


def summarise(force: ShotForce) -> PulseSummary:
    """ISW, PSW, time of flight and amplitude ratio of `force`.

    Raises
    ------
    NoSolitaryWaveError
        No incident wave has passed the sensor within the record.
    """
    f = np.asarray(force.force_n, dtype=np.float64)
    maxima = local_maxima(f)
    isw = _incident(f, maxima, force)
    isw_time, isw_peak = _interpolated(force, isw)
    psw = _reflected(f, maxima, force, isw)
    if psw is None:
        return PulseSummary(
            isw_peak_n=isw_peak,
            isw_time_us=1e6 * isw_time,
            psw_peak_n=None,
            psw_time_us=None,
            tof_us=None,
            amplitude_ratio=None,
        )
    psw_time, psw_peak = _interpolated(force, psw)
    return PulseSummary(
        isw_peak_n=isw_peak,
        isw_time_us=1e6 * isw_time,
        psw_peak_n=psw_peak,
        psw_time_us=1e6 * psw_time,
        tof_us=1e6 * (psw_time - isw_time),
        amplitude_ratio=psw_peak / isw_peak,
    )


def local_maxima(values: FloatArray) -> IntArray:
    """Find samples above the one before and not below the one after; never the ends."""
    inner = values[1:-1]
    return np.flatnonzero((inner > values[:-2]) & (inner >= values[2:])) + 1


def _incident(f: FloatArray, maxima: IntArray, force: ShotForce) -> int:
    dynamic = f - force.preload_n
    strong = maxima[dynamic[maxima] >= LEADING_FRACTION * dynamic.max()] if maxima.size else maxima
    if strong.size == 0 or dynamic[strong[0]] <= 0.0:
        raise NoSolitaryWaveError(
            f"no incident solitary wave passed the sensor within {1e6 * float(force.time_s[-1]):.0f} us; "
            f"lengthen the record (duration_s)"
        )
    return int(strong[0])


def _reflected(f: FloatArray, maxima: IntArray, force: ShotForce, isw: int) -> int | None:
    turn = force.reflection_time_s
    if turn is None:
        return None
    gate = turn + RETURN_FRACTION * (turn - force.time_s[isw])
    dynamic = f - force.preload_n
    late = maxima[force.time_s[maxima] > gate]
    if late.size == 0 or dynamic[late].max() < REFLECTED_FRACTION * dynamic[isw]:
        return None
    strongest = dynamic[late].max()
    first = late[dynamic[late] >= LEADING_FRACTION * strongest][0]
    below = np.flatnonzero(dynamic[first:] < PULSE_EDGE_FRACTION * strongest)
    end = first + below[0] if below.size else len(f)
    pulse = late[(late >= first) & (late < end)]
    return int(pulse[np.argmax(f[pulse])])


def _interpolated(force: ShotForce, index: int) -> tuple[float, float]:
    """Time in s and height in N of the parabola through the samples around a maximum."""
    before, at, after = force.force_n[index - 1 : index + 2]
    spacing = force.time_s[1] - force.time_s[0]
    shift = 0.5 * (before - after) / (before - 2.0 * at + after)
    return float(force.time_s[index] + shift * spacing), float(at - 0.25 * (before - after) * shift)
