"""Noise of a healthy transducer's features over time: components with different autocorrelation times.

Each part is a first-order autoregression with a memory of its own; together they stand for anything from
independent sets over memory from set to set to a wander that is slower than the baseline. What few sets
cannot show is as it is assumed beforehand.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from analysis.diagnosis.state import averaging_weights, covariance_of_averages
from analysis.waves.record_reduction import FloatArray

MEMORIES_SETS = (0.0, 1.5, 5.0, 15.0, 50.0, 150.0, 500.0)
"""Sets in which a part forgets all but 1/e. The slowest ones outlast a baseline."""
PHI = np.array([np.exp(-1.0 / sets) if sets else 0.0 for sets in MEMORIES_SETS])
BEFOREHAND = np.array([0.4, 0.15, 0.1, 0.05, 0.05, 0.05, 0.05])
"""Variance of each part before the baseline is seen, in units of a set's (assumption: most is new in each
set, and no slow part is likelier than another)."""
WORTH_SETS = 4.0
"""Degrees of freedom that this is worth."""
ITERATIONS = 25
MOST_SETS = 256
"""The last ones of a longer baseline: slower parts are not distinguished any better."""
UNKNOWN_MEAN = 100.0
"""Variance of a baseline's true mean in units of a set's: it may lie anywhere."""
END_RATES = (0.1, 0.02)
"""Weights of the averages that tell where the wander stood when the baseline ended."""


def fit_noise_variances(whitened: FloatArray, indices: NDArray[np.intp]) -> FloatArray:
    """Estimate the variance of each noise component, shape (7,), shared by all directions (penalized ML).

    Each step multiplies a variance by the root of the ratio of what the sets show to what it explains, the
    prior (inverse gamma, mode `BEFOREHAND`) taken in as further sets: a minorize-maximize algorithm, which
    never lowers the posterior density. Source: Zhou, Hu, Zhou, Lange (2019), "MM algorithms for variance
    components models", J. Comput. Graph. Stat. 28, 350-361.
    Only the last 256 sets are used; there are always 25 steps.

    Parameters
    ----------
    whitened
        Complete sets of the baseline in the order of time, covariance 1; shape (n, p).
    indices
        Of these sets in the schedule, shape (n,).
    """
    w, at = whitened[-MOST_SETS:], indices[-MOST_SETS:]
    distance = np.abs(np.subtract.outer(at, at))
    parts = PHI[:, None, None] ** distance
    seen, directions = w @ w.T, w.shape[1]
    found = BEFOREHAND
    for _ in range(ITERATIONS):
        precision = np.linalg.inv(np.tensordot(found, parts, 1) + UNKNOWN_MEAN)
        shown = np.tensordot(parts, precision @ seen @ precision, 2)
        explained = directions * np.tensordot(parts, precision, 2)
        shown += WORTH_SETS * BEFOREHAND / found**2
        found = found * np.sqrt(shown / (explained + WORTH_SETS / found))
    return np.asarray(found)


def average_until_end(changes: FloatArray) -> FloatArray:
    """Average a baseline's deviations, shape (n, 7), exponentially up to its end; shape (2, 7).

    Rows are the rates of `END_RATES`; the deviations are those from the baseline's mean.
    """
    return np.asarray(_end_weights(len(changes)) @ changes)


def _end_weights(n: int) -> FloatArray:
    """Return the exponential weights of n sets at each of `END_RATES`, the newest set last; shape (2, n)."""
    ago = np.arange(n)[::-1]
    return np.array([rate * (1.0 - rate) ** ago for rate in END_RATES])


@lru_cache(maxsize=64)
def _compute_reference_moments(sets: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the moments of three reference averages: the mean of ``sets`` sets, and two at their end.

    Each is a weighted sum of the sets; the noise components have variance 1. Cached: not to be written.

    Returns
    -------
    sums, covariance, reach
        Sum of weights, shape (3,); by component, shape (7, 3, 3); covariance with the last set, shape (7, 3).
    """
    rows, at = np.vstack([np.full(sets, 1.0 / sets), _end_weights(sets)]), np.arange(sets)
    reach = PHI[:, None] ** at[::-1] @ rows.T
    covariance = [rows @ phi ** np.abs(np.subtract.outer(at, at)) @ rows.T for phi in PHI]
    return rows.sum(axis=1), np.array(covariance), reach


@lru_cache(maxsize=2048)
def compute_noise_covariance(n: int, since: int, confirmation_ago: int | None, reference: int) -> FloatArray:
    """Return the covariance of the observations by component, in units of its variance; shape (7, r, r).

    Cached: callers must not write to the result.

    Rows are the averages at the end of the reference sets, those of the last n sets, and a confirmation, all
    as differences from the mean of the reference sets.

    Parameters
    ----------
    n, since
        Sets in the averages, and scheduled sets since the reference ended, at least n.
    confirmation_ago
        See `state.averaging_weights`.
    reference
        Number of reference sets.
    """
    sums, before, reach = _compute_reference_moments(reference)
    after = averaging_weights(n, confirmation_ago)
    k, r = len(sums), len(after)
    # A difference is an average less the mean of reference, as often as its weights sum to.
    from_mean = np.eye(k + r)[1:]
    from_mean[:, 0] = -np.concatenate([sums[1:], after.sum(axis=1)])
    together = np.zeros((len(PHI), k + r, k + r))
    for part, phi in zip(together, PHI.tolist(), strict=True):
        part[k:, k:] = covariance_of_averages(n, phi, confirmation_ago)
    together[:, :k, :k] = before
    together[:, :k, k:] = reach[:, :, None] * (PHI[:, None] ** (since - np.arange(n)) @ after.T)[:, None]
    together[:, k:, :k] = together[:, :k, k:].transpose(0, 2, 1)
    return np.asarray(from_mean @ together @ from_mean.T)
