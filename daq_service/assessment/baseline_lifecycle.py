"""The lifecycle of a baseline: collecting, proposed, approved, retired.

A baseline collects until its last scheduled set, then it is proposed, or approved if `baseline.approval` is
automatic. Only a person retires it; then its successor collects, from a scheduled set on. Sets are assessed
from its last set on, approved or not. Each step is an event that contains the complete row.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from daq_service.acquisition.schedule import list_due_hours
from daq_service.catalogue.rows import BaselineRow
from daq_service.settings.tree import Settings

AUTOMATIC = "automatic"
RETIRED, COLLECTING, APPROVED = "baseline_retired", "baseline_collecting", "baseline_approved"
STEPS = (RETIRED, COLLECTING, APPROVED)
"""Kinds of events that a person causes, not a set."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BaselineRange:
    """Range of sets of a position's current baseline.

    Attributes
    ----------
    number
        1 for the first baseline of a position, 2 for its successor.
    row_id
        Id of its row, the same in a rebuilt catalogue.
    """

    number: int
    first_set: int
    last_set: int
    row_id: int


def get_baseline_range(position: str, settings: Settings, present: BaselineRow | None) -> BaselineRange:
    """Return the number, row id and range of sets of a position's current baseline.

    The first baseline has the sets that the complete schedule (also after `schedule.end_h`) places up to
    `baseline.hours`; a successor has as many.

    Parameters
    ----------
    present
        The newest baseline row of the position; None: the first baseline is being recorded.

    Raises
    ------
    ValueError
        There is no such position.
    """
    # The whole schedule, not one cut by end_h: a test that is carried on later has the same baseline.
    n_sets = len(list_due_hours(settings.schedule.phases, end_h=settings.baseline.hours))
    names = list(settings.positions)
    row_id = 1 + names.index(position)
    if present is not None and present.id is not None and present.id > len(names):
        return BaselineRange(
            number=1 + (present.id - 1) // len(names),
            first_set=present.last_set_index - n_sets + 1,
            last_set=present.last_set_index,
            row_id=present.id,
        )
    return BaselineRange(number=1, first_set=0, last_set=n_sets - 1, row_id=row_id)


def build_first_baseline(position: str, settings: Settings, epoch_utc_ns: int) -> BaselineRow:
    """Return the row of a position's first baseline while it collects sets; it is not stored in this state.

    Its creation time is the epoch of the test, ns of UTC. Raise ValueError if there is no such position.
    """
    row = _build_collecting_row(
        position, settings.baseline.approval, get_baseline_range(position, settings, None)
    )
    return replace(row, created_utc_ns=epoch_utc_ns)


def format_baseline_name(position: str, number: int) -> str:
    """Return the name of a position's baseline, such as ``B-baseline-1``."""
    return f"{position}-baseline-{number}"


def renew(
    position: str,
    settings: Settings,
    present: BaselineRow | None,
    *,
    first_set: int,
    author: str,
    reason: str,
    utc_ns: int,
) -> tuple[BaselineRow, BaselineRow]:
    """Return the rows that retire the current baseline and start its successor, with as many scheduled sets.

    Parameters
    ----------
    present
        The newest baseline row of the position, also one that still collects; None: the first one collects.
    first_set
        Index of the first set that belongs to the successor.

    Returns
    -------
    tuple
        The retired row and the collecting one.

    Raises
    ------
    ValueError
        The schedule ends before the successor is complete, it would have too few sets, or the position is
        unknown.
    """
    current = get_baseline_range(position, settings, present)
    n_sets, minimum = 1 + current.last_set - current.first_set, settings.baseline.minimum_sets
    if n_sets < minimum:
        raise ValueError(
            f"baseline.hours = {settings.baseline.hours:g} gives a baseline {n_sets} sets, it needs "
            f"{minimum} (baseline.minimum_sets): begin a new test with a longer baseline"
        )
    n_remaining = max(
        0, len(list_due_hours(settings.schedule.phases, end_h=settings.schedule.end_h)) - first_set
    )
    if n_remaining < n_sets:
        raise ValueError(
            f"the plan has {n_remaining} sets left, another baseline takes {n_sets} (baseline.hours), as the "
            "first one: begin a new test, or let this one end later (schedule.end_h)"
        )
    current_row = present or _build_collecting_row(position, settings.baseline.approval, current)
    retired = replace(
        current_row, state="retired", retired_utc_ns=utc_ns, retired_by=author, retired_reason=reason
    )
    following = BaselineRange(
        number=current.number + 1,
        first_set=first_set,
        last_set=first_set + n_sets - 1,
        row_id=current.row_id + len(settings.positions),
    )
    successor = _build_collecting_row(position, settings.baseline.approval, following)
    return retired, replace(successor, created_utc_ns=utc_ns)


def approve_row(row: BaselineRow, author: str, utc_ns: int) -> BaselineRow:
    """Return a baseline's row as approved by a person at a time, ns of UTC; its state is not checked."""
    return replace(row, state="approved", approval=author, approved_utc_ns=utc_ns)


def _build_collecting_row(position: str, approval: str, sets: BaselineRange) -> BaselineRow:
    """Return the row of a baseline that collects sets: name, range of sets, approval; no statistics."""
    return BaselineRow(
        id=sets.row_id,
        name=format_baseline_name(position, sets.number),
        position=position,
        first_set_index=sets.first_set,
        last_set_index=sets.last_set,
        n_sets=0,
        feature_names=[],
        mean=[],
        covariance=[],
        limit_reason="the baseline is still being recorded",
        approval=approval,
        provenance={},
        state="collecting",
    )
