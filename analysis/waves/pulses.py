"""Find the solitary waves of a record: incident (ISW), primary (PSW) and secondary (SSW) reflected wave."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from analysis.waves.noise_colour import strongest_block_noise_v, wandering_noise_v
from analysis.waves.record_reduction import (
    MAD_TO_SD,
    STANDS_OUT,
    ExtractionSettings,
    FloatArray,
    ReducedRecord,
    median,
    minimum_after_isw_s,
    moving_mean,
    round_to_odd,
)

__all__ = ["ExtractionSettings", "Pulse", "Pulses", "find_pulses"]

LATEST_ISW_PER_FWHM = 2.0
"""After the trigger: a wave that fires it itself peaks within one width."""
NOISE_CRESTS = 4.5
"""Standard deviations: of a hundred independent values noise passes them in one record of 3,000."""
ALLOWED_NOISE = 0.0095
"""Of the ISW's amplitude, in means of `TOP_SMOOTHING_S`: white noise at 20 dB, which the fractions of
`ExtractionSettings` leave room for."""
NOISE_VALLEY = 5.2
"""Standard deviations between a crest and a trough: 3.7 of a difference."""
FLANK_SMOOTHING_S = 5e-6
"""Moving mean in which the half-height crossings are read: too short to widen the pulse."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pulse:
    """Solitary wave in a record.

    Attributes
    ----------
    time_s
        Peak of the quartic through the top (above half height), from the trigger.
    amplitude_v
        Height of that quartic.
    matched_time_s
        Peak of the matched filter, from the trigger.
    fwhm_s
        Full width at half maximum, NaN where a flank does not fall to half height; 0 for a spike so narrow
        that `FLANK_SMOOTHING_S` leaves less than half of its height.
    regular
        False where the quartic has no maximum inside (two tops, a plateau): time and amplitude are
        those of the highest smoothed value then.
    top_points, top_place, top_curvature_v
        Points of the quartic, its maximum on -1..1 and its second derivative there, NaN without one.
    matched_curvature_v
        Second difference of the matched filter's output at its maximum.
    """

    time_s: float
    amplitude_v: float
    matched_time_s: float
    fwhm_s: float
    regular: bool
    top_points: int
    top_place: float
    top_curvature_v: float
    matched_curvature_v: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Pulses:
    """Solitary waves of one record; None where there is none.

    Attributes
    ----------
    inverted
        The record's strongest pulse is negative; nothing else was looked for.
    double
        There is a third pulse, or the ISW is too wide for one strike.
    psw_merged
        The PSW holds more than one maximum, or is much wider than the ISW.
    stray
        There is a pulse that no strike leaves: a small one before the PSW, or one narrower than the ISW in
        the PSW's place.
    """

    isw: Pulse | None = None
    psw: Pulse | None = None
    ssw: Pulse | None = None
    inverted: bool = False
    double: bool = False
    psw_merged: bool = False
    stray: bool = False


