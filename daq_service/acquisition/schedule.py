"""Due times of the sets, computed from the phases of the configuration.

The paper: every 30 min for the first 75 h, then every hour to 350 h: 425 sets, the first one an
interval after the start.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from functools import lru_cache
from typing import Protocol

import numpy as np

from hardware_drivers.measurement import DueSet
from hardware_drivers.nanoseconds import NS_PER_H


class PhaseLike(Protocol):
    """Interface of a phase of the schedule."""

    @property
    def until_h(self) -> float:
        """Return the test hour at which the phase ends; a set due then still belongs to it."""
        ...

    @property
    def interval_h(self) -> float:
        """Return the interval in h between two sets of the phase."""
        ...


def build_unscheduled_set(number: int, after: DueSet, utc_ns: int, position: str) -> DueSet:
    """Build the ``number``-th unscheduled set of a position after a scheduled set, due at ``utc_ns``.

    ``utc_ns`` is UTC in ns. The set has the index of the scheduled one; its test hour is counted from that
    set, so that both have the same hour 0.
    """
    due_h = after.due_h + (utc_ns - after.due_utc_ns) / NS_PER_H
    epoch_ns = after.due_utc_ns - round(after.due_h * NS_PER_H)
    return DueSet(
        set_index=after.set_index,
        unscheduled_index=number,
        due_h=due_h,
        due_utc_ns=epoch_ns + round(due_h * NS_PER_H),
        position=position,
    )


def list_due_hours(phases: Sequence[PhaseLike], *, end_h: float | None = None) -> list[float]:
    """Return the test hours of all scheduled sets in ascending order; sets after ``end_h`` are left out.

    ``phases`` follow each other from hour 0. The first set of a phase is an interval after its start; hours
    are counted from there, so that rounding errors do not add up.
    """
    hours = _compute_phase_hours(tuple((phase.until_h, phase.interval_h) for phase in phases))
    return list(hours if end_h is None else hours[: bisect_right(hours, end_h)])


@lru_cache(maxsize=16)
def _compute_phase_hours(phases: tuple[tuple[float, float], ...]) -> tuple[float, ...]:
    """Compute the ascending test hours of all sets from (end, interval) in h of each phase; cached.

    The first set of a phase is an interval after its start; the last one is not after its end.
    """
    # A year has many sets, and each answer of the web service needs them.
    hours: list[float] = []
    start_h = 0.0
    for until_h, interval_h in phases:
        # Half a millionth of an interval forgives decimal fractions such as 0.1 h.
        count = int((until_h - start_h) / interval_h + 5e-7)
        hours += (start_h + np.arange(1, count + 1) * interval_h).tolist()
        start_h = until_h
    return tuple(hours)


def plan_sets(phases: Sequence[PhaseLike], epoch_utc_ns: int, *, end_h: float | None = None) -> list[DueSet]:
    """Return all scheduled sets, in order, of a test whose hour 0 is ``epoch_utc_ns`` (UTC in ns).

    Sets due after ``end_h`` (test hour) are left out.
    """
    return [
        DueSet(set_index=index, due_h=hour, due_utc_ns=epoch_utc_ns + round(hour * NS_PER_H))
        for index, hour in enumerate(list_due_hours(phases, end_h=end_h))
    ]
