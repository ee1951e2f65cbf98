"""What a set of shots knows about the wall: Fisher information of an array, and a law for its first choice.

All features are logarithms, so a change is a fraction. The linear part of the information comes from slopes
over the scatter of each source instead of derivatives: the amplitude ratio is curved within that scatter.
"""

from __future__ import annotations

import math

import numpy as np
import scipy  # its parts come when asked for: they are slow to import
from numpy.typing import ArrayLike

from analysis.errors import InvalidInputError
from analysis.statistics.limits import f_predictive_limit, predictive_scale
from analysis.waves.record_reduction import FloatArray

QUADRATURE_SD = math.sqrt(3.0)
"""Outer nodes of the Gauss-Hermite quadrature with three nodes, in standard deviations."""
POWER = 0.9
"""Probability with which a detectable loss is detected."""
LAW_SLOPE, LAW_MASS = 2.95, 2.9
"""Constants of `predict_ratio_slope`, found by a fit to simulated arrays."""


def compute_set_covariance(
    low: ArrayLike, middle: ArrayLike, high: ArrayLike, *, set_sd: ArrayLike, shot_sd: ArrayLike, shots: int
) -> FloatArray:
    """Compute the covariance of the mean features of a set from those of shots with one source moved.

    Each feature is a parabola in each source. Sources are normal and independent.

    Parameters
    ----------
    low, high
        Features with each source moved down and up by `QUADRATURE_SD` times its total SD, shape
        (n_sources, p).
    middle
        Features with no source moved, shape (p,).
    set_sd, shot_sd
        SD of each source from set to set and from shot to shot, shape (n_sources,); not both 0.
    shots
        Number of shots of a set.
    """
    down, up, level = (np.asarray(values, dtype=np.float64) for values in (low, high, middle))
    set_variance, shot_variance = np.square(set_sd), np.square(shot_sd)
    of_set = set_variance / (set_variance + shot_variance)
    slope, bend = (up - down) / (2.0 * QUADRATURE_SD), (up + down - 2.0 * level) / (2.0 * QUADRATURE_SD**2)
    linear = of_set + (1.0 - of_set) / shots
    quadratic = 2.0 * (of_set**2 + (1.0 - of_set**2) / shots)
    return np.asarray((slope.T * linear) @ slope + (bend.T * quadratic) @ bend)


def compute_distances(changes: ArrayLike, covariance: FloatArray) -> FloatArray:
    """Return the Mahalanobis distance d' of each change of a set's mean features, shape (k, p) to (k,).

    A change with NaN has the distance NaN. Raise InvalidInputError if the covariance has no inverse.
    """
    shifts, sd = np.atleast_2d(np.asarray(changes, dtype=np.float64)), np.sqrt(np.diag(covariance))
    if not np.all(sd > 0.0):
        raise InvalidInputError("a feature of the healthy sets is missing or does not scatter")
    try:
        root = np.linalg.cholesky(covariance / np.outer(sd, sd))
    except np.linalg.LinAlgError as error:
        raise InvalidInputError("the features depend on each other: their covariance is singular") from error
    return np.array([np.linalg.norm(np.linalg.solve(root, shift / sd)) for shift in shifts])


def estimate_distances(sound: ArrayLike, thinned: ArrayLike) -> FloatArray:
    """Estimate d' at k losses from sets of n_sensors, each sensor's scatter being about its own mean.

    The bias of the inverse covariance is removed. Sets with NaN are left out.

    Parameters
    ----------
    sound
        Mean features of healthy sets, shape (n_sensors, n_sets, p).
    thinned
        The same sets at each loss, shape (k, n_sensors, n_sets, p).

    Raises
    ------
    InvalidInputError
        Too few complete sets, or as `compute_distances`.
    """
    healthy, changed = np.asarray(sound, dtype=np.float64), np.asarray(thinned, dtype=np.float64)
    complete = np.asarray(np.isfinite(healthy).all(axis=2) & np.isfinite(changed).all(axis=(0, 3)))
    p, least = healthy.shape[2], 2 * healthy.shape[2]
    if complete.sum(axis=1).min() < least:
        raise InvalidInputError(f"{complete.sum(axis=1).min()} complete sets of a sensor; d' needs {least}")
    rest = np.concatenate(
        [sets[seen] - sets[seen].mean(axis=0) for sets, seen in zip(healthy, complete, strict=True)]
    )
    dof = len(rest) - len(healthy)
    changes = [(sets - healthy)[complete].mean(axis=0) for sets in changed]
    return compute_distances(changes, rest.T @ rest / (dof - p - 1))


def compute_detectable_distance(sets: int, features: int, false_rate: float) -> float:
    """Compute the d' that one set exceeds the F limit with, in 90 % of cases.

    Parameters
    ----------
    sets
        Number of sets of the baseline.
    false_rate
        Probability that a healthy set exceeds the limit.

    Raises
    ------
    InvalidInputError
        A baseline of too few sets, or a rate outside (0, 1).
    """
    limit = f_predictive_limit(sets, features, false_rate) / predictive_scale(sets, features)
    noncentrality = scipy.special.ncfdtrinc(features, sets - features, 1.0 - POWER, limit)
    return float(math.sqrt(noncentrality * (sets + 1.0) / sets))


def find_detectable_loss(losses: ArrayLike, distances: ArrayLike, required: float) -> float:
    """Find the loss at which d' reaches a value, linear in between from 0; infinity if it does not.

    ``losses``, rising from above 0, and ``distances`` have the shape (k,).
    """
    x, y = np.append(0.0, losses), np.maximum.accumulate(np.append(0.0, distances))
    return float(np.interp(required, y, x)) if required <= y[-1] else math.inf


def predict_ratio_slope(inelasticity: float, sphere_mass_kg: float, patch_mass_kg: float) -> float:
    """Predict the change of ln AR by the loss, as a fraction of the wall, of a thinned patch.

    ``d ln AR / d loss = -2.95 lambda (1 - exp(-2.9 lambda M / m))``, lambda Zener's inelasticity (eq. 9), m
    the mass of a sphere and M that of the plate in the patch, ``rho h s^2``. In the exponent, lambda M / m
    goes with the square of the patch's edge s over the reach of bending waves within the time of contact.
    """
    reach = LAW_MASS * inelasticity * patch_mass_kg / sphere_mass_kg
    return LAW_SLOPE * inelasticity * math.expm1(-reach)
