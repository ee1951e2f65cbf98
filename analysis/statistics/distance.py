"""Mahalanobis squared distance of a set from a baseline (paper, eq. 16), and each feature's contribution."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from analysis.errors import InvalidInputError
from analysis.statistics.baseline import Baseline
from analysis.waves.record_reduction import FloatArray


def _standardize_vectors(vectors: ArrayLike, baseline: Baseline) -> FloatArray:
    """Standardize vectors by the mean and SD of a baseline, shape (..., p).

    Raise InvalidInputError if the last axis is not the baseline's features.
    """
    x = np.asarray(vectors, dtype=np.float64)
    if x.shape[-1:] != (baseline.p,):
        raise InvalidInputError(
            f"vectors have shape {x.shape}; the last axis must be the {baseline.p} features"
        )
    return np.asarray((x - baseline.mean) / baseline.sd)


def distance_squared(vectors: ArrayLike, baseline: Baseline) -> FloatArray:
    """Return D = (x - mean)^T K^-1 (x - mean) (paper, eq. 16); NaN where a feature is missing.

    K is the baseline's covariance. Raise InvalidInputError if the last axis is not the baseline's features.

    Parameters
    ----------
    vectors
        Shape (..., p), features in the baseline's order.

    Returns
    -------
    FloatArray
        Shape (...).
    """
    return np.asarray(contributions(vectors, baseline).sum(axis=-1))


def contributions(vectors: ArrayLike, baseline: Baseline) -> FloatArray:
    """Return the contribution of each feature to the squared distance: never negative, and they sum to it.

    The corr-max transformation: z = (x - mean) / SD, w = C^(-1/2) z with the symmetric root of the
    correlation matrix C, parts w_j^2. Of all rotations of the whitened vector it is the one whose components
    correlate most with their features. Source: Garthwaite and Koch (2016), Australian & New Zealand Journal
    of Statistics 58(1), 99-119, doi:10.1111/anzs.12144. Raise InvalidInputError as `distance_squared`.

    Parameters
    ----------
    vectors
        Shape (..., p).

    Returns
    -------
    FloatArray
        Shape (..., p).
    """
    whitened = _standardize_vectors(vectors, baseline) @ baseline.whitening
    return np.asarray(whitened**2)


def named_contributions(vector: ArrayLike, baseline: Baseline) -> dict[str, float]:
    """Return each feature's contribution to the squared distance of one vector, shape (p,), by name.

    Raise InvalidInputError for another shape.
    """
    parts = contributions(vector, baseline)
    if parts.ndim != 1:
        raise InvalidInputError(f"vector has shape {np.shape(vector)}; it must be ({baseline.p},)")
    return dict(zip(baseline.feature_names, parts.tolist(), strict=True))
