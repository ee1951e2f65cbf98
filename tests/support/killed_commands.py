"""Orders of every kind that only stores, given over REST and carried out, and what a crash leaves of them.

Run as a program under `traced_files` it gives each kind to a test that is recorded. Web service and
recorder's listener are the real ones, in one process, so that a state is what a kill of both leaves.
"""

from __future__ import annotations

import os
import sys
import threading
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import orjson

from daq_service.acquisition.schedule import plan_sets
from daq_service.alarms.states import Moment
from daq_service.archive import FolderArchive
from daq_service.catalogue import RecorderCatalogue, SetCommit, open_catalogue
from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.history import HistoryFollower, read_history
from daq_service.catalogue.rows import AlarmRow, AnnotationRow, CommandRow, EventRow
from daq_service.cli.maintenance.verify import verify_folder
from daq_service.commands.audit import read_audit_log
from daq_service.commands.execution import CommandExecutor
from daq_service.commands.running_test import RunningTest
from daq_service.processes.data_folder import hold_recorder_lock
from daq_service.processes.line_file import MOST_LINES
from daq_service.recording.set_assessor import SetAssessor
from daq_service.settings.tree import Settings
from daq_service.shared_file import sync_folder
from hardware_drivers.instruments import Rig
from simulator.clock import SimulatedClock
from support.filled_folder import FilledFolder, frozen_baseline
from support.served_web import served
from support.traced_files import mark, set_tracing

WAVES_ONLY = Settings(positions={name: {"method": "solitary_wave"} for name in "BC"})
"""A probe's set would need its file."""
EVENT_OF: Mapping[str, str] = {
    "acknowledge_alarm": "alarm_acknowledged",
    "shelve_alarm": "alarm_shelved",
    "unshelve_alarm": "alarm_unshelved",
    "take_out_of_service": "alarm_out_of_service",
    "return_to_service": "alarm_in_service",
    "annotate": "annotation_added",
    "withdraw_annotation": "annotation_withdrawn",
    "pause": "pause",
    "resume": "resume",
    "disable": "alarm_raised",
    "enable": "alarm_reset",
    "strike": "confirmation_asked",
    "approve_baseline": "baseline_approved",
    "renew_baseline": "baseline_retired",
}
"""Kind of a command, and of the event with its result."""


def person(number: int) -> str:
    """Return the person who gives a command; each command has one in its event."""
    return f"person {number:06d}"


def alarm_orders(alarm_id: int) -> list[tuple[str, dict[str, Any]]]:
    """Return path and body of each alarm command, each possible after those before it."""
    return [
        (f"alarms/{alarm_id}/acknowledge", {"note": "seen"}),
        command("shelve_alarm", alarm_id=alarm_id, for_h=8.0, reason="a new coil comes"),
        command("unshelve_alarm", alarm_id=alarm_id),
        command("take_out_of_service", alarm_id=alarm_id, reason="taken apart"),
        command("return_to_service", alarm_id=alarm_id, note="put together"),
    ]


def note() -> tuple[str, dict[str, Any]]:
    """Return path and body of a note."""
    return command("annotate", from_h=1.0, to_h=2.0, text="couplant renewed")


def command(kind: str, **arguments: str | float) -> tuple[str, dict[str, Any]]:
    """Return path and body of a command without its own path."""
    return "commands", {"kind": kind, "arguments": arguments}


def recorder_on(folder: Path, catalogue: RecorderCatalogue) -> Callable[[], None]:
    """Start as a recorder that takes over a folder, without its rig.

    Each call of what is returned carries out what waits, and lets the history follow.
    """
    clock = SimulatedClock(catalogue.read_experiment().epoch_utc_ns)
    rig = cast(Rig, SimpleNamespace(dry_run=False, supply=None, climate=None))
    ledger = SetAssessor(WAVES_ONLY, FolderArchive(folder), catalogue, rig)

    def moment() -> Moment:
        return Moment(utc_ns=clock.utc_ns(), due_h=0.0, set_index=None)

    def confirmation(position: str, author: str, reason: str) -> SetCommit:
        transaction = SetCommit()
        first = plan_sets(WAVES_ONLY.schedule.phases, clock.utc_ns())[0]
        ledger.confirmations.add(reason, first, position, moment(), transaction, author)
        return transaction

    test = RunningTest(
        clock=clock,
        moment=moment,
        stop=threading.Event(),
        alarms=ledger.alarms,
        annotations=lambda: catalogue.rows(AnnotationRow),
        store=ledger.commit,
        enabled=ledger.assessors.enable,
        confirmation=confirmation,
        settings=WAVES_ONLY,
        next_set=lambda: 1,
        baseline=catalogue.baseline,
        renewed=ledger.assessors.discard_state,
        positions=tuple(WAVES_ONLY.positions),
    )
    history = HistoryFollower(folder, catalogue)
    history.begin()
    listener = CommandExecutor(catalogue, test)
    listener.close_earlier_commands()

    def look() -> None:
        listener.execute_open_commands()
        history.follow(now=True)

    return look


