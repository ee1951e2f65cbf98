"""Is it the wall? What each set says of its transducer, and how sure that is.

Averages of the logarithms of seven features, of three lengths, are remembered. A cause is a direction (or a
curve) in the features and a course in time: a wall grows, a re-seat is there from one set to the next. Each
cause is judged by the likelihood of the three averages together, beside that of a healthy transducer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from analysis.causes.hypotheses import COUPLING, OK, PRIOR, WALL, Hypothesis, hypotheses
from analysis.causes.slopes import COMPONENTS
from analysis.errors import InvalidInputError, SingularCovarianceError
from analysis.statistics.baseline import whitening_matrix
from analysis.statistics.chart import widened_phi
from analysis.statistics.memory import guarded_phi
from analysis.waves.record_reduction import FloatArray

CANNOT_TELL = "cannot tell"
STATED = 0.9
"""Least probability of a cause that is named."""
RATES = (0.5, 0.1, 0.02)
"""Weights of the averages: the last sets, those of half a day, those of two days at one an hour."""
STEPS = np.unique(np.round(np.geomspace(1.0, 250.0, 100)))
"""Sets since a step. Finely, or a gross step between two of them would fit a growth better."""
GROWTHS = np.round(np.geomspace(16.0, 512.0, 8))
"""Sets since a growth began: no wall is lost in half a day of sets."""
POWERS = (1.0, 2.0)
"""Of a growth in time: even, or ever faster, as the time of flight over an even loss of wall."""
BLOCKS = 10
FEWEST_AVERAGED, MOST_AVERAGED = 10, 250
"""Sets: the three averages of one or two are copies of each other, and further ones change nothing."""


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
    means, variances, directions
        The hypotheses in whitened coordinates: shapes (h, 7), (h, 7), (h, 7, 7). The last two are an
        eigendecomposition of their covariances, a direction a row; the means are along these directions.
    """

    mean: FloatArray
    whitening: FloatArray
    phi: float
    slow_variance: float
    rows: Mapping[str, list[int]]
    weights: FloatArray
    means: FloatArray
    variances: FloatArray
    directions: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Recollection:
    """What the next set is judged with beside the design; as it is before the first set after a baseline.

    Attributes
    ----------
    n
        Sets judged so far.
    changes
        Averages of the change from the baseline's mean, one for each of `RATES`; shape (3, 7).
    wall
        A wall was named, and the transducer was not `OK` since.
    """

    n: int = 0
    wall: bool = False
    changes: tuple[tuple[float, ...], ...] = ((0.0,) * len(COMPONENTS),) * len(RATES)


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
    """

    cause: str
    probability: float
    probabilities: Mapping[str, float]
    abrupt: float
    changes: Mapping[str, float]
    confirmed: bool


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
    variances, columns = np.linalg.eigh(np.array(in_white))
    directions = np.ascontiguousarray(columns.swapaxes(1, 2))
    means = np.array([one.mean for one in known]) @ whitening
    return CauseDesign(
        mean=mean,
        whitening=whitening,
        phi=phi,
        slow_variance=_slow_variance((complete - mean) @ whitening, phi),
        rows={cause: [k for k, one in enumerate(known) if one.cause == cause] for cause in PRIOR},
        weights=np.array([_weights(one) for one in known]),
        means=(directions @ means[:, :, None])[:, :, 0],
        variances=np.maximum(variances, 0.0),
        directions=directions,
    )


def _slow_variance(whitened: FloatArray, phi: float) -> float:
    """Variance of means of a tenth of the baseline, at least that of the baseline's own mean."""
    n = len(whitened)
    length = max(1, n // BLOCKS)
    blocks = n // length
    means = whitened[: blocks * length].reshape(blocks, length, -1).mean(axis=1)
    return max(float((means**2).mean()), (1.0 + phi) / (1.0 - phi) / n)


def recollected(before: Recollection, design: CauseDesign, logs: FloatArray) -> Recollection:
    """Take in one more complete set."""
    change = logs - design.mean
    averages = [
        rate * change + (1.0 - rate) * np.array(old) for rate, old in zip(RATES, before.changes, strict=True)
    ]
    return Recollection(
        n=before.n + 1, wall=before.wall, changes=tuple(tuple(one.tolist()) for one in averages)
    )


def verdict_of(
    memory: Recollection,
    design: CauseDesign,
    *,
    suspicious: bool = False,
    confirmation: Sequence[FloatArray] = (),
) -> CauseVerdict:
    """Say what the sets so far mean.

    Parameters
    ----------
    suspicious
        A chart of this transducer alarms, or its k of n.
    confirmation
        Logarithms of the sets struck because of the suspicion, which stand outside the averages.
    """
    probabilities, abrupt = _posterior(memory, design, confirmation)
    likeliest = max(probabilities, key=probabilities.__getitem__)
    # What grows may be a wall after all, and a step alone be gone with the next strike.
    unsure = likeliest == COUPLING and not (abrupt >= STATED and confirmation)
    # A wall does not heal: nothing but a healthy transducer takes it back.
    unsure |= memory.wall and likeliest != WALL
    if likeliest != OK and probabilities[likeliest] >= STATED and not unsure:
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
        confirmed=bool(confirmation),
    )


