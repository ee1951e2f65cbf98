"""A recorder on a simulated clock, under a disk that refuses single calls; each case in a fork.

Run as a program under `refusing_files`: ``FOLDER`` holds a started test; cases come as JSON lines on
standard input, and what became of each goes to standard output. The real line runs, with catalogue, journal,
finalizing of files and log; rig and features are in memory, and a sleep of anybody's only moves the clock on.
"""

from __future__ import annotations

import ctypes
import json
import logging
import os
import shutil
import sqlite3
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

from daq_service import shared_file
from daq_service.archive.records import build_reference
from daq_service.background.finalize_sets import SetFinalizer
from daq_service.background.live_figure import LiveFigure
from daq_service.catalogue import errors, open_catalogue
from daq_service.catalogue.rows import AlarmRow
from daq_service.clock import MachineClock, WallClock, parse_utc
from daq_service.errors import StorageError
from daq_service.processes.child import log_to_file
from daq_service.processes.data_folder import hold_recorder_lock, prepare_data_folder, remove_temporary_files
from daq_service.processes.heartbeat import Heartbeat
from daq_service.recording import session
from daq_service.recording.resources import Host, SessionOptions
from daq_service.recording.session import RigOpener
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import SetKey
from hardware_drivers.nanoseconds import NS_PER_S
from support.crashed_recorders import LongerRecords, in_memory, outcome
from support.memory_line import healthy, memory_settings
from support.small_experiment import AtOnce

SETS_BEFORE, SETS = 2, 6
INTERVAL_S, FREED_AFTER_S, FREED_BEFORE_THE_START_S = 18.0, 25.0, 4.0
"""A disk that is freed only by a person takes nothing for longer than a set; one that keeps a recorder from
starting only as long as no set is due."""
TROUBLE_AFTER_S = 28.0
DAMAGED = build_reference(SetKey(SETS - 1), parse_utc("2026-01-01T00:00:00Z"))
"""A set's file without rows, as a disk may leave one; a start sets it aside."""
CALLS = "open,write,fsync,rename,unlink,truncate,allocate,mkdir"


def refusal_settings() -> Settings:
    """Return settings of six sets of ten records, a set every 18 s."""
    interval_h = INTERVAL_S / 3600.0
    return memory_settings(
        schedule={
            "phases": [{"until_h": SETS * interval_h, "interval_h": interval_h}],
            "shots_per_set": 3,
            "shot_interval_s": 1.0,
        },
        clock={"kind": "wall"},
    )


class Time:
    """Clocks of the machine, advanced by each sleep; ``look`` is called at each step."""

    def __init__(self) -> None:
        self.now_ns = parse_utc("2026-01-01T00:00:00Z")
        self.look: Callable[[], None] = lambda: None
        self.machine = MachineClock(mono_ns=self.ns, elapsed_ns=self.ns, utc_ns=self.ns, sleep=self.sleep)

    def ns(self) -> int:
        return self.now_ns

    def s(self) -> float:
        return self.now_ns / NS_PER_S

    def sleep(self, seconds: float) -> None:
        self.now_ns += max(round(seconds * NS_PER_S), 1)
        self.look()


class Stop(threading.Event):
    """Event that is never set; waiting for it advances the clock."""

    def __init__(self, clock: Time) -> None:
        super().__init__()
        self._clock = clock

    def wait(self, timeout: float | None = None) -> bool:
        self._clock.sleep(timeout or 0.0)
        return self.is_set()


@contextmanager
def injected(clock: Time) -> Iterator[None]:
    """Let everything in this process use a simulated clock."""
    named: dict[Callable[..., Any], dict[str, Any]] = {
        SetFinalizer.__init__: {"machine": clock.machine},
        Heartbeat.__init__: {"machine": clock.machine},
        LiveFigure.__init__: {"machine": clock.machine},
        shared_file.retry: {"pause": clock.sleep},
    }
    with ExitStack() as stack:
        for function, values in named.items():
            stack.enter_context(patch.dict(function.__kwdefaults__, values))  # type: ignore[attr-defined]
        stack.enter_context(patch.object(time, "monotonic", clock.s))
        stack.enter_context(patch.object(time, "monotonic_ns", clock.ns))
        stack.enter_context(patch.object(session, "elapsed_ns", clock.ns))
        stack.enter_context(patch.object(errors, "BUSY_TIMEOUT_S", 0.01))
        yield


