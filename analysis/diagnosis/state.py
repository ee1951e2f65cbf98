"""Diagnosis state of a transducer: averages over its sets, a confirmation set, a re-seat, a gap.

A confirmed re-seat shifts the transducer for good. Where it sits since then is learnt from the next sets, and
later changes are measured from there, so that a wall that thins behind it is still named.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.diagnosis.slopes import COMPONENTS
from analysis.waves.record_reduction import FloatArray

RATES = (0.5, 0.1, 0.02)
"""Weights of the averages: the last sets, those of half a day, those of two days at one an hour."""
MOST_AVERAGED = 250
"""Sets: further ones change nothing."""
CONFIRMATION_SETS = 24
"""Sets for which a confirmation set is looked at: then the averages tell more of what lasts."""
SETTLING = 24
"""Sets from which the place after a re-seat is learnt."""
NOTHING = ((0.0,) * len(COMPONENTS),) * len(RATES)


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnosisState:
    """State with which the next set is diagnosed; the defaults hold before the first set after a baseline.

    Attributes
    ----------
    n
        Sets assessed so far, or since a re-seat was named.
    wall
        A wall was named, and the transducer was not healthy since.
    likely
        The last set, or its confirmation, gave a wall at least 96 %: the next one that does confirms it.
    changes
        Averages of the change from the baseline's mean, one for each of `RATES`; shape (3, 7).
    index
        Of the last set; None before the first.
    gap, gap_ago
        Sets missed in the widest gap of the plan, and sets since then; 0: there is none among the last.
    confirmation, confirmation_ago
        Change in the last confirmation set, and planned sets since; empty: there is none among the last.
    moved
        Where a confirmed re-seat left the transducer: mean change of the sets since, `SETTLING` at most;
        empty: it is as in its baseline.
    """

    n: int = 0
    wall: bool = False
    likely: bool = False
    changes: tuple[tuple[float, ...], ...] = NOTHING
    index: int | None = None
    gap: int = 0
    gap_ago: int = 0
    confirmation: tuple[float, ...] = ()
    confirmation_ago: int = 0
    moved: tuple[float, ...] = ()

    def averages(self, *, from_moved: bool) -> FloatArray:
        """Return the exponential averages of the change, shape (3, 7); a confirmation set adds a fourth row.

        Parameters
        ----------
        from_moved
            Changes from where a re-seat left the transducer; else from the baseline.
        """
        rows = [*self.changes, self.confirmation] if self.confirmation else self.changes
        if not from_moved:
            return np.array(rows)
        # The averages began with 0 at the re-seat, and have not forgotten that yet.
        since = [1.0 - (1.0 - rate) ** self.n for rate in RATES] + [1.0] * bool(self.confirmation)
        return np.asarray(np.array(rows) - np.outer(since, self.moved))


def add_set(before: DiagnosisState, mean: FloatArray, logs: FloatArray, index: int) -> DiagnosisState:
    """Return the diagnosis state after one more complete scheduled set.

    A confirmation set is dropped 24 sets later; the position after a re-seat is the mean of the first 24
    sets.

    Parameters
    ----------
    mean, logs
        Of the baseline's logarithms, and those of the set's features; shape (7,).
    index
        Of the set: those of the plan that are missing between it and the last one are a gap.
    """
    change, n = logs - mean, before.n + 1
    averages = [
        rate * change + (1.0 - rate) * np.array(old) for rate, old in zip(RATES, before.changes, strict=True)
    ]
    moved = np.array(before.moved)
    if before.moved and n <= SETTLING:
        moved = moved + (change - moved) / n
    known = bool(before.confirmation) and before.confirmation_ago + 1 < CONFIRMATION_SETS
    gap, gap_ago = _find_widest_gap(before, index)
    return DiagnosisState(
        n=n,
        wall=before.wall,
        likely=before.likely,
        changes=tuple(tuple(one.tolist()) for one in averages),
        index=index,
        gap=gap,
        gap_ago=gap_ago,
        confirmation=before.confirmation if known else (),
        confirmation_ago=before.confirmation_ago + 1 if known else 0,
        moved=tuple(moved.tolist()),
    )


def _find_widest_gap(before: DiagnosisState, index: int) -> tuple[int, int]:
    """Return length of the widest gap in the last 250 sets, and sets since then; (0, 0) without one.

    ``index`` is that of the newest set in the schedule.
    """
    missed = 0 if before.index is None else index - before.index - 1
    old = before.gap if before.gap_ago < MOST_AVERAGED else 0
    if missed > 0 and missed >= old:
        return missed, 1
    return old, before.gap_ago + 1 if old else 0


def add_confirmation_set(memory: DiagnosisState, mean: FloatArray, logs: FloatArray) -> DiagnosisState:
    """Return the state with a confirmation set, which replaces an earlier one; the averages ignore it.

    ``logs`` are its log features, ``mean`` those of the baseline, shape (7,).
    """
    return replace(memory, confirmation=tuple((logs - mean).tolist()), confirmation_ago=0)


def restart_state(memory: DiagnosisState, moved: tuple[float, ...]) -> DiagnosisState:
    """Restart the averages after a re-seat; later changes are measured from the position ``moved``.

    ``moved`` is the mean change of the log features, length 7; empty: as in the baseline. Only a named wall
    change and the index of the last set are kept.
    """
    return DiagnosisState(wall=memory.wall, index=memory.index, moved=moved)


def averaging_weights(n: int, confirmation_ago: int | None = None) -> FloatArray:
    """Return the weights of the last n sets in the averages, the newest first; shape (3 or 4, n).

    Parameters
    ----------
    confirmation_ago
        Adds a row for a confirmation set: it saw what the planned set so many sets ago did.
    """
    ago = np.arange(n)
    rows = [rate * (1.0 - rate) ** ago for rate in RATES]
    if confirmation_ago is not None:
        rows.append(np.equal(ago, min(confirmation_ago, n - 1)).astype(np.float64))
    return np.array(rows)


def covariance_of_averages(n: int, phi: float, confirmation_ago: int | None) -> FloatArray:
    """Return the covariance of averages over n sets of a unit-variance AR(1) process, (3, 3) or (4, 4).

    ``phi`` is its lag-1 autocorrelation; ``confirmation_ago`` (planned sets since a confirmation set, None
    without one) adds the fourth row.
    """
    # Of two averages: of sets k ago with themselves, and with the m-th before, in either order.
    ago, rates = np.arange(n), np.array(RATES)
    decay = (1.0 - rates)[:, None]
    with_older = (1.0 - (phi * decay) ** (n - ago)) / (1.0 - phi * decay)
    pairs = (decay * decay.T)[:, :, None] ** ago * (with_older[:, None] + with_older - 1.0)
    covariance = np.outer(rates, rates) * pairs.sum(axis=2)
    if confirmation_ago is None:
        return np.asarray(covariance)
    # Struck right after its planned set, it is no copy of it: it has an innovation of its own.
    shared = averaging_weights(n) @ phi ** np.maximum(np.abs(np.arange(n) - confirmation_ago), 1)
    return np.block([[covariance, shared[:, None]], [shared[None], np.ones((1, 1))]])
