"""MEWMA control chart that raises alarms: its limit from the baseline's autocorrelation, tails and size.

Each set is freed of what it owes to the one before (`directions`), whitened, cut back to the radius that a
healthy set passes once in a hundred (so that one rogue set cannot alarm alone), and averaged (`mewma`). The
limit keeps to a budget of false alarms. A short baseline cannot show slow drift: its autocorrelation is taken
to be larger than found. Any linear mixture of the features gives the same chart.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy  # `scipy.special` comes when asked for
from numpy.typing import ArrayLike

from analysis.statistics.baseline_check import compute_trend_p_value
from analysis.statistics.directions import Directions, find_directions
from analysis.statistics.limits import f_predictive_limit
from analysis.statistics.memory import LARGEST_PHI, innovation, prewhiten_sets
from analysis.statistics.mewma import WEIGHT, compute_averages, estimated_limit
from analysis.waves.record_reduction import FloatArray

CAP_RATE = 0.01
ENOUGH_SETS = 150
"""Fewer cannot show a memory of tens of sets: no rate is promised."""
WIDENED_BY = 3.0
"""Standard errors by which memory is taken to be larger: chosen by simulation of features of unequal memory,
to keep the budget (`benchmarks/false_alarms.py`)."""
SLOW_RATE = 0.015
"""Chance that a healthy baseline of independent sets is said to have a trend, or to wander."""
BLOCKS = 10
CHUNK = 512


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Chart:
    """Control chart designed for one baseline.

    Attributes
    ----------
    mean
        Of the features, shape (p,).
    directions, phi
        Directions of autocorrelation, shape (p, p) (`directions.Directions.matrix`), and its size, shape
        (p,).
    whitening
        Turns what is new in a set along the directions, shape (p,), into a row with covariance 1: row @
        whitening. Its columns correspond to the features (`distance.contributions`), so that the parts of the
        statistic are theirs.
    cap
        Longest whitened vector that enters the average.
    limit
        Of the statistic.
    """

    mean: FloatArray
    directions: FloatArray
    phi: FloatArray
    whitening: FloatArray
    cap: float
    limit: float

    def whiten_sets(self, vectors: ArrayLike) -> FloatArray:
        """Return the chart's inputs, whitened and clipped, shape (n, p), for sets from the baseline on.

        ``vectors`` has shape (n, p); an incomplete set gives NaN.
        """
        return self._whiten_and_clip(prewhiten_sets(self._project_sets(vectors), 0.0, self.phi))

    def whiten_next_set(self, vector: FloatArray, before: FloatArray, distance: int) -> FloatArray:
        """Return the chart's clipped whitened input of one complete set, shape (p,).

        ``before`` is the last complete set, ``distance`` sets earlier.
        """
        return self._whiten_and_clip(
            innovation(self._project_sets(vector), self._project_sets(before), distance, self.phi)
        )

    def _project_sets(self, vectors: ArrayLike) -> FloatArray:
        """Subtract the baseline's mean from vectors, shape (..., p), and project them onto the directions."""
        return np.asarray((np.asarray(vectors, dtype=np.float64) - self.mean) @ self.directions)

    def _whiten_and_clip(self, new: FloatArray) -> FloatArray:
        """Whiten the innovations of sets, shape (..., p), and shorten vectors longer than the cap."""
        w = new @ self.whitening
        length = np.sqrt((w**2).sum(axis=-1, keepdims=True))
        return np.asarray(w * np.minimum(1.0, self.cap / np.maximum(length, 1e-300)))

    def run(self, whitened: FloatArray) -> tuple[FloatArray, list[int]]:
        """Compute the statistic of whitened inputs, shape (n, p), from zero; restart after each alarm.

        Returns
        -------
        statistic
            Shape (n,); NaN where a row has one: the average stays as it was.
        onsets
            Rows at which the statistic exceeded the limit.
        """
        statistic = np.full(len(whitened), np.nan)
        onsets: list[int] = []
        rows = np.flatnonzero(np.isfinite(whitened).all(axis=1))
        z, first = np.zeros(whitened.shape[1]), 0
        while first < rows.size:
            part = rows[first : first + CHUNK]
            path = compute_averages(whitened[part], z)
            values = (2.0 - WEIGHT) / WEIGHT * (path**2).sum(axis=1)
            beyond = np.flatnonzero(values > self.limit)
            done = int(beyond[0]) + 1 if beyond.size else part.size
            statistic[part[:done]] = values[:done]
            z = path[done - 1]
            if beyond.size:
                onsets.append(int(part[done - 1]))
                z = np.zeros_like(z)
            first += done
        return statistic, onsets