def record(
    folder: Path,
    clock: Time,
    instruments: LongerRecords,
    acknowledged_ids: list[int],
    stop: Stop,
    opened_by: Callable[[RigOpener], RigOpener] = lambda opener: opener,
) -> bool:
    """Record once, to the end or until ``stop``."""
    with in_memory(instruments) as opener, injected(clock):
        wall_clock = partial(WallClock, machine=clock.machine)
        prepare_data_folder(folder)
        with hold_recorder_lock(folder):
            remove_temporary_files(folder)
            return session.record_test(
                refusal_settings(),
                folder,
                opened_by(opener),
                stop=stop,
                report=lambda event, **values: None,
                options=SessionOptions(acknowledged=acknowledged_ids.append),
                host=Host(machine=clock.machine, worker=AtOnce, wall_clock=wall_clock, listen_every_s=1.0),
            )


def begin(folder: Path) -> None:
    """Create a started test: stopped after its second set."""
    clock, acknowledged_ids = Time(), list[int]()
    stop = Stop(clock)
    clock.look = lambda: (
        stop.set() if clock.now_ns > first_ns + (SETS_BEFORE + 0.7) * INTERVAL_S * 1e9 else None
    )
    first_ns = clock.now_ns
    record(folder, clock, LongerRecords(healthy), acknowledged_ids, stop)
    (folder.parent / "begun.json").write_text(json.dumps({"now_ns": clock.now_ns, "told": acknowledged_ids}))


class FirstReport(logging.Handler):
    """Log handler that keeps the time of the first message after the first refusal."""

    def __init__(self, clock: Time, refusals: Callable[[], int]) -> None:
        super().__init__(logging.WARNING)
        self._clock, self._refusals = clock, refusals
        self.first_s: float | None = None
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if self._refusals():
            self.first_s = self._clock.s() if self.first_s is None else self.first_s
            self.messages.append(record.getMessage())


