"""Features of a solitary-wave shot and of a set of shots (paper, section 4; definitions below).

All features come from x, the record in volts minus its quiet level:

- ``tof_pp_s``: PSW minus ISW time, each the peak of a quartic fitted by least squares above half height
  (the paper's "peak to peak"); amplitudes are the heights of these quartics.
- ``tof_mf_s``: the same between the maxima of a matched filter with kernel cos^4(pi t / W), |t| < W/2,
  W = 2.75 x the ISW's FWHM of the baseline: the quietest one, for detection and inversion.
- ``tof_ac_s``, ``autocorrelation_coefficient``: x is set to zero outside [t_ISW - 90 us, t_PSW + 90 us];
  R(k) is its linear autocorrelation, smoothed by a triangle with a base of 10 us (that is, the
  autocorrelation of x after a 5-us moving mean); R(0) is not smoothed and loses the noise's share,
  N_gate sigma^2. ``tof_ac_s`` is the lag of the maximum of r = R/R(0) within 40 us of ``tof_pp_s``, the
  coefficient is r there. For two equal pulses of ratio a it is a / (1 + a^2), less .15 % by the triangle:
  it nearly repeats the ratio.
- ``psw_area_v_s``: integral of x over t_PSW +- 90 us; ``psw_isw_area_ratio`` is free of gain.

These estimators are different quantities once the PSW is skewed: never mix two versions of the
extractor in one baseline.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Any, Literal

import numpy as np

from analysis.errors import InvalidInputError, RecordError
from analysis.waves.disturbance import (
    find_noise_free_flags,
    has_drift,
    has_edge,
    is_clipped,
    is_flat_topped,
    measure_deepest_pull,
)
from analysis.waves.noise_colour import strongest_block_noise_v, wandering_noise_v
from analysis.waves.outline import FEWEST, Outline, sample_outline
from analysis.waves.pulses import Pulse, Pulses, find_pulses, interpolate_parabola_peak
from analysis.waves.quality_gate import DISTURBED, FLAGS, INVALIDATING_FLAGS, MINIMUM_VALID_SHOTS
from analysis.waves.record_reduction import (
    MAD_TO_SD,
    STANDS_OUT,
    ExtractionSettings,
    FloatArray,
    ReducedRecord,
    VoltRecord,
    check_record,
    column_medians,
    equal_weights,
    reduce_records,
)
from analysis.waves.uncertainty import propagate_noise_to_features
from hardware_drivers.measurement import Waveform

Quality = Literal["good", "suspect", "bad"]

EXTRACTOR_VERSION = "1.9"
"""Changes whenever any feature of any record or set would, and so with the flags."""

FAR_APART = 10.0
"""Standard deviations: of ten normal values one lies so far from the others in two sets of a thousand."""
JUMP_S, FRONT_S = 2e-6, 20e-6
JUMP_PART = 0.7
"""Of the record's highest: a spike is that itself, less what noise adds elsewhere."""

RECORDS_AT_ONCE = 32
"""So that a long file needs little memory."""

FEATURE_NAMES = (
    "tof_pp_s",
    "tof_ac_s",
    "amplitude_ratio",
    "autocorrelation_coefficient",
    "psw_area_v_s",
)
"""The five of the Mahalanobis vector, in its order (paper, below eq. 15)."""

