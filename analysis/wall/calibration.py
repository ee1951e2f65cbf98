"""Calibration to a sensor's baseline: mean and scatter of its sets, with the twin's slopes as prior."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analysis.errors import InvalidInputError
from analysis.statistics.baseline import whitening_matrix
from analysis.wall.bank import FEATURES, Bank
from analysis.waves.record_reduction import FloatArray

FEWEST_SETS = 15
"""Sets of a baseline, as for the Mahalanobis distance."""
PRIOR_SETS = 10.0
"""Degrees of freedom of the inverse-Wishart prior: twice as many as features, so that its mean exists."""
SOURCE_SD = {
    "stiffness": 0.02,
    "damping": 0.2,
    "drop_height": 0.02,
    "tilt_rad": 0.002,
    "gain": 0.01,
    "modulus_k": 2.0,
}
"""Standard deviation of a healthy set's sources before its baseline is seen, in the units of `Bank.slopes`
(ln, but rad for the tilt, K for `modulus_k`): round numbers, assumed. They count as `PRIOR_SETS`."""
SLOW_DRIFT = 0.5
"""Variance of the slow drift of later sets, which a baseline of a day does not show, divided by the variance
of its sets, if that is the prior's; it grows with the square of their ratio: healthy sets at two levels of
the twin, even seeds."""
LARGEST_DIFFERENCE = np.array([0.15, 0.7, 0.7, 0.25])
"""Largest difference of the baseline's ln features from those of the sound twin. The amplitude depends on
the sensor's gain and is not compared. A time in us instead of s differs by 13.8."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """Sets of a sensor as its baseline shows them: a multivariate t distribution of ln features.

    Attributes
    ----------
    mean
        Of the baseline's sets, shape (5,), in the order of `bank.FEATURES`.
    whitening
        Turns a difference from the mean into one with the scale matrix 1: row @ whitening, shape (5, 5).
    dof
        Degrees of freedom.
    """

    mean: FloatArray
    whitening: FloatArray
    dof: float
    slow: float = 0.3
    """Fraction of the variance of a set that its slow drift has: the next sets share it."""


def calibrate(bank: Bank, history: ArrayLike, expected: FloatArray | None = None) -> Calibration:
    """Calibrate a bank to the ln features of a baseline's sets, shape (n, 5); sets with NaN are left out.

    The covariance has an inverse-Wishart prior: what the sources of `SOURCE_SD` do by the twin's slopes.
    ``expected``: ln features of the twin at that baseline, if not those of its sound wall.

    Raises
    ------
    InvalidInputError
        The history has another shape or fewer than 15 complete sets, or the sound twin does not explain it.
    SingularCovarianceError
        The features of bank and baseline together have no inverse covariance.
    """
    x = np.asarray(history, dtype=np.float64)
    if x.ndim != 2 or x.shape[1] != len(FEATURES):
        raise InvalidInputError(f"history has shape {x.shape}; it must be (n, {len(FEATURES)})")
    x = x[np.isfinite(x).all(axis=1)]
    n, p = x.shape
    if n < FEWEST_SETS:
        raise InvalidInputError(f"a baseline of {n} complete sets; a wall thickness needs {FEWEST_SETS}")
    mean = x.mean(axis=0)
    for name, difference, limit in zip(
        FEATURES, mean - (bank.sound if expected is None else expected), LARGEST_DIFFERENCE, strict=False
    ):
        if abs(difference) > limit:
            raise InvalidInputError(
                f"{name} of the baseline is {np.exp(difference):.3g} times that of the twin; "
                f"at most a factor {np.exp(limit):.3g} is explained. Check unit, position, and the keys of "
                "chain and plate"
            )
    sd = [next(sd for start, sd in SOURCE_SD.items() if name.startswith(start)) for name in bank.sources]
    of_sources = bank.slopes * np.array(sd)[:, None]
    prior, prior_sets = of_sources.T @ of_sources, PRIOR_SETS - p - 1.0
    scatter = (x - mean).T @ (x - mean) + prior_sets * prior
    ratio = scatter / (n - 1.0 + prior_sets)
    drift = SLOW_DRIFT * math.exp(2.0 / p * (np.linalg.slogdet(ratio)[1] - np.linalg.slogdet(prior)[1]))
    dof = PRIOR_SETS + n - p
    scale = (1.0 + drift) * scatter * (1.0 + 1.0 / n) / dof
    root = np.sqrt(np.diag(scale))
    whitening = whitening_matrix(scale / np.outer(root, root), FEATURES) / root[:, None]
    return Calibration(mean=mean, whitening=whitening, dof=dof, slow=drift / (1.0 + drift))