def give_each(folder: Path, trace: Path) -> None:
    """Give and execute a command of each kind; a mark in the trace shows that its client was answered."""
    filled = FilledFolder(folder, WAVES_ONLY)
    with (folder / FILE_NAME).open("rb+") as file:
        os.fsync(file.fileno())  # a copy, which nobody has made durable
    sync_folder(folder)
    filled.add_set(0, stored=False)  # before it there is nothing to give an order about
    proposed = frozen_baseline("B", state="proposed", approval="by_a_person", id=1)
    filled.catalogue.commit_set(SetCommit(baselines=[proposed]))
    alarm_id, annotation_id = filled.add_alarm("B", 5), filled.annotate(0.5, "to be withdrawn")
    orders = [
        *alarm_orders(alarm_id),
        note(),
        command("withdraw_annotation", annotation_id=annotation_id),
        command("pause", note="hands in the rig"),
        command("resume"),
        command("disable", position="C"),
        command("enable", position="C"),
        command("strike", position="B"),
        command("approve_baseline", position="B"),
        command("renew_baseline", position="B", note="coupled anew"),
    ]
    look = recorder_on(folder, filled.catalogue)
    with served(filled.settings, folder) as service, service.client() as api:
        for number, (path, body) in enumerate(orders):
            answer = api.post(f"/api/v1/{path}", json={**body, "author": person(number)})
            assert answer.status_code == 202, answer.text
            mark(trace, answer.json()["id"])
            look()
    filled.close()


def restart(folder: Path) -> None:
    """Do what the next recorder does before its first set."""
    with hold_recorder_lock(folder), open_catalogue(folder, writer=True) as catalogue:
        recorder_on(folder, catalogue)()


def wrong_with(folder: Path, answered: Collection[int]) -> list[str]:
    """Return every command that was neither executed once nor rejected, when no recorder runs any more.

    Parameters
    ----------
    answered
        Ids of the orders that the service has accepted; there may be others whose answer was lost.
    """
    with open_catalogue(folder) as catalogue:
        orders, events = catalogue.rows(CommandRow), catalogue.rows(EventRow)
        rows = {"alarm_id": catalogue.rows(AlarmRow), "annotation_id": catalogue.rows(AnnotationRow)}
    history = read_history(folder)
    audited = Counter(deed.command_id for _, deed in read_audit_log(folder, limit=MOST_LINES)[0])
    payloads: dict[str, list[str]] = {}
    for event in events:
        payloads.setdefault(event.kind, []).append(orjson.dumps(event.payload).decode())
    wrong = [f"order {number} is lost" for number in set(answered) - {row.id for row in orders}]
    for row in orders:
        name = f"order {row.id} ({row.kind}), {row.state}: {row.result}"
        if row.state not in ("done", "expired", "rejected") or not row.result:
            wrong.append(f"{name}: neither done nor refused")
        times = sum(row.author in payload for payload in payloads.get(EVENT_OF[row.kind], ()))
        if times != (row.state == "done"):
            wrong.append(f"{name}: done {times} times")
        if audited[row.id] > 1 or (row.id in answered and not audited[row.id]):
            wrong.append(f"{name}: {audited[row.id]} times in the audit")
    for name, found in rows.items():
        newest = {event.payload[name]: event.payload for event in events if name in event.payload}
        kind = AlarmRow if name == "alarm_id" else AnnotationRow
        from_events = [
            # An event may say more than its row: who reset an alarm.
            kind(**{key: value for key, value in {**payload, "id": number}.items() if key in kind.__slots__})
            for number, payload in newest.items()
        ]
        if sorted(from_events, key=lambda row: row.id or 0) != found:
            wrong.append(f"rows differ from what events tell, by {name}")
    if history.events != {row.id: row for row in events}:
        wrong.append("events and history differ")
    if history.commands != {row.id: row for row in orders}:
        wrong.append("orders and history differ")
    return wrong + [f"{found.file}: {found.description}" for found in verify_folder(folder).damage]


if __name__ == "__main__":
    folder, trace = Path(sys.argv[1]), Path(sys.argv[2])
    set_tracing(trace, folder)
    give_each(folder, trace)