OTHER_FEATURE_NAMES = (
    "tof_mf_s",
    "isw_amplitude_v",
    "psw_amplitude_v",
    "ssw_amplitude_v",
    "isw_time_s",
    "psw_time_s",
    "ssw_time_s",
    "isw_fwhm_s",
    "psw_isw_area_ratio",
    "noise_rms_v",
)
ALL_FEATURE_NAMES = FEATURE_NAMES + OTHER_FEATURE_NAMES
_EVERY_FEATURE = attrgetter(*ALL_FEATURE_NAMES)


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotFeatures:
    """Features of one shot; NaN where not available.

    Attributes
    ----------
    flags
        What is wrong with the shot, of `FLAGS`, in that order.
    valid
        No flag of `INVALIDATING_FLAGS`.
    quality
        ``good`` (no flag), ``suspect`` (valid, with a flag) or ``bad`` (not valid).
    pull_fraction
        How far the record falls below its quiet level, of the ISW's amplitude
        (`disturbance.measure_deepest_pull`).
    compared
        The flags count what the set's other shots show already, as in `template.compare_with_template`.
    outline
        The record at some points, next to which other shots' are seen; None without a reflected wave.
    sd
        Standard deviation that the record's own noise gives a feature, by name; empty where no one
        asked for it.
    """

    tof_pp_s: float = math.nan
    tof_ac_s: float = math.nan
    amplitude_ratio: float = math.nan
    autocorrelation_coefficient: float = math.nan
    psw_area_v_s: float = math.nan
    tof_mf_s: float = math.nan
    isw_amplitude_v: float = math.nan
    psw_amplitude_v: float = math.nan
    ssw_amplitude_v: float = math.nan
    isw_time_s: float = math.nan
    psw_time_s: float = math.nan
    ssw_time_s: float = math.nan
    isw_fwhm_s: float = math.nan
    psw_isw_area_ratio: float = math.nan
    noise_rms_v: float = math.nan
    flags: tuple[str, ...] = ()
    valid: bool = True
    quality: Quality = "good"
    pull_fraction: float = math.nan
    compared: bool = False
    outline: Outline | None = field(default=None, compare=False, repr=False)
    sd: Mapping[str, float] = field(default_factory=dict)

    def values(self) -> dict[str, float]:
        """Return every feature by name, in the order of `ALL_FEATURE_NAMES`; NaN where not available."""
        return dict(zip(ALL_FEATURE_NAMES, _EVERY_FEATURE(self), strict=True))

    def vector(self) -> FloatArray:
        """Return the shot's five features of the Mahalanobis vector, shape (5,); NaN where one is missing."""
        return np.array([getattr(self, name) for name in FEATURE_NAMES])


def apply_flags(shot: ShotFeatures, found: Collection[str]) -> ShotFeatures:
    """Return the shot with ``found`` as its flags, in the order of `FLAGS`, and the quality that follows.

    An unknown flag is dropped.
    """
    return replace(shot, **_grade_flags(found))


def _grade_flags(found: Collection[str]) -> dict[str, Any]:
    """Derive ordered flags, validity and quality of a shot from the flags found, as `ShotFeatures` fields."""
    flags = tuple(flag for flag in FLAGS if flag in found)
    valid = INVALIDATING_FLAGS.isdisjoint(flags)
    return {
        "flags": flags,
        "valid": valid,
        "quality": "bad" if not valid else "suspect" if flags else "good",
    }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SetFeatures:
    """Mean features of a set's valid shots.

    Attributes
    ----------
    mean, sd
        By name (`ALL_FEATURE_NAMES`). Means are NaN where fewer than the demanded number of shots
        are valid; standard deviations (one shot, n - 1) also for a single shot.
    n_shots, n_valid
        Shots handed in, and those in the mean.
    quality
        ``bad``: too few valid shots, not to be assessed; ``suspect``: some shots were left out or at
        least half of the valid ones are suspect; else ``good``.
    reason
        Why the quality is not good, empty if it is.
    """

    mean: dict[str, float]
    sd: dict[str, float]
    n_shots: int
    n_valid: int
    quality: Quality
    reason: str

    def vector(self) -> FloatArray:
        """Return the set's means of the five Mahalanobis features, shape (5,); NaN where one is missing."""
        return np.array([self.mean[name] for name in FEATURE_NAMES])


def extract_features(waveform: Waveform, settings: ExtractionSettings = ExtractionSettings()) -> ShotFeatures:  # noqa: B008 frozen, so a shared default is safe
    """Extract the features of one shot from its waveform.

    Parameters
    ----------
    waveform
        Record with at least some pre-trigger and all of the search windows.

    Raises
    ------
    RecordError
        The record is too short, too coarse or has no pre-trigger (a poor shot is flagged instead), or a
        calibration coefficient is not finite.
    """
    return extract_all([waveform], settings)[0]


