"""Hypotheses on what happened to a transducer: each a mean change of the features and its scatter.

Amounts are mixtures over a wide grid, so that a cause is known by its direction, or its curve, and not by a
size that someone guessed. Slopes are those of one model (`slopes`); that others differ is in the scatter.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from analysis.diagnosis.slopes import (
    DAMPING,
    DEPTHS,
    DROP_HEIGHT,
    GAIN,
    MODULUS_K,
    STIFFNESS,
    TILT,
    WALL_B,
    WALL_C,
)
from analysis.waves.record_reduction import FloatArray

OK, WALL, SENSOR, COUPLING, ENVIRONMENT = "ok", "wall", "sensor", "coupling", "environment"
CAUSES = (WALL, SENSOR, COUPLING, ENVIRONMENT)

PRIOR = {OK: 0.9} | dict.fromkeys(CAUSES, 0.025)
"""Before anything is seen; the causes alike, since no one has counted them in the field."""
WANDERING = 0.03
"""Part of `OK`: a healthy transducer that has moved as far as its baseline's sets scatter, beyond the slow
wander that the baseline shows."""
RE_SEATS = 0.9
"""Part of what happens to contacts that comes from one set to the next; the others age, dry or get dirty."""

MISMATCH = 0.2
"""SD of the part by which a real contact changes a feature more or less than the model's, and a real wall all
of them alike. What is 0 is 0 on all: no wall acts on the incident wave, no gain on a time."""
WALL_MISMATCH = 0.1
"""The same of a wall, each feature alone: what no other depth explains (assumption)."""
SIZES = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Of each source's usual size below, to either side."""

USUAL_STIFFNESS, USUAL_DAMPING = 0.05, 0.25
"""SD of ln A and ln gamma of a re-seated contact (assumption: a contact's stiffness follows the root of
its radius, its dashpot anything that lies between)."""
USUAL_GAIN, USUAL_DROP, USUAL_TILT_RAD, USUAL_WEAR = 0.03, 0.05, 0.004, 0.05
"""SD of ln gain, ln drop height, tilt and ln radius (assumptions)."""
USUAL_K = 5.0
SENSITIVITY_PER_K, FRICTION_PER_K = 3e-3, 2e-3
"""SD of what a kelvin does to ln gain (soft PZT: some 2e-3) and to ln drop height (assumption)."""