def remembering(memory: Recollection, verdict: CauseVerdict) -> Recollection:
    """Keep that a wall was named, until the transducer is healthy again."""
    return replace(memory, wall=verdict.cause == WALL or (memory.wall and verdict.cause != OK))


def _posterior(
    memory: Recollection, design: CauseDesign, confirmation: Sequence[FloatArray]
) -> tuple[dict[str, float], float]:
    """Probability of each cause, and of a step."""
    averages, noise = np.array(memory.changes), _noise(memory.n, design, len(confirmation))
    if confirmation:
        averages = np.vstack([averages, np.mean(confirmation, axis=0) - design.mean])
    whole = np.linalg.inv(np.linalg.cholesky(noise))
    seen = whole @ averages @ design.whitening
    course = _courses(min(max(memory.n, 1), MOST_AVERAGED))
    if confirmation:
        course = np.hstack([course, np.ones((len(course), 1))])
    course = course @ whole.T
    length = np.sqrt((course**2).sum(axis=1))
    along = (course / length[:, None]) @ seen
    # Of every hypothesis h and course s: the density along the course, over that of no change at all.
    turned = design.directions.reshape(-1, len(COMPONENTS)) @ along.T
    parts = turned.reshape(*design.means.shape, len(length)) - design.means[:, :, None] * length
    spread = 1.0 + design.variances[:, :, None] * length**2
    # One logarithm of seven factors: none comes near the 1e44 that they could all be.
    log = 0.5 * (along**2).sum(axis=1) - 0.5 * ((parts**2 / spread).sum(axis=1) + np.log(spread.prod(axis=1)))
    weights = design.weights.copy()
    if memory.n < GROWTHS[0]:
        weights[:, len(STEPS) :] = 0.0
    share = np.exp(log - log.max()) * weights
    share /= share.sum()
    of_each = share.sum(axis=1)
    by_cause = {cause: float(of_each[rows].sum()) for cause, rows in design.rows.items()}
    return by_cause, float(share[:, : len(STEPS)].sum())


def _weights(one: Hypothesis) -> FloatArray:
    """Probability beforehand with each course; half of what may be abrupt or gradual is either."""
    both = 0.5 if one.abrupt and one.gradual else 1.0
    step, growth = (both * one.weight * may for may in (one.abrupt, one.gradual))
    since = np.gradient(np.log(STEPS))
    courses = len(GROWTHS) * len(POWERS)
    return np.concatenate([step * since / since.sum(), np.full(courses, growth / courses)])


@lru_cache(maxsize=256)
def _courses(n: int) -> FloatArray:
    """Averages of a change that is 1 by now, `STEPS` first, then growths; shape (s, r).

    The averages begin with the first of n sets after the baseline.
    """
    ago = np.arange(n)
    steps = ago < STEPS[:, None]
    grown = np.maximum(1.0 - ago / np.minimum(GROWTHS, n)[:, None], 0.0)  # none began in the baseline
    course = np.vstack([steps, *(grown**power for power in POWERS)])
    return np.asarray(course @ _memories(n).T)


def _memories(n: int) -> FloatArray:
    """Weights of the last n sets in the averages, the newest first; shape (r, n)."""
    ago = np.arange(n)
    return np.array([rate * (1.0 - rate) ** ago for rate in RATES])


def _noise(n: int, design: CauseDesign, n_confirming: int) -> FloatArray:
    """Covariance of the averages of a healthy transducer, in units of a set's covariance; shape (r, r).

    The slow mean adds to all of them, a confirmation's too.
    """
    remembered = _of_averages(min(max(n, FEWEST_AVERAGED), MOST_AVERAGED), design.phi)
    noise = np.zeros((len(RATES) + bool(n_confirming),) * 2)
    noise[: len(RATES), : len(RATES)] = remembered
    if n_confirming:
        noise[-1, -1] = 1.0 / n_confirming
    return np.asarray(noise + design.slow_variance)


@lru_cache(maxsize=512)
def _of_averages(n: int, phi: float) -> FloatArray:
    """Covariance of the averages of n sets of a first-order autoregression of variance 1."""
    ago, weights = np.arange(n), _memories(n)
    return np.asarray(weights @ phi ** np.abs(ago[:, None] - ago) @ weights.T)