def extract_all(
    waveforms: Sequence[Waveform],
    settings: ExtractionSettings = ExtractionSettings(),  # noqa: B008 frozen
) -> list[ShotFeatures]:
    """Extract the features of many shots, bit-identical to those of each alone.

    Each step runs for all shots before the next one, which is faster than one shot after the other.
    The result has the order of the waveforms, which may differ in rate and length.

    Raises
    ------
    RecordError
        As for `extract_features` if any record is unsuitable, or a calibration coefficient is not finite.
    """
    if not all(np.isfinite(w.calibration.coefficients_v).all() for w in waveforms):
        raise RecordError("a calibration's coefficients must be finite")
    given = [
        VoltRecord(w.volts(), w.sample_rate_hz, w.pretrigger_samples, clipped=w.clipped) for w in waveforms
    ]
    return _extract_records(given, settings)


def extract_from_average(
    waveforms: Sequence[Waveform],
    settings: ExtractionSettings = ExtractionSettings(),  # noqa: B008 frozen
) -> ShotFeatures:
    """Extract the features of the mean of a set's records (the paper's way); clipped if any record is.

    The records are averaged as triggered, not aligned: a jitter of the trigger widens the pulses.

    Raises
    ------
    RecordError
        No record, records that differ in rate, length or pre-trigger, or as for `extract_features`.
    """
    if not waveforms:
        raise RecordError("no record to average; a set needs at least one")
    shapes = {(w.counts.size, w.sample_rate_hz, w.pretrigger_samples) for w in waveforms}
    if len(shapes) != 1:
        raise RecordError(
            f"records to average differ in (samples, sample_rate_hz, pretrigger_samples): {sorted(shapes)}"
        )
    total = waveforms[0].volts()
    for waveform in waveforms[1:]:
        total += waveform.volts()
    return extract_from_volts(
        total / len(waveforms),
        waveforms[0].sample_rate_hz,
        waveforms[0].pretrigger_samples,
        clipped=any(waveform.clipped for waveform in waveforms),
        settings=settings,
    )


def extract_from_volts(
    volts_v: FloatArray,
    sample_rate_hz: float,
    pretrigger_samples: int,
    *,
    clipped: bool = False,
    settings: ExtractionSettings = ExtractionSettings(),  # noqa: B008 frozen
    with_sd: bool = False,
) -> ShotFeatures:
    """Extract the features of a record in volts, shape (n_samples,); see `extract_features`.

    Parameters
    ----------
    with_sd
        Also compute the standard deviation of each feature (`analysis.waves.uncertainty`).

    Raises
    ------
    RecordError
        A voltage is not finite, the shape is another one, or as for `extract_features`.
    """
    samples = np.asarray(volts_v, dtype=np.float64)
    if samples.ndim != 1 or not np.isfinite(samples.sum()):
        raise RecordError(f"volts_v must be finite numbers of shape (n_samples,), got shape {samples.shape}")
    given = VoltRecord(samples, sample_rate_hz, pretrigger_samples, clipped=clipped)
    return _extract_records([given], settings, with_sd=with_sd)[0]


def _extract_records(
    given: Sequence[VoltRecord], settings: ExtractionSettings, *, with_sd: bool = False
) -> list[ShotFeatures]:
    """Extract the features of records, in their order; at most 32 of one kind are processed together.

    Each time is taken, and given back, in the time in which the ISW has the width of the paper's chain
    (`ExtractionSettings.stretch`). Raise RecordError as `extract_features`.
    """
    stretch, usual = settings.stretch, settings.unstretched()
    kinds: dict[tuple[int, float, int], list[int]] = {}
    for number, one in enumerate(given):
        kinds.setdefault(one.kind, []).append(number)
    found: dict[int, ShotFeatures] = {}
    for numbers in kinds.values():
        check_record(given[numbers[0]], settings)
        for k in range(0, len(numbers), RECORDS_AT_ONCE):
            together = numbers[k : k + RECORDS_AT_ONCE]
            alike = [
                replace(given[number], sample_rate_hz=given[number].sample_rate_hz * stretch)
                for number in together
            ]
            found.update(
                zip(together, _extract_same_kind(alike, usual, stretch, with_sd=with_sd), strict=True)
            )
    return [found[number] for number in range(len(given))]