def design_chart(baseline: ArrayLike, run_length: float, least_phi: ArrayLike = 0.0) -> Chart:
    """Design the MEWMA control chart of a baseline for a mean run length between false alarms.

    ``run_length`` counts sets. Raise SingularCovarianceError if a feature is a combination of the others, and
    InvalidInputError unless ``run_length`` exceeds 1.

    Parameters
    ----------
    baseline
        Shape (n, p); rows with a NaN are gaps and keep their place.
    least_phi
        Lower bound of the autocorrelation along the directions, falling, known from elsewhere; a number, or
        shape (p,).
    """
    x = np.asarray(baseline, dtype=np.float64)
    n, p = int(np.isfinite(x).all(axis=1).sum()), x.shape[1]
    found = find_directions(x)
    phi = np.maximum(widen_phi(found), least_phi)
    return build_chart(x, found.matrix, phi, estimated_limit(n, p, run_length))


def build_chart(baseline: FloatArray, directions: FloatArray, phi: FloatArray, limit: float) -> Chart:
    """Build the control chart of a baseline, shape (n, p), with known autocorrelation and limit.

    ``directions`` has shape (p, p), ``phi`` (p,); rows with a NaN are gaps. Raise LinAlgError if the sets do
    not scatter along a direction.
    """
    complete = np.isfinite(baseline).all(axis=1)
    n, p = int(complete.sum()), baseline.shape[1]
    mean = baseline[complete].mean(axis=0)
    new = prewhiten_sets((baseline - mean) @ directions, 0.0, phi)[complete]
    root = np.linalg.inv(np.linalg.cholesky(np.atleast_2d(np.cov(new, rowvar=False)))).T
    # Turned so that features in their SD times the whole is symmetric, as a whitening by features is.
    left, _, right = np.linalg.svd(baseline[complete].std(axis=0)[:, None] * (directions @ root))
    return Chart(
        mean=mean,
        directions=directions,
        phi=phi,
        whitening=root @ (left @ right).T,
        cap=math.sqrt(f_predictive_limit(n, p, CAP_RATE)),
        limit=limit,
    )


def widen_phi(found: Directions) -> FloatArray:
    """Return an autocorrelation above the estimate, shape (p,), with more margin for few sets; at most 0.95.

    artanh phi is half the logarithm of (1 + phi)/(1 - phi), by which autocorrelation widens the scatter of
    slow averages: that factor is increased by the same ratio for all directions. Standard errors of phi
    itself would add more where it is large, though there the largest of several estimates is too large
    anyway.
    """
    steps = np.arctanh(found.guarded) + WIDENED_BY * found.error
    return np.asarray(np.minimum(np.tanh(steps), LARGEST_PHI))


def explain_unverified_rate(baseline: ArrayLike) -> str:
    """Return why the chart's false-alarm rate is not verified (English text); empty where it is.

    Reasons are fewer than 150 sets, a trend and slow drift. Raise SingularCovarianceError as `design_chart`.

    Parameters
    ----------
    baseline
        Shape (n, p), as `design_chart` had it.
    """
    x = np.asarray(baseline, dtype=np.float64)
    complete = np.isfinite(x).all(axis=1)
    n = int(complete.sum())
    if n < ENOUGH_SETS:
        return f"{n} sets, {ENOUGH_SETS} needed"
    if compute_trend_p_value(x[complete], np.flatnonzero(complete)) < SLOW_RATE:
        return "the baseline has a trend: find its cause, or record another"
    if compute_slow_drift_p_value(_whiten_without_lag_1(x)[complete]) < SLOW_RATE:
        return "the baseline has slow drift, which its lag-1 autocorrelation does not explain: find the cause"
    return ""


def _whiten_without_lag_1(baseline: FloatArray) -> FloatArray:
    """Whiten a baseline, shape (n, p), without its lag-1 autocorrelation and unclipped; NaN at gaps.

    Raise SingularCovarianceError if a feature is a combination of the others.
    """
    found = find_directions(baseline)
    chart = build_chart(baseline, found.matrix, found.phi, math.inf)
    return replace(chart, cap=math.inf).whiten_sets(baseline)


def compute_slow_drift_p_value(whitened: FloatArray) -> float:
    """Return the p-value of a chi-square test for slow drift between 10 blocks of sets, shape (n, p).

    It is the chance that the block means of independent sets scatter so much. Sets after the last full block
    are ignored; n must be at least 10.
    """
    n, p = whitened.shape
    length = n // BLOCKS
    means = whitened[: BLOCKS * length].reshape(BLOCKS, length, p).mean(axis=1)
    spread = length * float(((means - means.mean(axis=0)) ** 2).sum())
    return float(scipy.special.chdtrc((BLOCKS - 1) * p, spread))
