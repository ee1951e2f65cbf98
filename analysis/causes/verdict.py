"""Is it the wall? What each set says of its transducer, and how sure that is.

Averages of the logarithms of seven features, of three lengths, are remembered. A cause is a direction (or a
curve) in the features and a course in time: a wall grows, a re-seat is there from one set to the next. Each
cause is judged by the likelihood of the three averages together, beside that of a healthy transducer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis.causes.hypotheses import COUPLING, OK, PRIOR, WALL, Hypothesis, hypotheses
from analysis.causes.memory import (
    MOST_AVERAGED,
    SETTLING,
    Recollection,
    covariance_of_averages,
    reseated,
    weights,
)
from analysis.causes.slopes import COMPONENTS
from analysis.errors import InvalidInputError, SingularCovarianceError
from analysis.statistics.baseline import whitening_matrix
from analysis.statistics.chart import widened_phi
from analysis.statistics.memory import guarded_phi
from analysis.waves.record_reduction import FloatArray

CANNOT_TELL = "cannot tell"
STATED = 0.9
"""Least probability of a cause that is named."""
STEPS = np.unique(np.round(np.geomspace(1.0, 250.0, 100)))
"""Sets since a step. Finely, or a gross step between two of them would fit a growth better."""
GROWTHS = np.round(np.geomspace(16.0, 512.0, 8))
"""Sets since a growth began: no wall is lost in half a day of sets."""
POWERS = (1.0, 2.0)
"""Of a growth in time: even, or ever faster, as the time of flight over an even loss of wall."""
BLOCKS = 10
FEWEST_AVERAGED = 10
"""Sets: the three averages of one or two are copies of each other."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CauseDesign:
    """What a frozen baseline gives to tell causes by.

    Attributes
    ----------
    mean
        Of the seven logarithms, shape (7,).
    whitening
        Turns a change of the logarithms, shape (7,), into one with covariance 1: row @ whitening.
    phi
        Memory from set to set, of all components together.
    slow_variance
        Of the difference between the baseline's mean and the transducer's slow mean, in units of a set's.
    rows
        Which hypotheses stand for a cause.
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
    phi: float
    slow_variance: float
    rows: Mapping[str, list[int]]
    weights: FloatArray
    abrupt: NDArray[np.intp]
    variances: FloatArray
    directions: FloatArray
    means: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class CauseVerdict:
    """What a set says.

    Attributes
    ----------
    cause
        `OK`, one of `hypotheses.CAUSES`, or `CANNOT_TELL`.
    probability
        Of that cause; where it cannot be told, that of the likeliest one, `OK` included.
    probabilities
        Of `OK` and of all causes.
    abrupt
        Probability that the change came from one set to the next.
    changes
        Relative change of each component, by its name: the average of some ten sets.
    confirmed
        With a set struck beside the plan.
    reseated
        It names a re-seat that was not known before.
    """

    cause: str
    probability: float
    probabilities: Mapping[str, float]
    abrupt: float
    changes: Mapping[str, float]
    confirmed: bool
    reseated: bool


def logs_of(values: Mapping[str, float | None]) -> FloatArray | None:
    """Logarithms of a set's features in the order of `COMPONENTS`; None where one is missing."""
    found = [values.get(name) for name in COMPONENTS]
    known = [value for value in found if value is not None and math.isfinite(value) and value > 0.0]
    return np.log(known) if len(known) == len(found) else None