def _stretch_times(values: Mapping[str, float], stretch: float) -> dict[str, float]:
    """Return the values by name with those in s or V s multiplied by a factor."""
    return {name: v * stretch if name.endswith("_s") else v for name, v in values.items()}


def _extract_same_kind(
    given: Sequence[VoltRecord], settings: ExtractionSettings, stretch: float, *, with_sd: bool
) -> list[ShotFeatures]:
    """Extract the features of records of one length, rate and pre-trigger (`VoltRecord.kind`).

    Rate and settings are those of a time ``stretch`` times as fast, the features are not.

    A record with a false trigger or lost samples has no feature but its noise. Raise RecordError if the
    records are too short, too coarse or without pre-trigger.
    """
    records = reduce_records(given, settings)
    pulses = [find_pulses(record, settings) for record in records]
    rate_hz = given[0].sample_rate_hz
    flagged = [
        _find_flags(record, found, settings, rate_hz, still, at_trigger)
        for record, found, still, at_trigger in zip(
            records,
            pulses,
            find_noise_free_flags(records, rate_hz),
            _check_trigger_jumps(records),
            strict=True,
        )
    ]
    # What something else started looks like a wave at times, and so does what is left of a record.
    measured: list[dict[str, Any]] = [
        _compute_features(record, found, settings)
        if {"false_trigger", "lost_samples"}.isdisjoint(flags)
        else {}
        for record, found, (flags, _) in zip(records, pulses, flagged, strict=True)
    ]
    sds = [
        propagate_noise_to_features(record, found, values, settings) if with_sd else {}
        for record, found, values in zip(records, pulses, measured, strict=True)
    ]
    measured = [_stretch_times(values, stretch) for values in measured]
    return [
        ShotFeatures(
            **values,
            **_grade_flags(flags | {"clipped"} if one.clipped else flags),
            noise_rms_v=record.noise_rms_v,
            pull_fraction=pull,
            outline=_sample_outline(record, found, stretch),
            sd=_stretch_times(sd, stretch),
        )
        for one, record, found, (flags, pull), values, sd in zip(
            given, records, pulses, flagged, measured, sds, strict=True
        )
    ]


def _sample_outline(record: ReducedRecord, pulses: Pulses, stretch: float) -> Outline | None:
    """Sample the outline of a record; None if its incident or reflected wave is missing."""
    isw, psw = pulses.isw, pulses.psw
    return None if isw is None or psw is None else sample_outline(record, isw, psw, stretch)


def _find_flags(
    record: ReducedRecord,
    pulses: Pulses,
    settings: ExtractionSettings,
    rate_hz: float,
    still: set[str],
    at_trigger: tuple[bool, bool],
) -> tuple[set[str], float]:
    """Return a shot's flags, except those of the ADC's range, and its `ShotFeatures.pull_fraction`.

    Lost samples, a jump at the trigger, an inverted wave or a missing incident wave exclude all other flags.
    ``still`` are the flags of `find_noise_free_flags`, ``at_trigger`` the Booleans of `_check_trigger_jumps`.
    """
    if "lost_samples" in still:
        return still, math.nan
    spiked, stirred = at_trigger
    if spiked:
        return {"false_trigger"}, math.nan
    if pulses.inverted:
        return {"inverted"}, math.nan
    isw = pulses.isw
    if isw is None:
        return {"false_trigger" if stirred else "missed"}, math.nan
    noise_v = record.block_noise_v
    smooth_noise_v = noise_v / math.sqrt(record.smooth_blocks)
    found, pull = _find_disturbance_flags(record, pulses, isw, settings, noise_v, smooth_noise_v)
    if found:
        # What this noise cannot do it may where it is stronger in the wave's own band, or below.
        noise_v = strongest_block_noise_v(record, isw.time_s, isw.fwhm_s)
        smooth_noise_v = wandering_noise_v(record, noise_v)
        found, pull = _find_disturbance_flags(record, pulses, isw, settings, noise_v, smooth_noise_v)
    found |= still
    if pulses.stray:
        found.add(DISTURBED)
    if is_clipped(record, isw.matched_time_s, isw.fwhm_s, rate_hz):
        found.add("clipped")
    if pulses.psw is None:
        # What is no strike alone can be no sign of a hole.
        found.add("missed" if DISTURBED in found else "no_psw")
    if pulses.double:
        found.add("double")
    if pulses.psw_merged:
        found.add("psw_merged")
    if isw.amplitude_v < settings.noisy_below_snr * record.noise_rms_v:
        found.add("noisy")
    return found, pull


