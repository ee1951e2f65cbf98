"""Default limit of the squared distance, chosen from the baseline's autocorrelation and tails.

Where the sets remember one another, the distance is that of what is new in each; where the tails are heavy,
the limit allows for them. Else it is the plain F limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.statistics.baseline import Baseline, fit_baseline
from analysis.statistics.distance import distance_squared
from analysis.statistics.heavy_tails import HEAVY, tail_limit
from analysis.statistics.limits import f_predictive_limit
from analysis.statistics.memory import innovation, pooled_phi, prewhiten_sets, significant_phi
from analysis.statistics.rules import NOMINAL_RATE
from analysis.waves.record_reduction import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DefaultLimit:
    """Limit chosen from the data, with the reason.

    Attributes
    ----------
    phi
        Lag-1 autocorrelation that is removed; 0: it is not significant.
    mean
        Of the sets, shape (p,).
    residuals
        Baseline of what is new in each set; the sets' own where ``phi`` is 0.
    limit, because
        Of the squared distance from ``residuals``, and why it is this one.
    tail
        Limit that allows for the baseline's tails, over the F limit.
    """

    phi: float
    mean: FloatArray
    residuals: Baseline
    limit: float
    reason: str
    tail: float

    def distances_squared(self, vectors: FloatArray) -> FloatArray:
        """Return squared distances, shape (n,), of sets in order of time, the baseline first, shape (n, p).

        NaN for incomplete sets.
        """
        new = prewhiten_sets(vectors, self.mean, self.phi) if self.phi else vectors
        known = np.asarray(np.isfinite(new).all(axis=1))
        distances = distance_squared(np.where(known[:, None], new, 0.0), self.residuals)
        return np.asarray(np.where(known, distances, np.nan))

    def distance_squared_after(self, vector: FloatArray, before: FloatArray, distance: int) -> float:
        """Return the squared distance of one complete set, shape (p,), from the residuals.

        ``before`` is the last complete set, ``distance`` sets earlier.
        """
        new = vector
        if self.phi:
            new = innovation(vector - self.mean, before - self.mean, distance, self.phi)
        return float(distance_squared(new, self.residuals))


def default_limit(history: FloatArray, baseline: Baseline, rate: float = NOMINAL_RATE) -> DefaultLimit:
    """Choose the default outlier limit of a baseline from autocorrelation and tails of its data.

    ``rate`` is the false-alarm rate of one set. Raise SingularCovarianceError if the sets without their
    autocorrelation have a singular covariance.

    Parameters
    ----------
    history
        Sets of the baseline in the order of time, shape (n, p); rows of NaN are gaps and keep their place.
    baseline
        Fitted to its complete rows.
    """
    n, p = baseline.n, baseline.p
    phi = significant_phi(pooled_phi(history), n)
    residuals = baseline
    if phi:
        new = prewhiten_sets(history, baseline.mean, phi)
        residuals = fit_baseline(
            new[np.isfinite(new).all(axis=1)],
            baseline.set_indices,
            name=f"{baseline.name} without memory",
            feature_names=baseline.feature_names,
        )
    plain, allowing = f_predictive_limit(n, p, rate), tail_limit(residuals.distances_squared, p, rate)
    heavy = allowing > HEAVY * plain
    memory = "prewhitened" if phi else "independent"
    return DefaultLimit(
        phi=phi,
        mean=baseline.mean,
        residuals=residuals,
        limit=allowing if heavy else plain,
        reason=f"{memory}, {'heavy tails: left-out limit' if heavy else 'F limit'}",
        tail=allowing / plain,
    )
