"""Tables and quantities of faults, findings, clock steps and corruption."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

from daq_service.cli.maintenance.acceptance.evidence import Evidence
from daq_service.cli.maintenance.acceptance.quantity import Quantity, Table, make_quantity
from daq_service.cli.maintenance.acceptance.readings import NOT_KEPT, select_readings
from daq_service.recording.resumed_time import CLOCK_STEP
from hardware_drivers.nanoseconds import NS_PER_H


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """Period in which the condition of a diagnostic alarm was active; ``until_ns`` None: still active."""

    kind: str
    message: str
    since_ns: int
    until_ns: int | None = None


def list_faults(evidence: Evidence) -> list[Fault]:
    """List the periods of diagnostic alarms by start; an alarm that is active again counts as a new one."""
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


def build_fault_table(evidence: Evidence) -> Table:
    """Build the table of faults by kind: number, longest and total hours, active ones, last message.

    Active faults count until now.
    """
    kinds: defaultdict[str, list[Fault]] = defaultdict(list)
    for fault in list_faults(evidence):
        kinds[fault.kind].append(fault)
    rows = []
    for kind, faults_of_kind in sorted(kinds.items()):
        hours = [
            ((fault.until_ns or evidence.now_ns) - fault.since_ns) / NS_PER_H for fault in faults_of_kind
        ]
        standing = sum(fault.until_ns is None for fault in faults_of_kind)
        rows.append((kind, len(faults_of_kind), max(hours), sum(hours), standing, faults_of_kind[-1].message))
    return Table("faults", rows)


def build_damage_table(evidence: Evidence) -> Table:
    """Build the table of damage alarms: kind, position, priority, state, hour raised, message."""
    rows = [
        (row.kind, row.position or "", row.priority, row.state, row.raised_h, row.message)
        for row in evidence.alarms
        if row.alarm_class == "damage"
    ]
    return Table("findings", rows)


def build_clock_step_table(evidence: Evidence) -> Table:
    """Build the table of steps of the computer's UTC: hour, step and deviation after it, s."""
    rows = [
        (evidence.hour(row.utc_ns), row.payload["step_s"], row.payload["ahead_s"])
        for row in evidence.service
        if row.kind == CLOCK_STEP
    ]
    return Table("clock_steps", rows)


def compute_fault_quantities(evidence: Evidence) -> Iterator[Quantity]:
    """Yield the numbers of active faults, files found corrupt, files read again, and findings of `verify`.

    Files read again are summed over the recorder's processes. The last number does not apply if `verify` was
    not run.
    """
    yield make_quantity("faults_standing", sum(fault.until_ns is None for fault in list_faults(evidence)))
    corrupt = {row.payload["file"] for row in evidence.service if row.kind == "data_corrupt"}
    yield make_quantity("files_found_damaged", len(corrupt))
    read = [reading for reading, _ in select_readings(evidence, "files_read")]
    ends = [
        reading
        for reading, following in pairwise([*read, None])
        if reading is not None and (following is None or following.recorder != reading.recorder)
    ]
    n_read = sum(reading.payload["files_read"] for reading in ends) if read else None
    yield make_quantity("files_read_again", n_read, NOT_KEPT)
    report = evidence.verified
    if report is None:
        checked, missing = "every frame, file and row compared", "not looked at: --verify does"
        yield make_quantity("damage_found", None, missing, applies=False, checked=checked)
    else:
        checked = "; ".join(f"{number} {name}" for name, number in report.checked.items())
        yield make_quantity("damage_found", len(report.damage), checked=checked)