def _find_disturbance_flags(
    record: ReducedRecord,
    pulses: Pulses,
    isw: Pulse,
    settings: ExtractionSettings,
    noise_v: float,
    smooth_noise_v: float,
) -> tuple[set[str], float]:
    """Return the flags of disturbances that exceed the noise, and the deepest pull over the ISW's amplitude.

    The flags are ``disturbed``, ``clipped`` and ``baseline``; ``noise_v`` is the standard deviation of a
    block mean in V, ``smooth_noise_v`` that of the smoothed record.
    """
    psw_time_s = None if pulses.psw is None else pulses.psw.time_s
    pull, pulled = measure_deepest_pull(
        record, isw.amplitude_v, psw_time_s, smooth_noise_v, settings.deepest_pull_fraction
    )
    seen = {
        DISTURBED: pulled or has_edge(record, isw.amplitude_v, settings.isw_fwhm_s, noise_v),
        "clipped": is_flat_topped(record, isw.matched_time_s, isw.fwhm_s, noise_v),
        "baseline": has_drift(record, isw, pulses.psw, settings.baseline_drift_fraction, noise_v),
    }
    return {flag for flag, is_seen in seen.items() if is_seen}, pull


def _check_trigger_jumps(records: Sequence[ReducedRecord]) -> list[tuple[bool, bool]]:
    """Return two Booleans per record: it jumps at its trigger; it moves there by more than noise.

    A wave needs 20 us to half its height: within `JUMP_S` before and after the trigger it rises by less than
    a quarter of what it reaches in `FRONT_S`. A coil's spike is at its height at once, and nothing in the
    record is much higher; a crest of noise that started the record before the wave is small next to it.
    """
    first = records[0]
    rate_hz = first.block_samples / first.step_s
    trigger = round(0.5 * (first.block_samples - 1) - first.first_s * rate_hz)
    jump, front = max(1, round(JUMP_S * rate_hz)), max(2, round(FRONT_S * rate_hz))
    begin, end = max(0, trigger - 2 * jump), max(0, trigger - jump)
    near = np.array([record.samples_v[begin : trigger + front] - record.offset_v for record in records])
    before, after = near[:, : end - begin], near[:, trigger - begin :]
    if before.size == 0 or after.size == 0:
        return [(False, False)] * len(near)
    height = np.maximum(np.abs(after).max(axis=1), np.abs(before).max(axis=1))
    stirred = height > STANDS_OUT * np.array([record.noise_rms_v for record in records])
    means = np.ascontiguousarray(before).sum(axis=1) / before.shape[1]
    risen = np.abs(after[:, : jump + 1] - means[:, None]).max(axis=1)
    jumped = stirred & (risen >= JUMP_PART * height)
    spiked = [
        jumps and risen_v >= JUMP_PART * float(np.abs(record.blocks_v).max())
        for record, jumps, risen_v in zip(records, jumped.tolist(), risen.tolist(), strict=True)
    ]
    return list(zip(spiked, stirred.tolist(), strict=True))


