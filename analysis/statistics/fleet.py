"""Assessment of many sensors at once: shared changes, and alarms with a bounded false discovery rate.

A budget for each sensor lets the false alarms grow with the number of sensors. Over a period the chance of
each chart's highest value in a healthy sensor is known, so the false discovery rate of those raised can be
kept instead (Benjamini and Hochberg 1995). Season, process and supply move all sensors: taken out of each is
the median of their deviations, which some sick sensors do not move.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy  # `scipy.signal` and `scipy.stats` come when asked for
from numpy.typing import ArrayLike

from analysis.errors import InvalidInputError, SingularCovarianceError
from analysis.statistics.directions import find_directions
from analysis.statistics.mewma import WEIGHT, compute_averages, estimated_limit
from analysis.statistics.rules import MINIMUM_SETS
from analysis.statistics.sequence import SMALLEST_SD
from analysis.waves.record_reduction import FloatArray

FALSE_DISCOVERY_RATE = 0.1
FEWEST_SENSORS = 20
"""Of fewer the median scatters by more than a quarter of a sensor's SD: their alarms would be its own."""
SHARED_SD = 0.3
"""Less of a shared shift moves no chart by a third of its limit: (2 - w)/w p 0.3^2 = 8.6 at p = 5."""
SHARED_SIGNIFICANCE = 4.5
"""Standard errors: independent sensors reach them in 10^6 features and sets less than seven times."""
RUN_LENGTHS = np.geomspace(10.0, 1e9, 17)
"""The integral equation ends at some 10^10; a chance below its last one is reported as its last."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SharedChange:
    """Sets in which the sensors moved together.

    Attributes
    ----------
    first_row, last_row
        Both included.
    largest_sd
        Largest shift of each feature's average, with its sign, in standard deviations of a sensor.
    """

    first_row: int
    last_row: int
    largest_sd: tuple[float, ...]


@lru_cache(maxsize=64)
def _tabulate_limits(n: int, p: int) -> FloatArray:
    """Return the MEWMA limit at each of `RUN_LENGTHS`, shape (17,), for n baseline sets and p features.

    Cached: callers must not write to it. Raise NotEnoughSetsError for n up to p.
    """
    return np.array([estimated_limit(n, p, length) for length in RUN_LENGTHS.tolist()])


def compute_running_p_values(statistic: FloatArray, n: int, p: int, period: int) -> FloatArray:
    """Return, after each set, the chance that a healthy chart rises so high within a period; shape (sets,).

    It is 1 - exp(-period/ARL), ARL the run length whose limit is the highest value so far; 1 below all
    limits.

    Parameters
    ----------
    statistic
        Of a chart without restarts after alarms, shape (sets,); NaN where a set was not assessed.
    n, p
        Sets and features of the baseline.
    period
        Sets in the whole period: known at its beginning, so that an alarm that was raised stays raised.
    """
    highest = np.maximum.accumulate(np.where(np.isfinite(statistic), statistic, 0.0))
    length = np.exp(np.interp(highest, _tabulate_limits(n, p), np.log(RUN_LENGTHS)))
    return np.asarray(np.where(highest < _tabulate_limits(n, p)[0], 1.0, -np.expm1(-period / length)))


def find_alarm_rows(chances: ArrayLike, rate: float = FALSE_DISCOVERY_RATE) -> list[int | None]:
    """Return the row of the set at which each sensor's alarm is raised; None where it never is.

    At most ``rate`` of the raised alarms are false on average (Benjamini-Hochberg at each set).
    Raise InvalidInputError for a rate outside (0, 1).

    Parameters
    ----------
    chances
        Of `compute_running_p_values`, shape (sensors, sets).
    """
    p = np.asarray(chances, dtype=np.float64)
    if not 0.0 < rate < 1.0:
        raise InvalidInputError(f"the false discovery rate is {rate}; it must lie between 0 and 1")
    if not p.size:
        return [None] * len(p)
    # Nothing is raised before the first chance below the rate itself.
    found = np.zeros(p.shape, dtype=bool)
    some = np.flatnonzero(p.min(axis=0) <= rate)
    found[:, some] = scipy.stats.false_discovery_control(p[:, some], axis=0) <= rate
    return [int(row.argmax()) if row.any() else None for row in found]


def standardize_by_baseline(vectors: ArrayLike, in_baseline: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return deviations from the baseline's mean in SD, shape (sets, p), and these SD, shape (p,).

    A feature that is constant, or never known, in the baseline has SD 1 and no deviation (NaN).
    """
    x = np.asarray(vectors, dtype=np.float64)
    x = np.where(np.isfinite(x), x, np.nan)
    baseline = np.ma.masked_invalid(x[np.asarray(in_baseline, dtype=bool)])
    mean = np.asarray(baseline.mean(axis=0).filled(np.nan))
    with np.errstate(over="ignore"):  # of a table that is refused for it
        sd = np.asarray(baseline.std(axis=0, ddof=1).filled(np.nan))
    sd = np.where(sd > SMALLEST_SD * np.abs(mean), sd, np.nan)
    return np.asarray((x - mean) / sd), np.where(np.isfinite(sd), sd, 1.0)


