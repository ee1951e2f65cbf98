"""Diagnosis parameters of a frozen baseline: hypotheses with their courses, in whitened coordinates."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis.diagnosis.hypotheses import PRIOR, Hypothesis, make_hypotheses
from analysis.diagnosis.noise import average_until_end, fit_noise_variances
from analysis.diagnosis.slopes import COMPONENTS
from analysis.errors import InvalidInputError, SingularCovarianceError
from analysis.statistics.baseline import whitening_matrix
from analysis.waves.record_reduction import FloatArray

STEPS = np.unique(np.round(np.geomspace(1.0, 250.0, 100)))
"""Sets since a step. Finely, or a gross step between two of them would fit a growth better."""
GROWTHS = np.round(np.geomspace(64.0, 512.0, 7))
"""Sets since a growth began, or all since the baseline where these are fewer: no wall is lost in a day of
sets, and faster ones hardly differ from a step."""
FEWEST_GROWN = 32
"""Sets since the baseline without which nothing is said to grow."""
POWERS = (1.0, 2.0)
"""Of a growth in time: even, or ever faster, as the time of flight over an even loss of wall."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DiagnosisParameters:
    """Diagnosis parameters of a frozen baseline.

    Attributes
    ----------
    mean
        Of the seven logarithms, shape (7,).
    whitening
        Turns a change of the logarithms, shape (7,), into one with covariance 1: row @ whitening.
    n, last_index
        Complete sets of the baseline, and the index of the last one.
    variances_in_time
        Of each part that varies in time (`noise.MEMORIES_SETS`), shape (7,).
    ends
        Averages of the changes when the baseline ended, shape (2, 7).
    rows
        Indices of the hypotheses of each cause.
    weights
        Of each hypothesis with each course in time, beforehand; shape (h, s).
    abrupt
        Which hypotheses may come at once.
    variances, directions
        Eigendecomposition of the hypotheses' covariances in whitened coordinates: shapes (h, 7), (h, 7, 7).
    means
        Along these directions, shape (h, 7).
    """

    mean: FloatArray
    whitening: FloatArray
    n: int
    last_index: int
    variances_in_time: FloatArray
    ends: FloatArray
    rows: Mapping[str, list[int]]
    weights: FloatArray
    abrupt: NDArray[np.intp]
    variances: FloatArray
    directions: FloatArray
    means: FloatArray


def log_features(values: Mapping[str, float | None]) -> FloatArray | None:
    """Return the natural logarithms of a set's features in the order of `COMPONENTS`, shape (7,).

    Return None if a feature is missing, not finite or not positive.
    """
    found = [values.get(name) for name in COMPONENTS]
    known = [value for value in found if value is not None and math.isfinite(value) and value > 0.0]
    return np.log(known) if len(known) == len(found) else None


def compute_diagnosis_parameters(history: ArrayLike, first_index: int = 0) -> DiagnosisParameters:
    """Compute the diagnosis parameters from the logarithms of the baseline's features.

    Parameters
    ----------
    history
        Logarithms in the order of time, shape (n, 7); rows of NaN are gaps and keep their place. The caller
        supplies at least 15 complete rows.
    first_index
        Index of the first row in the schedule.

    Raises
    ------
    InvalidInputError
        The history has another shape.
    SingularCovarianceError
        A feature is constant, or a combination of others.
    """
    x = np.asarray(history, dtype=np.float64)
    if x.ndim != 2 or x.shape[1] != len(COMPONENTS):
        raise InvalidInputError(f"history has shape {x.shape}; it must be (n, {len(COMPONENTS)})")
    indices = np.flatnonzero(np.isfinite(x).all(axis=1))
    complete = x[indices]
    n, p = complete.shape
    mean = complete.mean(axis=0)
    # Inverse of a covariance estimated from few sets is too large by this.
    covariance = np.cov(complete, rowvar=False) * (n - 1.0) / (n - p - 2.0)
    sd = np.sqrt(np.diag(covariance))
    if not sd.all():
        raise SingularCovarianceError(f"{COMPONENTS[int(sd.argmin())]} is constant in all {n} baseline sets")
    whitening = whitening_matrix(covariance / np.outer(sd, sd)) / sd[:, None]
    known = make_hypotheses(covariance)
    in_white = [whitening.T @ one.covariance @ whitening for one in known]
    variances, directions = np.linalg.eigh(np.array(in_white))
    return DiagnosisParameters(
        mean=mean,
        whitening=whitening,
        n=n,
        last_index=first_index + int(indices[-1]),
        variances_in_time=fit_noise_variances((complete - mean) @ whitening, indices),
        ends=average_until_end(complete - mean),
        rows={cause: [k for k, one in enumerate(known) if one.cause == cause] for cause in PRIOR},
        weights=np.array([_prior_weights(one) for one in known]),
        abrupt=np.flatnonzero([one.abrupt > 0.0 for one in known]),
        variances=np.maximum(variances, 0.0),
        directions=directions,
        means=np.einsum("hi,hij->hj", np.array([one.mean for one in known]) @ whitening, directions),
    )


def _prior_weights(one: Hypothesis) -> FloatArray:
    """Return the prior probability of a hypothesis with each of s time courses, shape (s,).

    The courses are `STEPS`, weighted by their logarithmic spacing, then growths in equal parts.
    """
    since, courses = np.gradient(np.log(STEPS)), len(GROWTHS) * len(POWERS)
    growth = one.weight * (1.0 - one.abrupt) / courses
    return np.concatenate([one.weight * one.abrupt * since / since.sum(), np.full(courses, growth)])
