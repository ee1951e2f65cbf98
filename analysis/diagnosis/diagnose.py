"""Diagnosis of a transducer after each set, with the probability of each cause.

Averages of the logarithms of seven features, of three lengths, are remembered. A cause is a direction (or a
curve) in the features and a course in time: a wall grows, a re-seat is there from one set to the next. Each
cause is assessed by the likelihood of the three averages together, next to that of a healthy transducer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from analysis.diagnosis.hypotheses import COUPLING, OK, WALL
from analysis.diagnosis.noise import compute_noise_covariance
from analysis.diagnosis.parameters import FEWEST_GROWN, GROWTHS, POWERS, STEPS, DiagnosisParameters
from analysis.diagnosis.slopes import COMPONENTS
from analysis.diagnosis.state import MOST_AVERAGED, SETTLING, DiagnosisState, averaging_weights, restart_state
from analysis.waves.record_reduction import FloatArray

UNDETERMINED = "undetermined"
STATED = 0.9
"""Least probability of a cause that is named."""
WALL_STATED = 0.96
"""Of a wall that was not named before, since its alarm stays until the transducer is healthy: where contacts
move much, tails and re-seats that no design knows make it sure of one too often."""
WALL_LIKELY, LOST_LIKELY = 0.8, 0.4
"""A new wall change is named from the first probability on, if that of a loss of wall is at least the second.
Chosen at `plant`, on even seeds of `benchmarks/wall_diagnoses.py`."""
FEWEST_AVERAGED = 10
"""Sets: the three averages of one or two are copies of each other."""
MOST_REMEMBERED = 2000
"""Sets after which even the slowest wander has nothing in common with the baseline's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """Diagnosis of a transducer after one set.

    Attributes
    ----------
    cause
        `OK`, one of `hypotheses.CAUSES`, or `UNDETERMINED`.
    probability
        Of that cause; if it is undetermined, that of the likeliest one, `OK` included.
    probabilities
        Of `OK` and of all causes.
    abrupt
        Probability that the change came from one set to the next.
    changes
        Relative change of each component, by its name: the average of some ten sets.
    confirmed
        With a set struck outside the schedule.
    reseated, returned
        A re-seat is diagnosed that was not known before; the contact is as in the baseline again.
    """

    cause: str
    probability: float
    probabilities: Mapping[str, float]
    abrupt: float
    changes: Mapping[str, float]
    confirmed: bool
    reseated: bool
    returned: bool


def diagnose_latest_set(
    memory: DiagnosisState,
    design: DiagnosisParameters,
    *,
    suspicious: bool = False,
    lost_probability: float = 0.0,
) -> Diagnosis:
    """Diagnose the cause of a change since the baseline, after the latest set in the state.

    A cause is named from a probability of 90 %: a new wall change only at 96 % in two consecutive sets, or
    at 80 % with a ``lost_probability`` of 40 %; a re-seat only if it came in one step with a recent
    confirmation set. Otherwise the diagnosis is `UNDETERMINED`; it is `OK` if that is the likeliest and
    ``suspicious`` is False. Only `OK` replaces a named wall change; after a confirmed re-seat, `OK` is
    returned as COUPLING.

    Parameters
    ----------
    suspicious
        A chart of this transducer, or its rule of k outliers in n sets, is in alarm.
    lost_probability
        Of a loss of wall, by all sets before (`wall.thickness.WallTrack`); 0: not estimated.
    """
    moved = bool(memory.moved)
    probabilities, abrupt = _compute_posterior(memory, design, from_moved=moved)
    likeliest = max(probabilities, key=probabilities.__getitem__)
    lost = probabilities[WALL] >= WALL_LIKELY and lost_probability >= LOST_LIKELY
    sure = probabilities[likeliest] >= STATED or lost
    # What grows may be a wall after all, and a step alone be gone with the next strike.
    contact = likeliest == COUPLING and sure and abrupt >= STATED and bool(memory.confirmation)
    # A wall does not heal: nothing but a healthy transducer takes it back.
    contact &= not memory.wall
    unsure = (likeliest == COUPLING and not contact) or (memory.wall and likeliest != WALL)
    # Of many healthy sets one may look like a wall; two running, a confirmation counting, hardly ever do.
    twice = memory.likely and probabilities[WALL] >= WALL_STATED
    unsure |= likeliest == WALL and not (memory.wall or twice or lost)
    if moved and likeliest == OK:
        # As it has been since its contact moved, whatever a chart says that knows nothing of that.
        named = likeliest = COUPLING
        probabilities = probabilities | {OK: probabilities[COUPLING], COUPLING: probabilities[OK]}
    elif likeliest != OK and sure and not unsure:
        named = likeliest
    else:
        named = UNDETERMINED if suspicious or likeliest != OK else OK
    changes = memory.changes[1]
    return Diagnosis(
        cause=named,
        probability=probabilities[OK if named == OK else likeliest],
        probabilities=probabilities,
        abrupt=abrupt,
        changes={name: math.expm1(change) for name, change in zip(COMPONENTS, changes, strict=True)},
        confirmed=bool(memory.confirmation) or moved,
        reseated=contact,
        returned=moved and _is_nearer_to_baseline(memory, design),
    )


def _is_nearer_to_baseline(memory: DiagnosisState, design: DiagnosisParameters) -> bool:
    """Check whether the average of about ten sets is nearer to the baseline than to the re-seated state.

    Return False for fewer than ten sets since the re-seat.
    """
    deviation_from_baseline, moved = (
        memory.averages(from_moved=place)[1] @ design.whitening for place in (False, True)
    )
    return memory.n >= FEWEST_AVERAGED and bool(
        deviation_from_baseline @ deviation_from_baseline < moved @ moved
    )


def add_diagnosis(memory: DiagnosisState, assessment: Diagnosis) -> DiagnosisState:
    """Return the state with what a diagnosis implies for the next sets: a wall change or a re-seat.

    A new re-seat, or a contact that is as in the baseline again, restarts the averages.
    """
    if assessment.reseated:
        return restart_state(memory, memory.confirmation)
    healthy = assessment.cause in (OK, COUPLING)
    memory = replace(
        memory,
        wall=assessment.cause == WALL or (memory.wall and not healthy),
        likely=assessment.probabilities[WALL] >= WALL_STATED,
    )
    return restart_state(memory, ()) if assessment.returned else memory


def _compute_posterior(
    memory: DiagnosisState, design: DiagnosisParameters, *, from_moved: bool
) -> tuple[dict[str, float], float]:
    """Return the posterior probability of each cause, `OK` included, and that of a step instead of a growth.

    ``from_moved``: changes are from where a re-seat left the transducer, else from the baseline. With fewer
    than 32 sets since then, a gap's included, growths have probability 0.
    """
    seen, noise, course = _collect_observations(memory, design, from_moved=from_moved)
    noise_whitening = np.linalg.inv(np.linalg.cholesky(noise))
    seen, course = noise_whitening @ seen @ design.whitening, course @ noise_whitening.T
    length = np.sqrt((course**2).sum(axis=1))
    along = (course / length[:, None]) @ seen
    steps = _log_densities(design, design.abrupt, along[: len(STEPS)], length[: len(STEPS)])
    growths = _log_densities(design, slice(None), along[len(STEPS) :], length[len(STEPS) :])
    log = np.full(design.weights.shape, -np.inf)
    log[design.abrupt, : len(STEPS)], log[:, len(STEPS) :] = steps, growths
    beforehand = design.weights.copy()
    if memory.n + memory.gap < FEWEST_GROWN:
        beforehand[:, len(STEPS) :] = 0.0
    share = np.exp(log - log.max()) * beforehand
    share /= share.sum()
    of_each = share.sum(axis=1)
    by_cause = {cause: float(of_each[rows].sum()) for cause, rows in design.rows.items()}
    return by_cause, float(share[:, : len(STEPS)].sum())


def _log_densities(
    design: DiagnosisParameters,
    hypothesis_indices: NDArray[np.intp] | slice,
    along: FloatArray,
    length: FloatArray,
) -> FloatArray:
    """Return the log-likelihood ratio of each hypothesis and time course to no change, shape (h, s).

    Parameters
    ----------
    hypothesis_indices
        The h hypotheses to evaluate.
    along, length
        Whitened averages along each unit course, shape (s, 7), and the course's length, shape (s,).
    """
    # The seven directions come first: sums of seven neighbours each cost ten times as much.
    means, variances = (
        design.means[hypothesis_indices].T[:, :, None],
        design.variances[hypothesis_indices].T[:, :, None],
    )
    turned = design.directions[hypothesis_indices].transpose(2, 0, 1)
    parts = (turned.reshape(-1, turned.shape[2]) @ along.T).reshape(*turned.shape[:2], -1) - length * means
    spread = 1.0 + length**2 * variances
    explained = (parts**2 / spread).sum(axis=0) + np.log(spread.prod(axis=0))
    return np.asarray(0.5 * ((along**2).sum(axis=1) - explained))


@lru_cache(maxsize=512)
def _compute_change_courses(n: int, gap: int, gap_ago: int, confirmation_ago: int | None) -> FloatArray:
    """Return the averages that a change of final size 1 produces, for each time course; shape (s, r).

    Courses are steps, then growths; the r averages of the last ``n`` sets are those of `averaging_weights`.
    ``gap`` sets were missed ``gap_ago`` sets before the newest. A step is between two sets, however far apart
    they are; a growth continues during the gap. Cached: callers must not write to the result.
    """
    ago = np.arange(n)
    steps = ago < STEPS[:, None]
    planned_ago = ago + gap * (ago >= gap_ago)
    longest = n + gap  # none began in the baseline
    grown = np.maximum(1.0 - planned_ago / np.minimum(GROWTHS, longest)[:, None], 0.0)
    course = np.vstack([steps, *(grown**power for power in POWERS)])
    return np.asarray(course @ averaging_weights(n, confirmation_ago).T)


def _collect_observations(
    memory: DiagnosisState, design: DiagnosisParameters, *, from_moved: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Collect the stored averages, their covariance without a change, and the time courses in them.

    Variances are in units of a whitened set's. The averages at the end of the baseline come first: they show
    the slow drift at that time. After a re-seat (``from_moved``) they are left out.

    Returns
    -------
    seen, noise, course
        Shapes (r, 7), (r, r), (s, r) of r averages and s time courses.
    """
    n, confirmation_ago = (
        min(max(memory.n, 1), MOST_AVERAGED),
        memory.confirmation_ago if memory.confirmation else None,
    )
    averaged, reference = max(n, FEWEST_AVERAGED), min(n, SETTLING) if from_moved else design.n
    since = memory.n if from_moved or memory.index is None else memory.index - design.last_index
    parts = compute_noise_covariance(
        averaged, min(max(since, averaged), MOST_REMEMBERED), confirmation_ago, reference
    )
    seen, noise = memory.averages(from_moved=from_moved), np.tensordot(design.variances_in_time, parts, 1)
    course = _compute_change_courses(n, memory.gap, memory.gap_ago, confirmation_ago)
    ends = len(design.ends)
    if from_moved:
        return seen, noise[ends:, ends:], course
    return np.vstack([design.ends, seen]), noise, np.hstack([np.zeros((len(course), ends)), course])