TRIED_DEPTHS = np.geomspace(0.0025, DEPTHS[-1], 18)
"""As densely as `MISMATCH` blurs the times of flight of neighbours."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hypothesis:
    """Hypothesis of one cause with one size.

    Attributes
    ----------
    mean, covariance
        Of the change of the logarithms, shapes (7,) and (7, 7); in units of the baseline's own covariance
        where ``of_baseline``.
    abrupt
        Part of such changes that comes from one set to the next; the others grow.
    weight
        Probability beforehand.
    """

    cause: str
    mean: FloatArray
    covariance: FloatArray
    abrupt: float
    weight: float


def make_hypotheses(baseline: FloatArray) -> tuple[Hypothesis, ...]:
    """Build the hypotheses of `OK` and all causes, with prior weights that sum to 1.

    Parameters
    ----------
    baseline
        Covariance of a healthy set's logarithms, shape (7, 7).
    """
    zero, nothing = np.zeros(len(baseline)), np.zeros_like(baseline)
    found = [
        Hypothesis(
            cause=OK,
            mean=zero,
            covariance=covariance,
            abrupt=0.5,
            weight=PRIOR[OK] * part,
        )
        for covariance, part in ((nothing, 1.0 - WANDERING), (baseline, WANDERING))
    ]
    found += _weight_hypotheses(WALL, list(_make_wall_hypotheses()), abrupt=0.0)
    found += _weight_hypotheses(SENSOR, list(_spread_over_sizes(_build_sensor_covariances())), abrupt=0.5)
    found += _weight_hypotheses(COUPLING, list(_spread_over_sizes(_coupling_covariances())), abrupt=RE_SEATS)
    found += _weight_hypotheses(ENVIRONMENT, list(_spread_over_sizes([_thermal_covariance()])), abrupt=0.0)
    return tuple(found)


Signature = tuple[FloatArray, FloatArray]


def _weight_hypotheses(cause: str, signatures: Sequence[Signature], *, abrupt: float) -> list[Hypothesis]:
    """Build hypotheses of one cause from pairs of mean and covariance; they share its prior in equal parts.

    ``abrupt`` is the fraction of such changes that occurs from one set to the next.
    """
    return [
        Hypothesis(
            cause=cause,
            mean=mean,
            covariance=covariance,
            abrupt=abrupt,
            weight=PRIOR[cause] / len(signatures),
        )
        for mean, covariance in signatures
    ]


def _make_wall_hypotheses() -> Iterator[Signature]:
    """Yield mean change and covariance of the log features, (7,) and (7, 7), for each patch and wall loss.

    A wall change has one direction, and its features follow a curve over the depth of the loss.
    """
    for patch in (WALL_B, WALL_C):
        curve = np.vstack([np.zeros(len(patch[0])), patch])
        for depth in TRIED_DEPTHS:
            change = np.array([np.interp(depth, (0.0, *DEPTHS), column) for column in curve.T])
            yield change, MISMATCH**2 * np.outer(change, change) + np.diag((WALL_MISMATCH * change) ** 2)


def _spread_over_sizes(covariances: Sequence[FloatArray]) -> Iterator[Signature]:
    """Yield each covariance times the square of each of `SIZES`, with mean zero: either sign is possible."""
    for covariance in covariances:
        for size in SIZES:
            yield np.zeros(len(covariance)), size**2 * covariance


def _sum_source_covariances(sources: Sequence[tuple[Sequence[float], float]]) -> FloatArray:
    """Return the covariance of independent sources, shape (7, 7), each given by slope and SD.

    A slope, length 7, is the change of the log features per unit of the source. `MISMATCH` adds independent
    scatter to each feature's own variance.
    """
    slopes = np.array([slope for slope, _ in sources]) * np.array([sd for _, sd in sources])[:, None]
    return np.asarray(slopes.T @ slopes + MISMATCH**2 * np.diag((slopes**2).sum(axis=0)))


def _build_sensor_covariances() -> list[FloatArray]:
    """Return the covariance, shape (7, 7), of each sensor fault alone: one component fails at a time.

    In order: sensor gain, drop height of the striker, tilt of the sensor disk, wear of all contacts.
    """
    gain = np.array(GAIN)
    wear = 0.5 * np.sum(STIFFNESS, axis=0)  # A goes with the root of the radius
    return [
        USUAL_GAIN**2 * np.outer(gain, gain),
        _sum_source_covariances([(DROP_HEIGHT, USUAL_DROP)]),
        _sum_source_covariances([(TILT, USUAL_TILT_RAD)]),
        _sum_source_covariances([(wear.tolist(), USUAL_WEAR)]),
    ]


def _coupling_covariances() -> list[FloatArray]:
    """Return the two covariances, shape (7, 7), of coupling changes.

    First the contact of chain and plate alone, then a re-seated chain: all contacts, drop height, tilt and
    gain.
    """
    foot = [(STIFFNESS[-1], USUAL_STIFFNESS), (DAMPING[-1], USUAL_DAMPING)]
    everywhere = [(slope, USUAL_STIFFNESS) for slope in STIFFNESS]
    everywhere += [(slope, USUAL_DAMPING) for slope in DAMPING]
    everywhere += [(DROP_HEIGHT, 0.5 * USUAL_DROP), (TILT, 0.5 * USUAL_TILT_RAD), (GAIN, 0.5 * USUAL_GAIN)]
    return [_sum_source_covariances(foot), _sum_source_covariances(everywhere)]


def _thermal_covariance() -> FloatArray:
    """Return the covariance, shape (7, 7), of a temperature change: modulus, PZT and the striker's guide."""
    return _sum_source_covariances(
        [
            ([1e-3 * slope for slope in MODULUS_K], USUAL_K),
            (GAIN, SENSITIVITY_PER_K * USUAL_K),
            (DROP_HEIGHT, FRICTION_PER_K * USUAL_K),
        ]
    )