def find_pulses(record: ReducedRecord, settings: ExtractionSettings) -> Pulses:
    """Find incident (ISW), reflected (PSW) and second reflected wave (SSW) in a record.

    The ISW is the first maximum of the matched filter above half of its largest; it must rise
    ``missed_below_snr`` above the noise and, where no PSW is found, leave room for one in the record. The
    PSW is the first maximum, ``psw_earliest_s`` to ``psw_latest_s`` later, of at least half the highest
    there; the SSW the highest one a set time after the PSW.

    Parameters
    ----------
    record
        From `analysis.waves.record_reduction.reduce_records`.

    Returns
    -------
    Pulses
        ``isw`` is None for a missed strike, ``psw`` None where no wave came back.
    """
    matched = record.matched_v
    top = float(matched.max())
    bottom = float(matched.min())
    if -bottom > max(top, settings.missed_below_snr * record.noise_rms_v):
        return Pulses(inverted=True)
    maxima = _find_local_maxima(matched)
    isw = _find_isw(record, maxima, top, settings)
    if isw is None:
        return Pulses()
    floor = settings.no_psw_below_sigmas * record.matched_noise_v
    isw_index = record.index(isw.matched_time_s)
    psw = _find_first_pulse(
        record,
        maxima,
        isw_index + settings.psw_earliest_s / record.step_s,
        min(
            isw_index + settings.psw_latest_s / record.step_s,
            record.blocks_v.size - settings.window_half_width_s / record.step_s,
        ),
        settings.psw_leading_fraction,
        max(floor, settings.no_psw_below_fraction * isw.amplitude_v),
    )
    if psw is None and not _has_room_for_reflection(record, isw, settings):
        return Pulses()  # no one could tell a hole from a wave that came too late
    ssw = None
    if psw is not None:
        psw_index = record.index(psw.matched_time_s)
        ssw = _find_first_pulse(
            record,
            maxima,
            psw_index + settings.window_half_width_s / record.step_s,
            psw_index + settings.ssw_after_psw_latest_s / record.step_s,
            1.0,
            max(floor, settings.ssw_below_fraction * isw.amplitude_v),
        )
    double, merged, stray = _check_extra_pulses(record, isw, psw, settings, 0.0)
    second = psw is not None and _has_second_reflection(record, maxima, isw, psw, settings, 0.0)
    if double or merged or stray or second:
        noise_v = wandering_noise_v(record, strongest_block_noise_v(record, isw.time_s, isw.fwhm_s))
        double, merged, stray = _check_extra_pulses(record, isw, psw, settings, noise_v)
        noise_v = wandering_noise_v(record, record.block_noise_v)
        second = psw is not None and _has_second_reflection(record, maxima, isw, psw, settings, noise_v)
    return Pulses(isw=isw, psw=psw, ssw=ssw, double=double or second, psw_merged=merged, stray=stray)