def cause_design(history: ArrayLike) -> CauseDesign:
    """Design from the baseline's sets.

    Parameters
    ----------
    history
        Logarithms in the order of time, shape (n, 7); rows of NaN are gaps and keep their place.

    Raises
    ------
    SingularCovarianceError
        A feature is constant, or a combination of others.
    """
    x = np.asarray(history, dtype=np.float64)
    if x.ndim != 2 or x.shape[1] != len(COMPONENTS):
        raise InvalidInputError(f"history has shape {x.shape}; it must be (n, {len(COMPONENTS)})")
    complete = x[np.isfinite(x).all(axis=1)]
    n, p = complete.shape
    mean, phi = complete.mean(axis=0), float(widened_phi(guarded_phi(x), n).mean())
    # Inverse of a covariance estimated from few sets is too large by this.
    covariance = np.cov(complete, rowvar=False) * (n - 1.0) / (n - p - 2.0)
    sd = np.sqrt(np.diag(covariance))
    if not sd.all():
        raise SingularCovarianceError(f"{COMPONENTS[int(sd.argmin())]} is constant in all {n} baseline sets")
    whitening = whitening_matrix(covariance / np.outer(sd, sd)) / sd[:, None]
    known = hypotheses(covariance)
    in_white = [whitening.T @ one.covariance @ whitening for one in known]
    variances, directions = np.linalg.eigh(np.array(in_white))
    return CauseDesign(
        mean=mean,
        whitening=whitening,
        phi=phi,
        slow_variance=_slow_variance((complete - mean) @ whitening, phi),
        rows={cause: [k for k, one in enumerate(known) if one.cause == cause] for cause in PRIOR},
        weights=np.array([_weights(one) for one in known]),
        abrupt=np.flatnonzero([one.abrupt for one in known]),
        variances=np.maximum(variances, 0.0),
        directions=directions,
        means=np.einsum("hi,hij->hj", np.array([one.mean for one in known]) @ whitening, directions),
    )


