"""Count sets, records and gaps of a test from the catalogue's rows and the schedule."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from daq_service.catalogue.rows import SetRow
from daq_service.cli.maintenance.acceptance.evidence import Evidence
from daq_service.cli.maintenance.acceptance.quantity import Quantity, Series, Table, make_quantity
from hardware_drivers.measurement import DueSet
from hardware_drivers.methods import PULSE_ECHO

UNTOLD = "no recorder reported it"
NO_SETS = "no set is due yet"


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """Consecutive sets without a record, and the time between the adjacent sets with one."""

    sets: Sequence[DueSet]
    reasons: Sequence[str]
    from_h: float
    until_h: float

    @property
    def hours(self) -> float:
        """Return the length of the gap in h."""
        return self.until_h - self.from_h


def group_rows_by_set(rows: Sequence[SetRow]) -> Mapping[int, list[SetRow]]:
    """Group rows by their set index; the order of rows is kept."""
    found: defaultdict[int, list[SetRow]] = defaultdict(list)
    for row in rows:
        found[row.set_index].append(row)
    return found


def list_gaps(evidence: Evidence) -> list[Gap]:
    """List the gaps among the due sets in order; a set with all transducers disabled is not a gap.

    A set without rows counts as missed with the reason `UNTOLD`.
    """
    rows, found = group_rows_by_set(evidence.sets), list[Gap]()
    missed_sets, reasons, from_h = list[DueSet](), dict[str, None](), 0.0

    def close_gap(until_h: float) -> None:
        """Store the current gap with this end hour, if it has sets, and start an empty one."""
        if missed_sets:
            found.append(Gap(sets=tuple(missed_sets), reasons=tuple(reasons), from_h=from_h, until_h=until_h))
        missed_sets.clear()
        reasons.clear()

    for due in evidence.planned[: evidence.due]:
        set_rows = rows.get(due.set_index, [])
        if any(row.n_taken for row in set_rows):
            close_gap(due.due_h)
            from_h = due.due_h
        elif not set_rows or any(row.state == "missed" for row in set_rows):
            missed_sets.append(due)
            reasons.update(
                dict.fromkeys([row.reason or "" for row in set_rows if row.state == "missed"] or [UNTOLD])
            )
    close_gap(evidence.hour(evidence.now_ns))
    return found


def count_sets_and_records(evidence: Evidence) -> list[Quantity]:
    """Compute the numbers of sets, records, strikes and gaps, fractions, and the longest gap in h.

    Sets are counted as planned, due, recorded, partial and missed, records as planned, recorded and valid,
    strikes as without a record and as repeated. Fractions have no value where the total is 0.
    """
    rows, found = group_rows_by_set(evidence.sets), list_gaps(evidence)
    taken = {index: set_rows for index, set_rows in rows.items() if any(row.n_taken for row in set_rows)}
    partial = [
        set_rows for set_rows in taken.values() if any(row.state in ("partial", "missed") for row in set_rows)
    ]
    missed = sum(len(gap.sets) for gap in found)
    untold = [due for due in evidence.planned[: evidence.due] if due.set_index not in rows]
    of_a_set = sum(
        1 if place.method == PULSE_ECHO else evidence.settings.schedule.shots_per_set
        for place in evidence.settings.positions.values()
    )
    planned = sum(row.n_planned for row in evidence.sets) + len(untold) * of_a_set
    n_taken = sum(evidence.accepted.values())

    n_valid = sum(row.n_valid for row in evidence.sets)
    numbers = {
        "sets_planned": len(evidence.planned),
        "sets_due": evidence.due,
        "sets_taken": len(taken),
        "sets_partial": len(partial),
        "sets_missed": missed,
        "sets_taken_fraction": _compute_fraction(len(taken), len(taken) + missed),
        "records_planned": planned,
        "records_taken": n_taken,
        "records_valid": n_valid,
        "strikes_without_record": sum(row.n_missed for row in evidence.sets),
        "restrikes": sum(row.n_restrikes for row in evidence.sets),
        "records_taken_fraction": _compute_fraction(n_taken, planned),
        "records_valid_fraction": _compute_fraction(n_valid, n_taken),
        "gaps": len(found),
        "longest_gap_h": max((gap.hours for gap in found), default=0.0),
    }
    return [make_quantity(name, value, NO_SETS) for name, value in numbers.items()]


def _compute_fraction(part: int, total: int) -> float | None:
    """Compute the fraction ``part / total``; None if the total is 0."""
    return part / total if total else None


def build_gap_table(evidence: Evidence) -> Table:
    """Build the table of gaps: first set, number of sets, start, end and length in h, reasons."""
    rows = [
        (gap.sets[0].set_index, len(gap.sets), gap.from_h, gap.until_h, gap.hours, "; ".join(gap.reasons))
        for gap in list_gaps(evidence)
    ]
    return Table("gaps", rows)


def build_shortfall_table(evidence: Evidence) -> Table:
    """Build the table of missing records in sets that have records, by state and reason.

    Columns: state, positions, numbers of sets and of missing records, first due hour, reason.
    """
    found: defaultdict[tuple[str, str], list[SetRow]] = defaultdict(list)
    with_records = {row.set_index for row in evidence.sets if row.n_taken}
    for row in evidence.sets:
        if row.state in ("partial", "missed") and row.set_index in with_records:
            found[row.state, row.reason or ""].append(row)
    rows = [
        (
            state,
            ", ".join(sorted({row.position for row in set_rows})),
            len({row.set_index for row in set_rows}),
            sum(row.n_planned - evidence.accepted.get((row.set_index, row.position), 0) for row in set_rows),
            set_rows[0].due_h,
            reason,
        )
        for (state, reason), set_rows in found.items()
    ]
    return Table("shortfalls", rows)


def build_record_count_series(evidence: Evidence) -> Series:
    """Build the series of planned, recorded and valid records per scheduled set, over the due hours.

    Valid records are its values, the others further lines. Sets outside the schedule are left out.
    """
    hours = {due.set_index: due.due_h for due in evidence.planned}
    lines: dict[str, Counter[int]] = {name: Counter() for name in ("planned", "taken", "valid")}
    for row in evidence.sets:
        if row.set_index in hours:
            lines["planned"][row.set_index] += row.n_planned
            lines["taken"][row.set_index] += evidence.accepted.get((row.set_index, row.position), 0)
            lines["valid"][row.set_index] += row.n_valid
    indices = sorted(lines["planned"])
    x = [hours[index] for index in indices]
    values = {name: [counter[index] for index in indices] for name, counter in lines.items()}
    others = {name: (x, values[name]) for name in ("planned", "taken")}
    return Series("records_per_set", x, values["valid"], NO_SETS, others, label="valid")