def _compute_features(
    record: ReducedRecord, pulses: Pulses, settings: ExtractionSettings
) -> dict[str, float]:
    """Compute every feature that the pulses of a record allow, by name; empty without an incident wave."""
    isw, psw, ssw = pulses.isw, pulses.psw, pulses.ssw
    values: dict[str, float] = {}
    if isw is None:
        return values
    values.update(isw_time_s=isw.time_s, isw_amplitude_v=isw.amplitude_v, isw_fwhm_s=isw.fwhm_s)
    if ssw is not None:
        values.update(ssw_time_s=ssw.time_s, ssw_amplitude_v=ssw.amplitude_v)
    if psw is None:
        return values
    psw_area = _integrate_area(record, psw.time_s, settings.window_half_width_s)
    isw_area = _integrate_area(record, isw.time_s, settings.window_half_width_s)
    values.update(
        tof_pp_s=psw.time_s - isw.time_s,
        tof_mf_s=psw.matched_time_s - isw.matched_time_s,
        tof_ac_s=math.nan,
        autocorrelation_coefficient=math.nan,
        amplitude_ratio=psw.amplitude_v / isw.amplitude_v,
        psw_area_v_s=psw_area,
        psw_isw_area_ratio=psw_area / isw_area if isw_area > 0.0 else math.nan,
        psw_time_s=psw.time_s,
        psw_amplitude_v=psw.amplitude_v,
    )
    values.update(_compute_autocorrelation_features(record, isw, psw, settings))
    return values


def _integrate_area(record: ReducedRecord, centre_s: float, half_width_s: float) -> float:
    """Integrate the record over ``centre_s`` +- ``half_width_s`` in V s, cut at the record's ends."""
    n = record.blocks_v.size
    first = min(max(record.index(centre_s - half_width_s) + 0.5, 0.0), float(n))
    last = min(max(record.index(centre_s + half_width_s) + 0.5, 0.0), float(n))
    inner_first, inner_last = math.ceil(first), math.floor(last)
    total = float(record.blocks_v[inner_first:inner_last].sum())
    if inner_first > first:
        total += (inner_first - first) * float(record.blocks_v[inner_first - 1])
    if last > inner_last:
        total += (last - inner_last) * float(record.blocks_v[inner_last])
    return total * record.step_s


def _compute_autocorrelation_features(
    record: ReducedRecord, isw: Pulse, psw: Pulse, settings: ExtractionSettings
) -> dict[str, float]:
    """Compute time of flight in s and coefficient by autocorrelation, by name; empty without a maximum.

    The gate's edges fall on blocks. The autocorrelation is summed over every block of the moving mean instead
    of every sample: the mean leaves nothing for the missing samples to add. The few lags wanted cost less one
    by one than a transform that gives all.
    """
    n = record.blocks_v.size
    first = max(0, round(record.index(isw.time_s - settings.window_half_width_s)))
    last = min(n, round(record.index(psw.time_s + settings.window_half_width_s)) + 1)
    samples = record.samples_v[first * record.block_samples : last * record.block_samples] - record.offset_v
    power = float(np.einsum("i,i->", samples, samples)) - samples.size * record.noise_rms_v**2
    tof = (psw.time_s - isw.time_s) / record.step_s
    search = settings.autocorrelation_search_half_width_s / record.step_s
    low = max(1, math.ceil(tof - search))
    high = min(last - first - 2, math.floor(tof + search))
    if power <= 0.0 or high <= low:
        return {}
    width = max(1, round(0.5 * settings.autocorrelation_triangle_s / record.step_s))
    smooth = np.correlate(record.blocks_v[first:last], equal_weights(width), "full")
    # From one lag before the first wanted to one behind the last.
    later = np.concatenate([smooth[low - 1 :], np.zeros(high - low + 2)])
    correlation = np.correlate(later, smooth[: smooth.size - low + 1], "valid")
    peak = 1 + int(correlation[1:-1].argmax())
    before, centre, after = correlation[peak - 1 : peak + 2].tolist()
    if not before <= centre >= after:
        return {}  # no maximum, so not the PSW's
    shift = interpolate_parabola_peak(before, centre, after)
    height = centre - 0.25 * (before - after) * shift
    return {
        "tof_ac_s": (low - 1 + peak + shift) * record.step_s,
        "autocorrelation_coefficient": height * record.block_samples / power,
    }