def shared_deviation(deviations: ArrayLike) -> FloatArray:
    """Return the median over the sensors of each feature's deviation from its baseline, shape (sets, p).

    Parameters
    ----------
    deviations
        In SD of each sensor's own baseline, shape (sensors, sets, p); NaN where a value is missing. Zero
        where fewer than `FEWEST_SENSORS` have one.
    """
    x = np.asarray(deviations)
    known = np.isfinite(x).sum(axis=0)
    result = np.zeros(x.shape[1:])
    full, partly = known == len(x), (known >= FEWEST_SENSORS) & (known < len(x))
    if len(x) >= FEWEST_SENSORS:
        result[full] = np.median(x[:, full], axis=0)
    result[partly] = np.nanmedian(x[:, partly], axis=0)
    return result


def typical_autocorrelation(baselines: Sequence[FloatArray]) -> FloatArray:
    """Return the median over the sensors of the autocorrelation along their directions, shape (p,), falling.

    One baseline shows its autocorrelation to about 1/sqrt(n); a sensor that by chance shows too little of it
    would raise an alarm first. No feature has more autocorrelation than the first direction. Baselines of
    fewer than 15 complete sets or with a singular covariance are skipped; zeros if none remains.

    Parameters
    ----------
    baselines
        Shape (n, p) each, without what all share; NaN where a value is missing.
    """
    phi = []
    for x in baselines:
        if np.isfinite(x).all(axis=1).sum() >= MINIMUM_SETS:
            with suppress(SingularCovarianceError):  # this sensor is refused
                phi.append(find_directions(x).phi)
    return np.asarray(np.median(phi, axis=0)) if phi else np.zeros(baselines[0].shape[1])


def typical_kurtosis(baselines: Sequence[FloatArray]) -> float:
    """Return the mean over the sensors of the relative kurtosis of their baselines, at least 1 (normal sets).

    Heavy tails make a covariance as uncertain as fewer normal sets would: its variance grows by the kurtosis
    E[d^4]/(p (p + 2)), d the Mahalanobis distance (Mardia 1970; for elliptical distributions).
    Baselines of fewer than 15 complete sets are skipped; 1 if none remains.

    Parameters
    ----------
    baselines
        As of `typical_autocorrelation`.
    """
    found = [_kurtosis(x[np.isfinite(x).all(axis=1)].astype(np.float64)) for x in baselines]
    known = [one for one in found if one is not None]
    return max(1.0, float(np.mean(known))) if known else 1.0


def _kurtosis(x: FloatArray) -> float | None:
    """Return Mardia's kurtosis of rows over that of a normal distribution; None for fewer than 15 rows."""
    n, p = x.shape
    if n < MINIMUM_SETS:
        return None
    centred = x - x.mean(axis=0)
    distances = ((centred @ np.linalg.pinv(centred.T @ centred / n)) * centred).sum(axis=1)
    return float((distances**2).mean() / (p * (p + 2)))


