"""Tables and quantities of faults, findings, clock steps and corruption."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

from daq_service.cli.maintenance.acceptance.evidence import Evidence
from daq_service.cli.maintenance.acceptance.quantity import Quantity, Table
from daq_service.cli.maintenance.acceptance.readings import NOT_KEPT, kept
from daq_service.recording.resumed_time import CLOCK_STEP
from hardware_drivers.nanoseconds import NS_PER_H


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """Period in which the condition of a diagnostic alarm was active; ``until_ns`` None: still active."""

    kind: str
    message: str
    since_ns: int
    until_ns: int | None = None


def faults(evidence: Evidence) -> list[Fault]:
    """List the faults in order; an alarm that is active again is a new fault."""
    faults_by_alarm: dict[int, list[Fault]] = {}
    for event in evidence.alarm_events:
        if event.payload["alarm_class"] != "diagnostic":
            continue
        alarm_faults = faults_by_alarm.setdefault(event.payload["alarm_id"], [])
        if event.kind in ("alarm_raised", "alarm_reactivated"):
            alarm = event.payload["kind"], event.payload["message"]
            alarm_faults.append(Fault(kind=alarm[0], message=alarm[1], since_ns=event.utc_ns))
        elif (
            event.kind in ("alarm_cleared", "alarm_reset")
            and alarm_faults
            and alarm_faults[-1].until_ns is None
        ):
            alarm_faults[-1] = replace(alarm_faults[-1], until_ns=event.utc_ns)
    return sorted(
        (fault for alarm_faults in faults_by_alarm.values() for fault in alarm_faults),
        key=lambda fault: fault.since_ns,
    )


def fault_table(evidence: Evidence) -> Table:
    """Return the table of faults by kind."""
    kinds: defaultdict[str, list[Fault]] = defaultdict(list)
    for fault in faults(evidence):
        kinds[fault.kind].append(fault)
    rows = []
    for kind, faults_of_kind in sorted(kinds.items()):
        hours = [
            ((fault.until_ns or evidence.now_ns) - fault.since_ns) / NS_PER_H for fault in faults_of_kind
        ]
        standing = sum(fault.until_ns is None for fault in faults_of_kind)
        rows.append((kind, len(faults_of_kind), max(hours), sum(hours), standing, faults_of_kind[-1].message))
    return Table(
        name="faults",
        title="Faults: alarms of instruments, disk, data and clock",
        columns=("kind", "times", "longest (h)", "together (h)", "stand now", "the last one's words"),
        rows=rows,
    )


def damage_table(evidence: Evidence) -> Table:
    """Return the table of the specimen's alarms: findings, not faults."""
    return Table(
        name="findings",
        title="Alarms of the specimen: what the test found, no fault of it",
        columns=("kind", "position", "priority", "state", "raised (h)", "words"),
        rows=[
            (row.kind, row.position or "", row.priority, row.state, row.raised_h, row.message)
            for row in evidence.alarms
            if row.alarm_class == "damage"
        ],
    )


def step_table(evidence: Evidence) -> Table:
    """Return the table of steps of the computer's UTC."""
    return Table(
        name="clock_steps",
        title="Steps of the computer's UTC",
        columns=("at (h)", "step (s)", "ahead from then on (s)"),
        rows=[
            (evidence.hour(row.utc_ns), row.payload["step_s"], row.payload["ahead_s"])
            for row in evidence.service
            if row.kind == CLOCK_STEP
        ],
    )


def fault_quantities(evidence: Evidence) -> Iterator[Quantity]:
    """Yield active faults and detected corruption."""
    quantity, service = partial(Quantity, "Faults and data"), evidence.service
    standing = sum(fault.until_ns is None for fault in faults(evidence))
    how = "device alarms whose condition holds"
    yield quantity("faults_standing", "faults that stand now", "1", how, standing)
    yield quantity(
        "files_found_damaged",
        "files that the recorder found damaged or gone",
        "1",
        "events data_corrupt, each file once",
        len({row.payload["file"] for row in service if row.kind == "data_corrupt"}),
    )
    read = [reading for reading, _ in kept(evidence, "files_read")]
    ends = [
        reading
        for reading, following in pairwise([*read, None])
        if reading is not None and (following is None or following.recorder != reading.recorder)
    ]
    yield quantity(
        "files_read_again",
        "files that recorders read again in their idle time",
        "1",
        "sum of the last files_read of each recorder, a file at every round",
        sum(reading.payload["files_read"] for reading in ends) if read else None,
        NOT_KEPT,
    )
    report = evidence.verified
    yield quantity(
        "damage_found",
        "damages that solimon verify found now",
        "1",
        "every frame, file and row compared"
        if report is None
        else "; ".join(f"{number} {name}" for name, number in report.checked.items()),
        None if report is None else len(report.damage),
        "not looked at: --verify does",
        applies=report is not None,
    )
