"""Frozen baseline: mean and covariance of the healthy sets, and a check for suspect sets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from analysis.errors import InvalidInputError, NotEnoughSetsError, SingularCovarianceError
from analysis.statistics.limits import phase_one_limit
from analysis.statistics.rules import MINIMUM_SETS
from analysis.waves.features import EXTRACTOR_VERSION, FEATURE_NAMES
from analysis.waves.record_reduction import FloatArray

ADVISED_SETS = 48
"""Fewer sets bring a warning: the paper's 24 hours at one set every 30 minutes."""
SMALLEST_EIGENVALUE = 1e-10
"""Of the correlation matrix; below, a feature is a copy of others to rounding and has no distance."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Baseline:
    """Healthy state of one transducer, never updated (it would learn the damage).

    Attributes
    ----------
    name
        Unique name, for people and the catalogue.
    feature_names, set_indices
        What the columns and rows of the fit were, lengths p and n.
    mean, covariance
        Shapes (p,) and (p, p), covariance with n - 1.
    distances_squared
        Of the baseline's own sets, shape (n,), in the order of ``set_indices``.
    suspects
        Sets beyond ``suspect_limit``; a person decides about them.
    suspect_limit
        Phase I limit: 5 % chance that any of n healthy normal sets exceeds it.
    warnings
        What the reader of an assessment should know.
    extractor_version
        Version of the extractor the vectors came from; versions must not be mixed.
    sd, correlation, whitening
        Of the covariance, the last its correlation's `whitening_matrix`.
    """

    name: str
    feature_names: tuple[str, ...]
    set_indices: tuple[int, ...]
    mean: FloatArray
    covariance: FloatArray
    distances_squared: FloatArray
    suspects: tuple[int, ...]
    suspect_limit: float
    warnings: tuple[str, ...] = ()
    extractor_version: str = EXTRACTOR_VERSION
    sd: FloatArray = field(init=False)
    correlation: FloatArray = field(init=False)
    whitening: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        """Copy arrays read-only; derive SD, correlation and whitening.

        Raise InvalidInputError if shapes do not fit, SingularCovarianceError if a feature is a combination of
        others.
        """
        for name in ("mean", "covariance", "distances_squared"):
            object.__setattr__(self, name, _read_only_copy(getattr(self, name)))
        p, n = len(self.feature_names), len(self.set_indices)
        shapes = (self.mean.shape, self.covariance.shape, self.distances_squared.shape)
        if shapes != ((p,), (p, p), (n,)):
            raise InvalidInputError(
                f"mean, covariance and distances_squared have shapes {shapes}; {p} features of {n} sets "
                f"need ({p},), ({p}, {p}) and ({n},)"
            )
        sd = np.sqrt(np.diag(self.covariance))
        object.__setattr__(self, "sd", _read_only_copy(sd))
        object.__setattr__(self, "correlation", _read_only_copy(self.covariance / np.outer(sd, sd)))
        object.__setattr__(self, "whitening", _read_only_copy(whitening_matrix(self.correlation)))

    @property
    def n(self) -> int:
        """Return the number of sets in the baseline."""
        return len(self.set_indices)

    @property
    def p(self) -> int:
        """Return the number of features of each set."""
        return len(self.feature_names)


def _read_only_copy(values: FloatArray) -> FloatArray:
    """Copy values to a float64 array that cannot be written."""
    copy = np.array(values, dtype=np.float64, copy=True)
    copy.flags.writeable = False
    return copy


def whitening_matrix(correlation: FloatArray, feature_names: Sequence[str] = ()) -> FloatArray:
    """Return the symmetric inverse root C^(-1/2) of a correlation matrix, shape (p, p).

    Parameters
    ----------
    feature_names
        Names for the error message; empty: indices.

    Raises
    ------
    SingularCovarianceError
        An eigenvalue is 0 to rounding.
    """
    values, vectors = np.linalg.eigh(correlation)
    if not values[0] > SMALLEST_EIGENVALUE:
        weights = np.abs(vectors[:, 0])
        names = feature_names or [str(k) for k in range(len(weights))]
        dependent = [names[k] for k in np.flatnonzero(weights > 0.1 * weights.max()).tolist()]
        raise SingularCovarianceError(
            f"{', '.join(dependent)}: one is a combination of the others in the baseline, so no distance "
            f"exists (smallest eigenvalue of the correlation matrix {values[0]:.2g}, it must exceed "
            f"{SMALLEST_EIGENVALUE:g}): leave one out"
        )
    return np.asarray((vectors / np.sqrt(values)) @ vectors.T)


def fit_baseline(
    vectors: ArrayLike,
    set_indices: Sequence[int],
    *,
    name: str,
    feature_names: Sequence[str] = FEATURE_NAMES,
) -> Baseline:
    """Fit mean, covariance and baseline distances to the feature vectors of healthy sets.

    Fewer than 48 sets, or sets above the Phase I limit, give warnings.

    Parameters
    ----------
    vectors
        Shape (n, p), one row per set; sets that are not to be assessed must be left out by the caller.
    set_indices
        Their n indices.

    Raises
    ------
    NotEnoughSetsError
        Fewer than 15 sets (or not more than p + 1); its message is the reason to store next to a null limit.
    SingularCovarianceError
        A feature is constant, or a combination of others.
    InvalidInputError
        Shapes do not fit, or a number is missing.
    """
    x = np.asarray(vectors, dtype=np.float64)
    n, p = len(set_indices), len(feature_names)
    needed = max(MINIMUM_SETS, p + 2)
    if n < needed:
        raise NotEnoughSetsError(
            f"a baseline of {n} sets; at least {needed} are needed and {ADVISED_SETS} advised: "
            "let the test run longer or extend the baseline"
        )
    if x.shape != (n, p):
        raise InvalidInputError(f"vectors have shape {x.shape}; {n} sets of {p} features need ({n}, {p})")
    incomplete = [index for index, row in zip(set_indices, x, strict=True) if not np.isfinite(row).all()]
    if incomplete:
        raise InvalidInputError(
            f"sets {incomplete} lack a feature; leave sets of bad quality out of the baseline"
        )
    mean = x.mean(axis=0)
    covariance = np.atleast_2d(np.cov(x, rowvar=False, ddof=1))
    sd = np.sqrt(np.diag(covariance))
    # Rounding of the mean leaves a constant feature a spread of some 1e-16 of its size.
    constant = [f for f, s, m in zip(feature_names, sd, mean, strict=True) if not s > 1e-12 * abs(m)]
    if constant:
        raise SingularCovarianceError(
            f"{', '.join(constant)} constant in all {n} baseline sets, so no distance exists: "
            "switch the scatter on, or check that the sensor is connected"
        )
    whitened = ((x - mean) / sd) @ whitening_matrix(covariance / np.outer(sd, sd), feature_names)
    distances = (whitened**2).sum(axis=1)
    limit = phase_one_limit(n, p)
    suspects = tuple(int(i) for i, d in zip(set_indices, distances, strict=True) if d > limit)
    return Baseline(
        name=name,
        feature_names=tuple(feature_names),
        set_indices=tuple(int(index) for index in set_indices),
        mean=mean,
        covariance=covariance,
        distances_squared=distances,
        suspects=suspects,
        suspect_limit=limit,
        warnings=_list_warnings(n, suspects),
    )


def _list_warnings(n: int, suspects: tuple[int, ...]) -> tuple[str, ...]:
    """List warnings (English) about a baseline of fewer than 48 sets or with suspects; empty for neither."""
    warnings = []
    if n < ADVISED_SETS:
        warnings.append(f"baseline of {n} sets, {ADVISED_SETS} advised: the false-alarm rate is uncertain")
    if suspects:
        warnings.append(f"sets {list(suspects)} are anomalies of the baseline: inspect them")
    return tuple(warnings)