def find_shared_changes(
    shared: FloatArray, n_sensors: int, phi: float, first_row: int
) -> tuple[SharedChange, ...]:
    """Find the runs of sets in which the shared average is too large for independent sensors, in order.

    Return an empty tuple for fewer than 20 sensors.

    Parameters
    ----------
    shared
        Of `shared_deviation`, shape (sets, p).
    phi
        Lag-1 autocorrelation of a sensor.
    first_row
        Not before this one, which is the first after the baseline.
    """
    if n_sensors < FEWEST_SENSORS:
        return ()
    decay = (1.0 - WEIGHT) * phi
    variance = np.pi / 2.0 / n_sensors * WEIGHT / (2.0 - WEIGHT) * (1.0 + decay) / (1.0 - decay)
    limit = max(SHARED_SD, SHARED_SIGNIFICANCE * float(np.sqrt(variance)))
    average = compute_averages(shared, np.zeros(shared.shape[1]))
    beyond = (np.abs(average) > limit).any(axis=1) & (np.arange(len(shared)) >= first_row)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], beyond, [False]]).astype(int)))
    return tuple(
        SharedChange(first_row=int(a), last_row=int(b) - 1, largest_sd=_find_largest_deviations(average[a:b]))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    )


def mean_squared_correlation(baselines: Sequence[FloatArray]) -> FloatArray:
    """Return the mean over the sensors of the squared correlations of the features, shape (p, p).

    For normal sets they are the correlations of the errors of the SDs. Baselines of fewer than 15 complete
    sets are skipped; the identity if none remains.

    Parameters
    ----------
    baselines
        As of `typical_autocorrelation`.
    """
    known = [x[np.isfinite(x).all(axis=1)].astype(np.float64) for x in baselines]
    found = [np.corrcoef(x, rowvar=False) ** 2 for x in known if len(x) >= MINIMUM_SETS]
    return np.mean(found, axis=0) if found else np.eye(baselines[0].shape[1])


def estimate_gain(
    deviations: FloatArray, shared: FloatArray, correlation2: FloatArray
) -> tuple[float, float, float]:
    """Estimate the gain of a sensor to the shared change: 1 where it moves as the median does.

    Parameters
    ----------
    deviations, shared
        Of one sensor and of the fleet, shape (sets, p), after the baselines.
    correlation2
        Of `mean_squared_correlation`.

    Returns
    -------
    tuple
        The gain, its variance for independent sets, and the part of the variance of one feature's SD that
        enters it. NaN: nothing is shared.
    """
    # Next to their means: what is wrong with the mean of a baseline is no gain.
    x = np.ma.masked_invalid(deviations)
    moved = np.ma.masked_array(shared, mask=np.ma.getmaskarray(x))
    moved = (moved - moved.mean(axis=0)).filled(0.0)
    of_feature = (moved**2).sum(axis=0)
    weight = float(of_feature.sum())
    if weight == 0.0:
        return np.nan, np.nan, np.nan
    found = float((moved * x.filled(0.0)).sum() / weight)
    return found, 1.0 / weight, float(of_feature @ correlation2 @ of_feature) / weight**2


def residual_shift(
    gains: ArrayLike, causes: Sequence[SharedChange], *, phi: float, n: int, tails: float
) -> float:
    """Estimate the shift that remains in a sensor after the shared change is removed, in SD (3 scaled MAD).

    Scatter of the gains that sets and baseline SDs explain by chance is subtracted: n sets show an SD to
    sqrt((kurtosis - 1)/(4 n)), widened by autocorrelation. Return 0 without a shared change or a known gain.

    Parameters
    ----------
    gains
        Of `estimate_gain`, shape (sensors, 3).
    causes
        Shared changes; the largest deviation in them scales the result.
    phi, n, tails
        Typical lag-1 autocorrelation, sets of a baseline, and kurtosis over that of normal sets.
    """
    found = np.asarray(gains, dtype=np.float64)
    found = found[np.isfinite(found).all(axis=1)]
    if not causes or not len(found):
        return 0.0
    largest = max(abs(size) for cause in causes for size in cause.largest_sd)
    scatter = float(scipy.stats.median_abs_deviation(found[:, 0], scale="normal"))
    of_sets, of_sd = np.median(found[:, 1:], axis=0).tolist()
    by_chance = of_sets * (1.0 + phi) / (1.0 - phi)
    by_chance += of_sd * (3.0 * tails - 1.0) / (4.0 * n) * (1.0 + phi**2) / (1.0 - phi**2)
    return float(3.0 * np.sqrt(max(0.0, scatter**2 - by_chance)) * largest)


def _find_largest_deviations(average: FloatArray) -> tuple[float, ...]:
    """Return each feature's deviation of largest magnitude over all rows, with its sign; length p."""
    rows: Sequence[int] = np.abs(average).argmax(axis=0).tolist()
    return tuple(float(average[row, feature]) for feature, row in enumerate(rows))
