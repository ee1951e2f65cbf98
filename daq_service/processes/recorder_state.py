"""Status of the recorder, the same for command line, commands and web."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from daq_service.clock import boot_name
from daq_service.processes.data_folder import LOCK_FILE, is_held, read_lock_owner
from daq_service.processes.heartbeat import Beat, compute_beat_age_s, read_heartbeat

RecorderStatus = Literal["running", "finished", "stopped", "not_responding", "not_started"]

FAREWELLS: dict[str, tuple[RecorderStatus, str]] = {
    "schedule_done": ("finished", "finished: every scheduled set has its row"),
    "recorder_stopped": ("stopped", "stopped by its operator; start it again to continue"),
    "recorder_left_alone": ("stopped", "stopped because its supervisor was gone; start it again to continue"),
}
PROCESS_EVENTS = ("recorder_started", *FAREWELLS)
"""Events of the service that show the status of a recorder."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderState:
    """State of the recorder at a moment.

    Attributes
    ----------
    status
        "running", also where it waits for its rig; "finished" or "stopped" where its last event shows that;
        else "not_responding" (past its deadline, or ended without an event) or "not_started" (never ran).
    description
        The status for a person, with the present activity.
    listens
        The recorder accepts commands: also after its last set, while it lingers; not before its rig is open.
    beat
        Newest heartbeat; None where there is none.
    beat_age_s
        Age of the heartbeat; None without one, or where it is of an earlier boot.
    """

    status: RecorderStatus
    description: str
    listens: bool
    beat: Beat | None
    beat_age_s: float | None


def determine_recorder_state(
    beat: Beat | None, kinds: Sequence[str], *, owned: bool | None, boot: str | None, mono_ns: int
) -> RecorderState:
    """Determine the state of a recorder from its newest event, the folder's lock and the heartbeat.

    The lock shows whether a recorder runs, the heartbeat its activity and whether it hangs. The end events
    `FAREWELLS` count only if the heartbeat has the stage ``ended`` or no recorder runs: else a later recorder
    runs.

    Parameters
    ----------
    beat
        Newest heartbeat; None if there is none.
    kinds
        Kinds of the newest events, oldest first; those not in `PROCESS_EVENTS` are ignored.
    owned
        Whether a process holds the folder's lock; None if unknown: then a heartbeat in time shows it.
    boot, mono_ns
        This boot and its monotonic time, ns.
    """
    last_kind = next((kind for kind in reversed(kinds) if kind in PROCESS_EVENTS), "")
    age = None if beat is None else compute_beat_age_s(beat, boot=boot, mono_ns=mono_ns)
    is_late = beat is not None and age is not None and age > beat.deadline_s
    is_running = owned if owned is not None else beat is not None and age is not None and not is_late
    in_time = is_running and not is_late
    ended = beat is not None and age is not None and beat.stage == "ended"
    status: RecorderStatus = (
        "running"
        if in_time
        else "not_started"
        if beat is None and not (is_running or last_kind)
        else "not_responding"
    )
    description = _describe_state(
        beat, age, is_running=is_running, is_late=is_late, has_started=bool(last_kind)
    )
    if last_kind in FAREWELLS and (ended or not in_time):
        status, description = FAREWELLS[last_kind]
    return RecorderState(
        status=status,
        description=description,
        listens=in_time and status != "stopped" and (age is None or beat is None or beat.stage != "opening"),
        beat=beat,
        beat_age_s=age,
    )


def _describe_state(
    beat: Beat | None, age: float | None, *, is_running: bool, is_late: bool, has_started: bool
) -> str:
    """Describe for a person a recorder that logged no end; ``age`` is that of the beat in s, or None.

    None: the beat is of an earlier boot.
    """
    if beat is None and is_running:
        return "running; no heartbeat of it can be read yet"
    if beat is None:
        description = "not running: it left without a word, and its heartbeat cannot be read"
        return description if has_started else "never started here"
    if is_running and not is_late:
        return "running, starting" if age is None else f"running, {beat.doing}"
    if age is None:
        return f"not running: this computer was started again since it was last seen {beat.doing}"
    activity = "answering" if is_running else "running"
    return f"not {activity}: last sign of life {age:.0f} s ago while {beat.doing}"


def read_recorder_state(folder: Path, kinds: Sequence[str]) -> RecorderState:
    """Read the present state of the recorder of a folder; ``kinds`` as in `determine_recorder_state`.

    ``not_responding`` if the folder of a started test (one with events) is gone. A heartbeat of another
    process than the lock's owner is ignored.
    """
    if kinds and not folder.is_dir():
        description = (
            f"unknown, {folder} is missing; a recorder that runs keeps what it takes in memory and "
            "stores it when the folder is back: bring it back"
        )
        return RecorderState(
            status="not_responding", description=description, listens=False, beat=None, beat_age_s=None
        )
    beat, owned = read_heartbeat(folder), is_held(folder)
    if owned and beat is not None:
        owner = read_lock_owner(folder, LOCK_FILE).removeprefix("process ")
        if owner.isdigit() and int(owner) != beat.process:
            beat = None  # of an earlier recorder: the running one has just started
    boot, mono_ns = boot_name(), time.monotonic_ns()
    return determine_recorder_state(beat, kinds, owned=owned, boot=boot, mono_ns=mono_ns)