def average_features(shots: Sequence[ShotFeatures], minimum_valid: int = MINIMUM_VALID_SHOTS) -> SetFeatures:
    """Average the features of a set's valid shots, without far outliers of each feature.

    A value is left out beyond `FAR_APART` of 1.4826 x the median distance from the median, as long as
    `FEWEST` shots are valid: the mean of all is the better one but for rogue shots.
    A NaN is left out of its feature's mean. Raise InvalidInputError for ``minimum_valid`` below 1.

    Parameters
    ----------
    shots
        Every shot that was taken, valid or not.
    minimum_valid
        Fewer valid shots make no mean (the paper takes ten shots per set).
    """
    if minimum_valid < 1:
        raise InvalidInputError(f"minimum_valid is {minimum_valid}; it must be at least 1")
    valid = [shot for shot in shots if shot.valid]
    n_valid = len(valid)
    counts = Counter(flag for shot in shots for flag in shot.flags)
    listed = ", ".join(f"{flag} in {counts[flag]}" for flag in FLAGS if flag in counts)
    missing = dict.fromkeys(ALL_FEATURE_NAMES, math.nan)
    if n_valid < minimum_valid:
        reason = f"{n_valid} of {len(shots)} shots valid, {minimum_valid} needed"
        return SetFeatures(
            mean=missing,
            sd=dict(missing),
            n_shots=len(shots),
            n_valid=n_valid,
            quality="bad",
            reason=f"{reason} ({listed})" if listed else reason,
        )
    table = np.array([_EVERY_FEATURE(shot) for shot in valid])
    if n_valid >= FEWEST:
        table = _remove_outliers(table)
    mean, sd = _column_statistics(table)
    reasons = []
    if n_valid < len(shots):
        reasons.append(f"{len(shots) - n_valid} of {len(shots)} shots left out")
    n_suspect = sum(shot.quality == "suspect" for shot in valid)
    if 2 * n_suspect >= n_valid:
        reasons.append(f"{n_suspect} of {n_valid} valid shots suspect")
    reason = "; ".join(reasons)
    return SetFeatures(
        mean=dict(zip(ALL_FEATURE_NAMES, mean, strict=True)),
        sd=dict(zip(ALL_FEATURE_NAMES, sd, strict=True)),
        n_shots=len(shots),
        n_valid=n_valid,
        quality="suspect" if reasons else "good",
        reason=f"{reason} ({listed})" if reason else "",
    )


def _remove_outliers(table: FloatArray) -> FloatArray:
    """Replace values more than 10 scaled MADs from their column's median by NaN; same shape.

    Columns with a NaN, or with more than half of their values equal, stay as they are.
    """
    known = np.where(np.isnan(table).any(axis=0), 0.0, table)  # a feature that some shots lack is left alone
    distance = np.abs(known - column_medians(known))
    middle = column_medians(distance)
    # More than half alike have no scatter to compare with.
    return np.where((distance > FAR_APART * MAD_TO_SD * middle) & (middle > 0.0), np.nan, table)


def _column_statistics(table: FloatArray) -> tuple[list[float], list[float]]:
    """Return mean and SD (n - 1) of each column's numbers; NaN where there are too few (none, one)."""
    present = ~np.isnan(table)
    n = present.sum(axis=0)
    filled = np.where(present, table, 0.0)
    mean = np.where(n > 0, filled.sum(axis=0) / np.maximum(n, 1), np.nan)
    residual = np.where(present, table - mean, 0.0)
    sd = np.where(n > 1, np.sqrt((residual**2).sum(axis=0) / np.maximum(n - 1, 1)), np.nan)
    return mean.tolist(), sd.tolist()