def measure_first_fwhm_s(samples_v: FloatArray, sample_rate_hz: float, pretrigger_samples: int) -> float:
    """Measure the full width at half maximum of a record's highest pulse in s, before its settings are known.

    Return NaN if the pulse has no flanks, is no higher than noise, or the record is shorter than a block of 1
    us.
    """
    block = max(1, math.floor(1e-6 * sample_rate_hz))
    n_blocks = samples_v.size // block
    if not n_blocks:
        return math.nan
    blocks = samples_v[: n_blocks * block].reshape(n_blocks, block).mean(axis=1)
    flanks = moving_mean(
        blocks - median(blocks[: max(1, pretrigger_samples // block)]),
        round_to_odd(FLANK_SMOOTHING_S * sample_rate_hz / block),
    )
    peak = int(flanks.argmax())
    if flanks[peak] < STANDS_OUT * MAD_TO_SD * median(np.abs(flanks - median(flanks))):
        return math.nan
    return _measure_width(flanks, peak, 0.5 * float(flanks[peak])) * block / sample_rate_hz


def search_windows_s(
    isw_time_s: float, psw_time_s: float | None, settings: ExtractionSettings
) -> dict[str, tuple[float, float]]:
    """Return the search windows by wave name, in s from the trigger: around the ISW, for PSW and for SSW.

    Parameters
    ----------
    isw_time_s, psw_time_s
        From the trigger; without a PSW there is no window for the SSW.
    """
    half = settings.window_half_width_s
    windows = {
        "ISW": (isw_time_s - half, isw_time_s + half),
        "PSW": (isw_time_s + settings.psw_earliest_s, isw_time_s + settings.psw_latest_s),
    }
    if psw_time_s is not None:
        windows["SSW"] = (
            psw_time_s + settings.window_half_width_s,
            psw_time_s + settings.ssw_after_psw_latest_s,
        )
    return windows


def _find_isw(
    record: ReducedRecord, maxima: list[int], top: float, settings: ExtractionSettings
) -> Pulse | None:
    """Find the incident wave: the first maximum of at least half of ``top``; None if there is none.

    Return None, too, if that pulse is too weak for the noise or as narrow as an electrical spike.
    """
    first = next((index for index in maxima if record.matched_v[index] >= 0.5 * top), None)
    if first is None or top <= 0.0:
        return None
    pulse = _measure_pulse(record, first)
    if pulse is None or pulse.amplitude_v < settings.missed_below_snr * record.noise_rms_v:
        return None
    if pulse.fwhm_s < settings.spike_width_ratio * settings.isw_fwhm_s:
        return None
    return pulse


def _has_room_for_reflection(record: ReducedRecord, isw: Pulse, settings: ExtractionSettings) -> bool:
    """Check whether the record has room for a reflected wave after the incident one.

    A record too short for the latest reflection needs room only for that of an intact wall.
    """
    window_s = settings.psw_latest_s + settings.window_half_width_s
    if record.end_s < window_s + LATEST_ISW_PER_FWHM * settings.isw_fwhm_s:
        window_s = min(window_s, minimum_after_isw_s(settings))
    return record.end_s - isw.matched_time_s >= window_s


def _find_local_maxima(values: FloatArray) -> list[int]:
    """Return the indices of interior local maxima, ascending; of a plateau the first sample."""
    rising = values[1:-1] > values[:-2]
    return ((rising & (values[1:-1] >= values[2:])).nonzero()[0] + 1).tolist()


def _find_first_pulse(
    record: ReducedRecord, maxima: list[int], first: float, last: float, fraction: float, floor: float
) -> Pulse | None:
    """Find the first pulse from block ``first`` to ``last`` with ``fraction`` of the highest output there.

    Return None if there is none, or if its amplitude is below ``floor`` in V.
    """
    found = [index for index in maxima if first <= index <= last]
    inside = list(zip(found, record.matched_v[found].tolist(), strict=True)) if found else []
    highest = max((height for _, height in inside), default=0.0)
    if highest <= 0.0:
        return None
    pulse = _measure_pulse(record, next(index for index, height in inside if height >= fraction * highest))
    return None if pulse is None or pulse.amplitude_v < floor else pulse


def interpolate_parabola_peak(before: float, centre: float, after: float) -> float:
    """Return the offset in samples of a parabola's maximum from the middle of three equidistant values.

    Return 0 where the three values have no maximum.
    """
    curvature = before - 2.0 * centre + after
    return 0.0 if curvature >= 0.0 else 0.5 * (before - after) / curvature


def _measure_pulse(record: ReducedRecord, matched_index: int) -> Pulse | None:
    """Measure the pulse at a matched-filter maximum; None if its top is narrower than seven blocks."""
    blocks, matched = record.blocks_v, record.matched_v
    before, centre_v, after = matched[matched_index - 1 : matched_index + 2].tolist()
    shift = interpolate_parabola_peak(before, centre_v, after)
    reach = round(150e-6 / record.step_s)
    start = max(0, matched_index - reach)
    near_pulse = blocks[start : matched_index + reach + 1]
    smooth = record.smooth_v[start : matched_index + reach + 1]
    centre = matched_index - start
    near = round(40e-6 / record.step_s)
    low = max(0, centre - near)
    peak = low + int(smooth[low : centre + near + 1].argmax())
    first, last = _find_stretch_above(smooth, peak, 0.5 * float(smooth[peak]))
    if last - first < 6:
        return None
    fit = _find_quartic_maximum(near_pulse[first : last + 1])
    regular = fit is not None
    n = last - first + 1
    place, height, curvature = fit if fit is not None else (math.nan, float(smooth[peak]), math.nan)
    position = 0.5 * (n - 1) * (1.0 + place) if regular else float(peak - first)
    flanks = moving_mean(near_pulse, round_to_odd(FLANK_SMOOTHING_S / record.step_s))
    return Pulse(
        time_s=record.time_s(start + first + position),
        amplitude_v=height,
        matched_time_s=record.time_s(matched_index + shift),
        fwhm_s=_measure_width(flanks, peak, 0.5 * height) * record.step_s,
        regular=regular,
        top_points=n,
        top_place=place,
        top_curvature_v=curvature,
        matched_curvature_v=before - 2.0 * centre_v + after,
    )


def _find_stretch_above(values: FloatArray, peak: int, level: float) -> tuple[int, int]:
    """Return the first and last index of the stretch around ``peak`` that stays above ``level``.

    The last is before the first if ``peak`` itself does not.
    """
    below = values <= level
    if below[peak]:
        return peak, peak - 1
    # argmax gives the first True, or 0 if there is none: then the stretch reaches the end.
    left, right = int(below[peak::-1].argmax()), int(below[peak:].argmax())
    return (peak - left + 1 if left else 0), (peak + right - 1 if right else values.size - 1)


def _measure_width(values: FloatArray, peak: int, level: float) -> float:
    """Measure the width in samples between the interpolated crossings of ``level`` around ``peak``.

    Return 0 if ``peak`` itself is not above the level, NaN if a side never falls to it.
    """
    first, last = _find_stretch_above(values, peak, level)
    if last < first:
        return 0.0
    if first == 0 or last == values.size - 1:
        return math.nan
    below, above = values[first - 1 : first + 1].tolist()
    left = first - (above - level) / (above - below)
    above, below = values[last : last + 2].tolist()
    return float(last + (above - level) / (above - below) - left)


@lru_cache(maxsize=1024)
def quartic_design_matrix(n: int) -> tuple[FloatArray, FloatArray]:
    """Return the design matrix of a quartic on n points over -1..1, (n, 5), and its pseudo-inverse, (5, n).

    Both are cached and read-only.
    """
    design = np.vander(np.linspace(-1.0, 1.0, n), 5, increasing=True)
    solver: FloatArray = np.asarray(np.linalg.pinv(design), dtype=np.float64)
    for array in (design, solver):
        array.flags.writeable = False
    return design, solver


def _find_quartic_maximum(values: FloatArray) -> tuple[float, float, float] | None:
    """Return position on -1..1, height and second derivative of the fitted quartic's maximum.

    Return None if there is no maximum within -1..1.
    """
    n = values.size
    design, solver = quartic_design_matrix(n)
    coefficients = solver @ values
    c0, c1, c2, c3, c4 = coefficients.tolist()
    # Newton from the highest grid point: a quartic may have two maxima.
    u = float(design[(design @ coefficients).argmax(), 1])
    for _ in range(20):
        slope = c1 + u * (2.0 * c2 + u * (3.0 * c3 + u * 4.0 * c4))
        curvature = 2.0 * c2 + u * (6.0 * c3 + u * 12.0 * c4)
        if curvature >= 0.0:
            return None
        step = slope / curvature
        u -= step
        if not -1.0 < u < 1.0:
            return None
        if abs(step) < 1e-12:
            break
    height = c0 + u * (c1 + u * (c2 + u * (c3 + u * c4)))
    return u, height, curvature


def _check_extra_pulses(
    record: ReducedRecord, isw: Pulse, psw: Pulse | None, settings: ExtractionSettings, noise_v: float
) -> tuple[bool, bool, bool]:
    """Return whether there is a second strike, a merged PSW, and a pulse that no strike causes.

    ``noise_v``, the standard deviation of the smoothed record in V, raises the thresholds where it exceeds
    what they allow for; 0 leaves them.
    """
    excess_v = _excess_noise_v(isw, noise_v)
    double = not (isw.regular and isw.fwhm_s <= settings.double_isw_width_ratio * settings.isw_fwhm_s)
    merged = psw is not None and not psw.regular
    stray, crest_v = False, NOISE_CRESTS * excess_v
    strong_v = settings.double_above_fraction * isw.amplitude_v + crest_v
    for index in find_prominent_maxima(
        record.smooth_v,
        settings.stray_above_fraction * isw.amplitude_v + crest_v,
        settings.double_valley_fraction * isw.amplitude_v + NOISE_VALLEY * excess_v,
    ):
        time_s, strong = record.time_s(index), record.smooth_v[index] >= strong_v
        if abs(time_s - isw.time_s) <= 0.25 * settings.isw_fwhm_s:
            continue
        if psw is None and time_s > isw.time_s + settings.psw_latest_s:
            continue  # a reflected wave that came too late looks like a second strike
        if psw is not None and time_s > psw.time_s + settings.second_strike_latest_s:
            continue
        if psw is None or abs(time_s - psw.time_s) > settings.merged_distance_s:
            double = double or strong
            stray = stray or (not strong and (psw is None or time_s < psw.time_s))
        elif strong and abs(time_s - psw.time_s) > 0.25 * settings.isw_fwhm_s:
            merged = True
    if psw is not None:
        double = double or psw.amplitude_v > settings.double_above_amplitude_ratio * isw.amplitude_v
        merged = merged or not psw.fwhm_s <= settings.merged_width_ratio * isw.fwhm_s
        # Of two tops only one has been measured.
        stray = stray or (not merged and psw.fwhm_s < settings.stray_width_ratio * isw.fwhm_s)
    return double, merged, stray


def _excess_noise_v(isw: Pulse, noise_v: float) -> float:
    """Return by how much noise, an SD in V of the smoothed record, exceeds what the limits allow for."""
    return max(0.0, noise_v - ALLOWED_NOISE * isw.amplitude_v)


def _has_second_reflection(
    record: ReducedRecord,
    maxima: list[int],
    isw: Pulse,
    psw: Pulse,
    settings: ExtractionSettings,
    noise_v: float,
) -> bool:
    """Check for a hidden second strike by its reflection, when the first reflection covers its wave.

    The ratio of that reflection to the second wave is that of PSW to ISW, and it follows the PSW by about the
    time between the strikes. The PSW hides a wave that came about one time of flight after the first. Return
    False for a time of flight above ``second_reflection_latest_tof_s``. ``noise_v`` is as in
    `_check_extra_pulses`.
    """
    tof_s = psw.matched_time_s - isw.matched_time_s
    if tof_s > settings.second_reflection_latest_tof_s:
        return False
    from_tof_s = settings.window_half_width_s
    earliest_s = max(settings.second_reflection_earliest_s, tof_s - from_tof_s)
    latest_s = min(settings.second_reflection_latest_s, tof_s + from_tof_s)
    first = record.index(psw.matched_time_s + earliest_s)
    last = record.index(psw.matched_time_s + latest_s)
    highest = max((float(record.matched_v[k]) for k in maxima if first <= k <= last), default=0.0)
    # The second wave may stand on the PSW: no more of it counts than a plate sends back.
    reflected_v = min(psw.amplitude_v, settings.highest_reflection_fraction * isw.amplitude_v)
    crest_v = NOISE_CRESTS * _excess_noise_v(isw, noise_v)
    return highest > settings.double_above_fraction * reflected_v + crest_v


def find_prominent_maxima(values: FloatArray, floor: float, valley: float) -> list[int]:
    """Return indices of maxima of at least ``floor``, with a fall of at least ``valley`` between any two.

    Of two maxima without such a fall between them, only the higher one is returned.
    """
    accepted: list[int] = []
    for index in _find_local_maxima(np.maximum(values, floor)):
        if accepted:
            lowest = float(values[accepted[-1] : index].min())
            if min(values[accepted[-1]], values[index]) - lowest < valley:
                if values[index] > values[accepted[-1]]:
                    accepted[-1] = index
                continue
        accepted.append(index)
    return accepted
