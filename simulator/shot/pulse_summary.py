"""Peaks and times of incident and reflected solitary wave in a simulated force.

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
from simulator.numerics.arrays import FloatArray
from simulator.numerics.machine_code import jit_compile
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
    """Interpolated maxima of one shot; the fields of the PSW are None where nothing came back.

    Attributes
    ----------
    amplitude_ratio
        PSW over ISW, both with the static preload.
    dynamic_amplitude_ratio
        The same without the preload, which a record and its features do not see.
    """

    isw_peak_n: float
    isw_time_us: float
    psw_peak_n: float | None
    psw_time_us: float | None
    tof_us: float | None
    amplitude_ratio: float | None
    dynamic_amplitude_ratio: float | None


def summarise_pulses(force: ShotForce) -> PulseSummary:
    """Measure ISW, PSW, time of flight and amplitude ratio of `force`.

    The fields of the PSW are None if no wave was reflected.

    Raises
    ------
    NoSolitaryWaveError
        No incident wave has passed the sensor within the record.
    """
    turn_s = np.nan if force.reflection_time_s is None else force.reflection_time_s
    isw, psw = _find_waves(force.force_n, force.time_s, force.preload_n, turn_s)
    if isw < 0:
        raise NoSolitaryWaveError(
            f"no incident solitary wave passed the sensor within {1e6 * float(force.time_s[-1]):.0f} us; "
            f"lengthen the record (duration_s)"
        )
    isw_time, isw_peak = _interpolate_maximum(force, isw)
    if psw < 0:
        return PulseSummary(
            isw_peak_n=isw_peak,
            isw_time_us=1e6 * isw_time,
            psw_peak_n=None,
            psw_time_us=None,
            tof_us=None,
            amplitude_ratio=None,
            dynamic_amplitude_ratio=None,
        )
    psw_time, psw_peak = _interpolate_maximum(force, psw)
    return PulseSummary(
        isw_peak_n=isw_peak,
        isw_time_us=1e6 * isw_time,
        psw_peak_n=psw_peak,
        psw_time_us=1e6 * psw_time,
        tof_us=1e6 * (psw_time - isw_time),
        amplitude_ratio=psw_peak / isw_peak,
        dynamic_amplitude_ratio=(psw_peak - force.preload_n) / (isw_peak - force.preload_n),
    )


@jit_compile(error_model="numpy")
def _find_waves(force_n: FloatArray, time_s: FloatArray, preload_n: float, turn_s: float) -> tuple[int, int]:
    """Find the sample indices of ISW and PSW in a force; -1 for one that is not there.

    ``turn_s`` is the time of the largest force on the specimen, NaN if nothing is reflected.
    """
    n = force_n.shape[0]
    strongest = -np.inf
    for k in range(n):
        strongest = max(strongest, force_n[k] - preload_n)
    isw = -1
    for k in range(1, n - 1):
        if _is_local_maximum(force_n, k) and force_n[k] - preload_n >= LEADING_FRACTION * strongest:
            isw = k
            break
    if isw < 0 or force_n[isw] - preload_n <= 0.0:
        return -1, -1
    gate_s = turn_s + RETURN_FRACTION * (turn_s - time_s[isw])
    strongest = -np.inf
    for k in range(1, n - 1):
        if time_s[k] > gate_s and _is_local_maximum(force_n, k):
            strongest = max(strongest, force_n[k] - preload_n)
    if strongest < REFLECTED_FRACTION * (force_n[isw] - preload_n):
        return isw, -1
    psw = -1
    for k in range(1, n - 1):
        height = force_n[k] - preload_n
        if psw >= 0 and height < PULSE_EDGE_FRACTION * strongest:
            break
        if time_s[k] > gate_s and _is_local_maximum(force_n, k):
            leads = psw < 0 and height >= LEADING_FRACTION * strongest
            if leads or (psw >= 0 and force_n[k] > force_n[psw]):
                psw = k
    return isw, psw


@jit_compile(error_model="numpy")
def _is_local_maximum(values: FloatArray, k: int) -> bool:
    """Check whether sample k, not an end, is a local maximum; of a plateau only the first sample is."""
    return bool(values[k] > values[k - 1] and values[k] >= values[k + 1])


def _interpolate_maximum(force: ShotForce, index: int) -> tuple[float, float]:
    """Interpolate a local maximum by a parabola; return its time in s and height in N, preload included."""
    before, at, after = force.force_n[index - 1 : index + 2].tolist()
    spacing_s = float(force.time_s[1]) - float(force.time_s[0])
    shift = 0.5 * (before - after) / (before - 2.0 * at + after)
    return float(force.time_s[index]) + shift * spacing_s, at - 0.25 * (before - after) * shift