def _slow_variance(whitened: FloatArray, phi: float) -> float:
    """Variance of means of a tenth of the baseline, at least that of the baseline's own mean."""
    n = len(whitened)
    length = max(1, n // BLOCKS)
    blocks = n // length
    means = whitened[: blocks * length].reshape(blocks, length, -1).mean(axis=1)
    return max(float((means**2).mean()), (1.0 + phi) / (1.0 - phi) / n)


def verdict_of(memory: Recollection, design: CauseDesign, *, suspicious: bool = False) -> CauseVerdict:
    """Say what the sets so far mean.

    Parameters
    ----------
    suspicious
        A chart of this transducer alarms, or its k of n.
    """
    probabilities, abrupt = _posterior(memory, design, from_moved=False)
    back = memory.n >= FEWEST_AVERAGED and max(probabilities, key=probabilities.__getitem__) == OK
    moved = bool(memory.moved) and not back
    if moved:
        probabilities, abrupt = _posterior(memory, design, from_moved=True)
    likeliest = max(probabilities, key=probabilities.__getitem__)
    sure = probabilities[likeliest] >= STATED
    # What grows may be a wall after all, and a step alone be gone with the next strike.
    contact = likeliest == COUPLING and sure and abrupt >= STATED and bool(memory.beside)
    # A wall does not heal: nothing but a healthy transducer takes it back.
    contact &= not memory.wall
    unsure = (likeliest == COUPLING and not contact) or (memory.wall and likeliest != WALL)
    if moved and likeliest == OK:
        # As it has been since its contact moved, whatever a chart says that knows nothing of that.
        named = likeliest = COUPLING
        probabilities = probabilities | {OK: probabilities[COUPLING], COUPLING: probabilities[OK]}
    elif likeliest != OK and sure and not unsure:
        named = likeliest
    else:
        named = CANNOT_TELL if suspicious or likeliest != OK else OK
    changes = memory.changes[1]
    return CauseVerdict(
        cause=named,
        probability=probabilities[OK if named == OK else likeliest],
        probabilities=probabilities,
        abrupt=abrupt,
        changes={name: math.expm1(change) for name, change in zip(COMPONENTS, changes, strict=True)},
        confirmed=bool(memory.beside) or moved,
        reseated=contact,
    )


def remembering(memory: Recollection, verdict: CauseVerdict) -> Recollection:
    """Keep what was named: a wall until the transducer is healthy again, and a re-seat."""
    if verdict.reseated:
        return reseated(memory)
    healthy = verdict.cause in (OK, COUPLING)
    wall = verdict.cause == WALL or (memory.wall and not healthy)
    return replace(memory, wall=wall, moved=() if verdict.cause == OK else memory.moved)


def _posterior(
    memory: Recollection, design: CauseDesign, *, from_moved: bool
) -> tuple[dict[str, float], float]:
    """Probability of each cause, and of a step, of what changed since the baseline or since a re-seat."""
    averages, noise = memory.averages(from_moved=from_moved), _noise(memory, design, from_moved=from_moved)
    whole = np.linalg.inv(np.linalg.cholesky(noise))
    seen = whole @ averages @ design.whitening
    n, beside_ago = min(max(memory.n, 1), MOST_AVERAGED), memory.beside_ago if memory.beside else None
    course = _courses(n, memory.gap, memory.gap_ago, beside_ago) @ whole.T
    length = np.sqrt((course**2).sum(axis=1))
    along = (course / length[:, None]) @ seen
    steps = _log_densities(design, design.abrupt, along[: len(STEPS)], length[: len(STEPS)])
    growths = _log_densities(design, slice(None), along[len(STEPS) :], length[len(STEPS) :])
    log = np.full(design.weights.shape, -np.inf)
    log[design.abrupt, : len(STEPS)], log[:, len(STEPS) :] = steps, growths
    beforehand = design.weights.copy()
    if memory.n + memory.gap < GROWTHS[0]:
        beforehand[:, len(STEPS) :] = 0.0
    share = np.exp(log - log.max()) * beforehand
    share /= share.sum()
    of_each = share.sum(axis=1)
    by_cause = {cause: float(of_each[rows].sum()) for cause, rows in design.rows.items()}
    return by_cause, float(share[:, : len(STEPS)].sum())


def _log_densities(
    design: CauseDesign, which: NDArray[np.intp] | slice, along: FloatArray, length: FloatArray
) -> FloatArray:
    """Give log densities of hypotheses and courses over that of no change, shape (h, s).

    Parameters
    ----------
    along, length
        What is seen along each course, shape (s, 7), and the course's length, shape (s,).
    """
    parts = along[None] @ design.directions[which] - length[None, :, None] * design.means[which][:, None]
    spread = 1.0 + length[None, :, None] ** 2 * design.variances[which][:, None]
    explained = (parts**2 / spread).sum(axis=2) + np.log(spread.prod(axis=2))
    return np.asarray(0.5 * ((along**2).sum(axis=1) - explained))


def _weights(one: Hypothesis) -> FloatArray:
    """Probability beforehand with each course; half of what may be abrupt or gradual is either."""
    both = 0.5 if one.abrupt and one.gradual else 1.0
    step, growth = (both * one.weight * may for may in (one.abrupt, one.gradual))
    since = np.gradient(np.log(STEPS))
    courses = len(GROWTHS) * len(POWERS)
    return np.concatenate([step * since / since.sum(), np.full(courses, growth / courses)])


@lru_cache(maxsize=512)
def _courses(n: int, gap: int, gap_ago: int, beside_ago: int | None) -> FloatArray:
    """Averages of a change that is 1 by now, `STEPS` first, then growths; shape (s, r).

    The averages begin with the first of n sets after the baseline. A step lies between two sets, however
    far apart they are; what grows goes on growing while the plan has a gap.
    """
    ago = np.arange(n)
    steps = ago < STEPS[:, None]
    planned_ago = ago + gap * (ago >= gap_ago)
    longest = n + gap  # none began in the baseline
    grown = np.maximum(1.0 - planned_ago / np.minimum(GROWTHS, longest)[:, None], 0.0)
    course = np.vstack([steps, *(grown**power for power in POWERS)])
    return np.asarray(course @ weights(n, beside_ago).T)


def _noise(memory: Recollection, design: CauseDesign, *, from_moved: bool) -> FloatArray:
    """Covariance of what a healthy transducer's memory holds, in units of a set's; shape (r, r).

    The slow mean adds to all, to a confirmation's too, and where it sits since a re-seat is learnt from sets.
    """
    n = min(max(memory.n, FEWEST_AVERAGED), MOST_AVERAGED)
    noise = _of_averages(n, design.phi, memory.beside_ago if memory.beside else None)
    slow = design.slow_variance
    if from_moved:
        slow += (1.0 + design.phi) / (1.0 - design.phi) / min(max(memory.n, 1), SETTLING)
    return np.asarray(noise + slow)


_of_averages = lru_cache(maxsize=512)(covariance_of_averages)
