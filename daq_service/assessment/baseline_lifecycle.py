"""The life of a baseline: collecting, proposed, approved, retired.

A baseline is collecting until its last planned set, then proposed, or approved where `baseline.approval`
is automatic. Only a person retires it; then its successor collects, from a planned set on. It judges from
its last set on, signed or not. Nothing learns by itself. Each step is an event that tells the whole row.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from daq_service.acquisition.schedule import due_hours
from daq_service.catalogue.rows import BaselineRow
from daq_service.settings.tree import Settings

AUTOMATIC = "automatic"
RETIRED, COLLECTING, APPROVED = "baseline_retired", "baseline_collecting", "baseline_approved"
STEPS = (RETIRED, COLLECTING, APPROVED)
"""Kinds of events that no set tells: a person's steps."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Planned:
    """Which sets a position's present baseline is made of.

    Attributes
    ----------
    number
        1 for the first baseline of a position, 2 for its successor.
    row_id
        Id of its row, the same in a catalogue that is made again.
    """

    number: int
    first_set: int
    last_set: int
    row_id: int


def planned(position: str, settings: Settings, present: BaselineRow | None) -> Planned:
    """Tell the sets of the present baseline.

    Parameters
    ----------
    present
        The newest row of the position; None: the first baseline is being recorded.
    """
    # The whole schedule, not one cut by end_h: a test that is carried on later has the same baseline.
    n_sets = len(due_hours(settings.schedule.phases, end_h=settings.baseline.hours))
    names = list(settings.positions)
    row_id = 1 + names.index(position)
    if present is not None and present.id is not None and present.id > len(names):
        return Planned(
            number=1 + (present.id - 1) // len(names),
            first_set=present.last_set_index - n_sets + 1,
            last_set=present.last_set_index,
            row_id=present.id,
        )
    return Planned(number=1, first_set=0, last_set=n_sets - 1, row_id=row_id)


def first_one(position: str, settings: Settings, epoch_utc_ns: int) -> BaselineRow:
    """Tell the first baseline of a position while it collects: it has no row until it is frozen."""
    row = _collecting(position, settings, planned(position, settings, None))
    return replace(row, created_utc_ns=epoch_utc_ns)


def name_of(position: str, number: int) -> str:
    """Name of a position's baseline by its number."""
    return f"{position}-baseline-{number}"


def renewed(
    position: str,
    settings: Settings,
    present: BaselineRow | None,
    *,
    first_set: int,
    author: str,
    because: str,
    utc_ns: int,
) -> tuple[BaselineRow, BaselineRow]:
    """Retire the present baseline and begin its successor, of as many planned sets.

    Parameters
    ----------
    present
        As of `planned`; one that was still collecting is retired all the same: its history has no gap.
    first_set
        Index of the first set that belongs to the successor.

    Returns
    -------
    tuple
        The retired row and the collecting one.

    Raises
    ------
    ValueError
        The plan ends before the successor is complete, or no successor would have `baseline.minimum_sets`.
    """
    now = planned(position, settings, present)
    n_sets, least = 1 + now.last_set - now.first_set, settings.baseline.minimum_sets
    if n_sets < least:
        raise ValueError(
            f"baseline.hours = {settings.baseline.hours:g} gives a baseline {n_sets} sets, it needs {least} "
            "(baseline.minimum_sets): begin a new test with a longer baseline"
        )
    n_left = max(0, len(due_hours(settings.schedule.phases, end_h=settings.schedule.end_h)) - first_set)
    if n_left < n_sets:
        raise ValueError(
            f"the plan has {n_left} sets left, another baseline takes {n_sets} (baseline.hours), as the "
            "first one: begin a new test, or let this one end later (schedule.end_h)"
        )
    before = present or _collecting(position, settings, now)
    retired = replace(
        before, state="retired", retired_utc_ns=utc_ns, retired_by=author, retired_because=because
    )
    following = Planned(
        number=now.number + 1,
        first_set=first_set,
        last_set=first_set + n_sets - 1,
        row_id=now.row_id + len(settings.positions),
    )
    return retired, replace(_collecting(position, settings, following), created_utc_ns=utc_ns)


def signed(row: BaselineRow, author: str, utc_ns: int) -> BaselineRow:
    """Approve a proposed baseline in a person's name."""
    return replace(row, state="approved", approval=author, approved_utc_ns=utc_ns)


def _collecting(position: str, settings: Settings, its: Planned) -> BaselineRow:
    return BaselineRow(
        id=its.row_id,
        name=name_of(position, its.number),
        position=position,
        first_set_index=its.first_set,
        last_set_index=its.last_set,
        n_sets=0,
        feature_names=[],
        mean=[],
        covariance=[],
        limit_reason="the baseline is still being recorded",
        approval=settings.baseline.approval,
        provenance={},
        state="collecting",
    )
