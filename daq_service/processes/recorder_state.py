"""How the recorder is: one answer for the command line, whoever gives an order, and the web."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from daq_service.clock import boot_name
from daq_service.processes.data_folder import LOCK_FILE, is_owned, lock_text
from daq_service.processes.heartbeat import Beat, age_s, read_heartbeat

Word = Literal["running", "finished", "stopped", "silent", "absent"]

FAREWELLS: dict[str, tuple[Word, str]] = {
    "schedule_done": ("finished", "finished: every planned set has its row"),
    "recorder_stopped": ("stopped", "stopped by its operator; start it again to go on"),
    "recorder_left_alone": ("stopped", "stopped because its supervisor was gone; start it again to go on"),
}
PROCESS_EVENTS = ("recorder_started", *FAREWELLS)
"""Events of the service that tell how a recorder is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderState:
    """How the recorder is at a moment.

    Attributes
    ----------
    word
        "running", also where it waits for its rig; "finished" or "stopped" where that was its last word;
        else "silent" (past its deadline, or gone without a word) or "absent" (never ran).
    description
        The same for a person, with what it is doing.
    listens
        It is alive and takes orders: also after its last set, while it lingers; not before its rig is open.
    beat
        Its last sign of life; None where there is none.
    beat_age_s
        Age of that; None without one, or where it is of an earlier boot.
    """

    word: Word
    description: str
    listens: bool
    beat: Beat | None
    beat_age_s: float | None


def recorder_state(
    beat: Beat | None, kinds: Sequence[str], *, owned: bool | None, boot: str | None, mono_ns: int
) -> RecorderState:
    """Judge by what the recorder told last, by the folder's lock, and by its heartbeat.

    The lock alone says whether one runs; the heartbeat, a hint, what it is doing and whether it moves. A
    farewell is the last word of the recorder that said it: one that runs and has not said so is another.

    Parameters
    ----------
    kinds
        Kinds of the newest events, oldest first; those that are not `PROCESS_EVENTS` say nothing.
    owned
        Somebody holds the folder's lock; None where nobody can tell: then the heartbeat decides.
    boot, mono_ns
        This boot and its monotonic time.
    """
    told = next((kind for kind in reversed(kinds) if kind in PROCESS_EVENTS), "")
    age = None if beat is None else age_s(beat, boot=boot, mono_ns=mono_ns)
    late = beat is not None and age is not None and age > beat.deadline_s
    runs = owned if owned is not None else beat is not None and age is not None and not late
    in_time = runs and not late
    ended = beat is not None and age is not None and beat.stage == "ended"
    word: Word = "running" if in_time else "absent" if beat is None and not (runs or told) else "silent"
    description = _description(beat, age, runs=runs, late=late, began=bool(told))
    if told in FAREWELLS and (ended or not in_time):
        word, description = FAREWELLS[told]
    return RecorderState(
        word=word,
        description=description,
        listens=in_time and word != "stopped" and (age is None or beat is None or beat.stage != "opening"),
        beat=beat,
        beat_age_s=age,
    )


def _description(beat: Beat | None, age: float | None, *, runs: bool, late: bool, began: bool) -> str:
    if beat is None and runs:
        return "running; no heartbeat of it can be read yet"
    if beat is None:
        gone = "not running: it left without a word, and its heartbeat cannot be read"
        return gone if began else "never started here"
    if runs and not late:
        return "running, starting" if age is None else f"running, {beat.doing}"
    if age is None:
        return f"not running: this computer was started again since it was last seen {beat.doing}"
    return f"not {'answering' if runs else 'running'}: last sign of life {age:.0f} s ago while {beat.doing}"


def look_at_recorder(folder: Path, kinds: Sequence[str]) -> RecorderState:
    """State at this moment on this machine; ``kinds`` as in `recorder_state`."""
    if kinds and not folder.is_dir():
        gone = (
            f"nobody can tell: {folder} is gone; a recorder that runs keeps what it takes in memory and "
            "stores it when the folder is back: bring it back"
        )
        return RecorderState(word="silent", description=gone, listens=False, beat=None, beat_age_s=None)
    beat, owned = read_heartbeat(folder), is_owned(folder)
    if owned and beat is not None:
        owner = lock_text(folder, LOCK_FILE).removeprefix("process ")
        if owner.isdigit() and int(owner) != beat.process:
            beat = None  # the last one of an earlier recorder: the one that runs has just begun
    return recorder_state(
        beat,
        kinds,
        owned=owned,
        boot=boot_name(),
        mono_ns=time.monotonic_ns(),
    )
