"""Count sets, records and gaps of a test from the catalogue's rows and the schedule."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from daq_service.acquisition.schedule import DueSet
from daq_service.catalogue.rows import SetRow
from daq_service.cli.maintenance.acceptance.evidence import Evidence
from daq_service.cli.maintenance.acceptance.quantity import Quantity, Series, Table
from hardware_drivers.methods import PULSE_ECHO

SECTION = "Sets and records"
UNTOLD = "no recorder told of it"
NO_SETS = "no set is due yet"


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """Consecutive sets without a record, and the time between the adjacent sets with one."""

    sets: Sequence[DueSet]
    causes: Sequence[str]
    from_h: float
    until_h: float

    @property
    def hours(self) -> float:
        """Length in h."""
        return self.until_h - self.from_h


def by_set(rows: Sequence[SetRow]) -> Mapping[int, list[SetRow]]:
    """Group rows by set."""
    found: defaultdict[int, list[SetRow]] = defaultdict(list)
    for row in rows:
        found[row.set_index].append(row)
    return found


def gaps(evidence: Evidence) -> list[Gap]:
    """List the gaps in order; a set with all transducers disabled is not a gap."""
    rows, found = by_set(evidence.sets), list[Gap]()
    missed_sets, causes, from_h = list[DueSet](), dict[str, None](), 0.0

    def close(until_h: float) -> None:
        if missed_sets:
            found.append(Gap(sets=tuple(missed_sets), causes=tuple(causes), from_h=from_h, until_h=until_h))
        missed_sets.clear()
        causes.clear()

    for due in evidence.planned[: evidence.due]:
        set_rows = rows.get(due.set_index, [])
        if any(row.n_taken for row in set_rows):
            close(due.due_h)
            from_h = due.due_h
        elif not set_rows or any(row.state == "missed" for row in set_rows):
            missed_sets.append(due)
            causes.update(
                dict.fromkeys([row.cause or "" for row in set_rows if row.state == "missed"] or [UNTOLD])
            )
    close(evidence.hour(evidence.now_ns))
    return found


def set_quantities(evidence: Evidence) -> list[Quantity]:
    """Return the numbers of sets and records: planned, taken, valid, missed; gaps."""
    rows, found = by_set(evidence.sets), gaps(evidence)
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
    n_taken, n_valid = sum(evidence.accepted.values()), sum(row.n_valid for row in evidence.sets)
    longest = max(found, key=lambda gap: gap.hours, default=None)

    def number(name: str, text: str, value: int, how: str) -> Quantity:
        return Quantity(SECTION, name, text, "1", how, value)

    def fraction(name: str, text: str, part: int, whole: int, how: str) -> Quantity:
        return Quantity(SECTION, name, text, "1", how, part / whole if whole else None, NO_SETS)

    return [
        number("sets_planned", "sets of the whole schedule", len(evidence.planned), "phases of the schedule"),
        number("sets_due", "sets due so far", evidence.due, "due times until now, or the end of the test"),
        number("sets_taken", "sets with a record", len(taken), "sets with n_taken above 0 at a position"),
        number("sets_partial", "of these, lacking something", len(partial), "a position partial or missed"),
        number("sets_missed", "sets without a record", missed, "due, and every row missed or none there"),
        fraction(
            "sets_taken_fraction",
            "part of the due sets that was taken",
            len(taken),
            len(taken) + missed,
            "sets_taken / (sets_taken + sets_missed)",
        ),
        number(
            "records_planned", "records planned of these sets", planned, "sum of n_planned, retired are 0"
        ),
        number("records_taken", "records taken", n_taken, "shots and echoes with an accepted record"),
        number("records_valid", "records valid", n_valid, "sum of n_valid: the quality gate found them good"),
        number(
            "strikes_without_record",
            "strikes and echoes that left no record",
            sum(row.n_missed for row in evidence.sets),
            "sum of n_missed",
        ),
        number(
            "restrikes",
            "strikes repeated by the quality gate",
            sum(row.n_restrikes for row in evidence.sets),
            "sum of n_restrikes",
        ),
        fraction(
            "records_taken_fraction",
            "part of the planned records that was taken",
            n_taken,
            planned,
            "records_taken / records_planned",
        ),
        fraction(
            "records_valid_fraction",
            "part of the taken records that is valid",
            n_valid,
            n_taken,
            "records_valid / records_taken",
        ),
        number("gaps", "gaps", len(found), "runs of sets without a record"),
        Quantity(
            SECTION,
            "longest_gap_h",
            "longest gap",
            "h",
            "from the set with a record before it to the next one; at an end, to hour 0 or now",
            0.0 if longest is None else longest.hours,
        ),
    ]


def gap_table(evidence: Evidence) -> Table:
    """Return the table of gaps with their causes."""
    rows = [
        (gap.sets[0].set_index, len(gap.sets), gap.from_h, gap.until_h, gap.hours, "; ".join(gap.causes))
        for gap in gaps(evidence)
    ]
    return Table(
        name="gaps",
        title="Gaps: time between sets with a record, around those without",
        columns=("first set", "sets", "from (h)", "until (h)", "length (h)", "cause"),
        rows=rows,
        empty="none: every due set has a record",
    )


def shortfall_table(evidence: Evidence) -> Table:
    """Return the table of missing records in sets with records, by cause."""
    found: defaultdict[tuple[str, str], list[SetRow]] = defaultdict(list)
    with_records = {row.set_index for row in evidence.sets if row.n_taken}
    for row in evidence.sets:
        if row.state in ("partial", "missed") and row.set_index in with_records:
            found[row.state, row.cause or ""].append(row)
    rows = [
        (
            state,
            ", ".join(sorted({row.position for row in set_rows})),
            len({row.set_index for row in set_rows}),
            sum(row.n_planned - evidence.accepted.get((row.set_index, row.position), 0) for row in set_rows),
            set_rows[0].due_h,
            cause,
        )
        for (state, cause), set_rows in found.items()
    ]
    return Table(
        name="shortfalls",
        title="Records lacking in sets that were taken",
        columns=("state", "positions", "sets", "records lacking", "first (h)", "cause"),
        rows=rows,
        empty="none: each of these sets is whole",
    )


def flag_table(evidence: Evidence) -> Table:
    """Return the table of shots by flag."""
    return Table(
        name="flags",
        title="Records by what the analysis flagged them with",
        columns=("flag", "records"),
        rows=sorted(evidence.flags.items(), key=lambda item: -item[1]),
    )


def record_series(evidence: Evidence) -> Series:
    """Return the records of each set, taken and valid."""
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
    return Series(
        "records_per_set",
        "Valid records of each set",
        "1",
        "sums over the positions of n_valid; planned and taken beside",
        x,
        values["valid"],
        NO_SETS,
        {name: (x, values[name]) for name in ("planned", "taken")},
        label="valid",
    )