def follow(case: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Continue the test under one refusal; return the outcome."""
    start = json.loads((folder.parent / "begun.json").read_text())
    clock = Time()
    clock.now_ns = start["now_ns"]
    acknowledged_ids: list[int] = start["told"]
    refusals: Callable[[], int] = ctypes.CDLL(os.environ["LD_PRELOAD"]).refusals
    trouble = trouble_of(case, folder, clock)
    if trouble is not None:
        refusals = lambda: int(trouble.since_s > 0.0)  # noqa: E731
    instruments = LongerRecords(healthy)
    seen_s: list[tuple[int, float]] = []

    def look() -> None:
        assert clock.s() < start["now_ns"] / NS_PER_S + 600.0, f"it waits for ever: {reports.messages[-3:]}"
        if trouble is not None:
            trouble.look()
        if refusals() > (seen_s[-1][0] if seen_s else 0):
            seen_s.append((refusals(), clock.s()))
        patience_s = FREED_AFTER_S if instruments.calls else FREED_BEFORE_THE_START_S
        if seen_s and clock.s() > seen_s[0][1] + patience_s:
            os.environ.pop("REFUSE_CALLS", None)

    clock.look = look
    reports = FirstReport(clock, refusals)
    logging.getLogger().addHandler(reports)
    log_to_file(folder / "logs" / "recorder.log")
    if case.get("damaged"):
        (folder / DAMAGED).write_bytes(b"torn")
    refuse(case, folder)
    ends: list[str] = []
    finished = False
    while not finished and len(ends) < 50:
        try:
            finished = record(folder, clock, instruments, acknowledged_ids, Stop(clock))
        except StorageError as error:
            logging.getLogger(__name__).warning("%s", error)
            ends.append(f"{'in' if instruments.calls else 'before'} the test: {error}")
            clock.sleep(1.0)  # as the supervisor, who starts it again
    os.environ.pop("REFUSE_CALLS", None)
    if left(folder):  # what could not be removed at the end is left to the next start
        record(folder, clock, instruments, acknowledged_ids, Stop(clock))
    found = outcome(folder, "wall")
    with open_catalogue(folder) as catalogue:
        alarms = [(row.kind, row.state) for row in catalogue.rows(AlarmRow)]
    first_s, last_s = (seen_s[0][1], seen_s[-1][1]) if seen_s else (0.0, 0.0)
    return {
        "finished": finished,
        "ends": ends,
        "refusals": refusals(),
        "lasted_s": last_s - first_s,
        "told_after_s": None if reports.first_s is None else max(reports.first_s - first_s, 0.0),
        "said": reports.messages,
        "alarms": alarms,
        "lost": sorted(set(acknowledged_ids) - found.counts.keys()),
        "sets": sorted({(row.set_index, row.state, row.reason) for row in found.rows["sets"]}),
        "shots": len(found.counts),
        "keys": len(set(found.keys.values())),
        "acknowledged": len(set(acknowledged_ids)),
        "left": left(folder),
        "set_aside": sorted(path.name for path in folder.glob("quarantine/*")),
    }


def refuse(case: dict[str, Any], folder: Path) -> None:
    """Configure the library; without a call it refuses nothing, without a count it only logs."""
    os.environ.update(
        REFUSE_UNDER=str(folder),
        REFUSE_FILES=case.get("files", "*"),
        REFUSE_ERRNO=str(case.get("errno", 0)),
        REFUSE_WHEN=f"from {case.get('first', 0)} {case.get('count', 0)}",
        REFUSE_LOG=str(folder.parent / "refused.log"),
    )
    if case.get("call"):
        os.environ["REFUSE_CALLS"] = case["call"]


def left(folder: Path) -> list[str]:
    """Return files that a finished test must not leave."""
    return sorted(path.name for path in (*folder.glob("journal/*"), *folder.glob("**/*.tmp")))


class Trouble:
    """Disturbance of the folder that is undone after a while."""

    def __init__(self, clock: Time, for_s: float, do: Callable[[], Callable[[], Any]]) -> None:
        self._clock, self._for_s, self._do = clock, for_s, do
        self._at_s = clock.s() + TROUBLE_AFTER_S
        self._undo: Callable[[], Any] | None = None
        self.since_s = 0.0

    def look(self) -> None:
        now_s = self._clock.s()
        if not self.since_s and now_s >= self._at_s:
            self._undo, self.since_s = self._do(), now_s
        if self._undo is not None and now_s > self.since_s + self._for_s:
            self._undo()
            self._undo = None


def trouble_of(case: dict[str, Any], folder: Path, clock: Time) -> Trouble | None:
    """Return an exclusive transaction on the catalogue, or a move of the folder."""

    def lock() -> Callable[[], Any]:
        held = sqlite3.connect(folder / "catalogue.sqlite", isolation_level=None)
        held.execute("BEGIN EXCLUSIVE")
        return held.close

    def move() -> Callable[[], Any]:
        elsewhere = folder.rename(folder.with_name("elsewhere"))
        return lambda: elsewhere.rename(folder)

    doings = {"locked_s": lock, "moved_s": move}
    return next((Trouble(clock, case[name], do) for name, do in doings.items() if name in case), None)


def in_a_fork(case: dict[str, Any], started_folder: Path) -> dict[str, Any]:
    """Run one case in a child of this process."""
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        try:
            folder = started_folder.parent / f"case {os.getpid()}" / "data"
            folder.parent.mkdir()
            shutil.copytree(started_folder, folder)
            shutil.copy(started_folder.parent / "begun.json", folder.parent)
            result = follow(case, folder)
            noted = folder.parent / "refused.log"
            only_noted = not case.get("count") and noted.exists()
            result["noted"] = noted.read_text().splitlines() if only_noted else []
            result["folder"] = str(folder)
            shutil.rmtree(folder.parent)
        except BaseException:  # noqa: BLE001 - whatever ends a recorder is the answer
            result = {"fault": traceback.format_exc()}
        with os.fdopen(writing, "w") as answer:
            json.dump(result, answer)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as answer:
        content = answer.read()
    _, status = os.waitpid(child, 0)
    return json.loads(content) if content else {"fault": f"the process ended with status {status}"}


def main() -> None:
    """Create a started test, then follow each case."""
    started_folder = Path(sys.argv[1]) / "begun" / "data"
    started_folder.parent.mkdir(parents=True)
    begin(started_folder)
    logging.getLogger().addHandler(logging.NullHandler())  # no log on standard error
    for line in sys.stdin:
        case = json.loads(line)
        print(json.dumps({**case, **in_a_fork(case, started_folder)}), flush=True)


if __name__ == "__main__":
    main()
