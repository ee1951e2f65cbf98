"""A recorder whose every call to the disk is written down, and one started on what a crash would leave.

The recording line is the real one, with catalogue, journal and files; only rig and features are in memory.
Run as a program under `traced_files` it records tests, and two designs that are known to lose shots.
"""

from __future__ import annotations

import hashlib
import math
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import h5py
import numpy as np

from daq_service.archive import FolderSetReader, SetReference
from daq_service.archive.journal.writer import Journal
from daq_service.catalogue import open_catalogue
from daq_service.catalogue.experiment_file import HISTORY_FILE
from daq_service.catalogue.reader import Filters
from daq_service.catalogue.rows import (
    AssessmentRow,
    EventRow,
    FeatureRow,
    Row,
    SetRow,
    ShotRow,
    ThicknessRow,
    as_dict,
)
from daq_service.clock import Before, parse_utc
from daq_service.processes.data_folder import hold_recorder_lock, prepare_data_folder, remove_temporary_files
from daq_service.processes.worker import start_one_worker
from daq_service.recording import session
from daq_service.recording.recorder import Recorder
from daq_service.recording.resources import Host, SessionOptions
from daq_service.settings.tree import Settings
from hardware_drivers.instruments import Clock, Rig
from hardware_drivers.measurement import SetKey, Shot, ShotKey, Waveform
from simulator.clock import SimulatedClock
from support.memory_line import TABLES, ScriptedInstruments, healthy, memory_settings
from support.small_experiment import AtOnce
from support.traced_files import State, mark, set_tracing, state_of, write_state

SEGMENT_BYTES = 96 * 1024
"""Some sets in each segment, so that segments begin and go while a test runs."""
SAMPLES = 1000
SETS, SHOTS_PER_SET = 16, 3
"""With three transducers 144 shots, and 16 pulse-echo records; then 3 shots of a confirmation set."""


def crash_settings(kind: str, **tables: Any) -> Settings:
    """Settings of a test of 144 shots, the last set assessed by the ones before; suspicion asks for 3 more.

    Shots are acknowledged a set at a time where ``kind`` is ``simulated``, and one by one on ``wall``.
    """
    return memory_settings(
        schedule={
            "phases": [{"until_h": SETS * 0.5, "interval_h": 0.5}],
            "shots_per_set": SHOTS_PER_SET,
        },
        baseline={"hours": (SETS - 1) * 0.5, "minimum_sets": SETS - 1},
        clock={"kind": kind},
        **tables,
    )


class LongerRecords(ScriptedInstruments):
    """Scripted instruments whose shots take some pages on the disk; each has its own counts."""

    def _record(self, key: ShotKey) -> Waveform:
        short = super()._record(key)
        seed = [ord(key.position[0]), key.set_key.number, key.shot_index, key.attempt]
        counts = np.random.default_rng(seed).integers(-999, 999, SAMPLES, dtype=np.int16)
        return replace(short, counts=counts, pretrigger_samples=1)


def features_by_key(shot: Shot) -> Any:
    """Return features of a healthy wall, changed at B in the last set and its confirmations."""
    planned = shot.key.set_index
    return healthy(shot.key, 1.0 if (shot.key.position, planned) == ("B", SETS - 1) else 0.0)


def _clock_after(before: Before) -> Clock:
    return SimulatedClock(before.last_utc_ns)


@contextmanager
def in_memory(instruments: ScriptedInstruments) -> Iterator[session.RigOpener]:
    """Let `session.record_test` run on scripted instruments, with features by key and short segments."""

    @contextmanager
    def opener(settings: Settings, clock: Clock, epoch_utc_ns: int) -> Iterator[Rig]:
        yield Rig(
            kind="simulated", clock=clock, striker=instruments, digitizer=instruments, pulse_echo=instruments
        )

    with ExitStack() as stack:
        stack.enter_context(patch.object(session, "Recorder", partial(Recorder, features_of=features_by_key)))
        stack.enter_context(patch.dict(Journal.__init__.__kwdefaults__, segment_bytes=SEGMENT_BYTES))
        hour_0_ns = parse_utc("2026-01-01T00:00:00Z")
        stack.enter_context(patch.object(session, "compute_hour_0_ns", lambda system_ns: hour_0_ns))
        yield opener


def record(
    settings: Settings,
    folder: Path,
    *,
    acknowledged: Callable[[int], None] = lambda shot_id: None,
    worker: Callable[[], Executor] = AtOnce,
    instruments: ScriptedInstruments | None = None,
    **options: Any,
) -> list[ShotKey]:
    """Record to the end, as ``solimon record`` does; return what was struck."""
    instruments = instruments or LongerRecords(healthy)
    with in_memory(instruments) as opener:
        prepare_data_folder(folder)
        with hold_recorder_lock(folder):
            remove_temporary_files(folder)
            finished = session.record_test(
                settings,
                folder,
                opener,
                stop=threading.Event(),
                report=lambda event, **values: None,
                options=SessionOptions(acknowledged=acknowledged, **options),
                host=Host(worker=worker, wall_clock=_clock_after, listen_every_s=1e6),
            )
    assert finished, "the schedule was not ended"
    return [key for call, key in instruments.calls if call in ("strike", "acquire") and key is not None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Result of a finished test.

    Attributes
    ----------
    rows
        Of each table those that a repeated test must repeat; times of a test in real time left out.
    counts
        Bytes of every record by its shot id.
    keys
        Shot id to position, set, shot and attempt.
    """

    rows: dict[str, list[Any]]
    counts: dict[int, bytes]
    keys: dict[int, tuple[str, SetKey, int, int]]


def rows_of(folder: Path, kind: str) -> dict[str, list[Any]]:
    """Return the rows of each table that a repeated test must repeat; in real time without their times."""
    rows: dict[str, list[Any]] = {}
    with open_catalogue(folder) as catalogue:
        for name, table in TABLES.items():
            columns = [item.name for item in fields(table)]
            times = {column for column in columns if column.endswith("_ns") and column != "due_utc_ns"}
            masked = times if kind == "wall" else times & {"created_utc_ns", "wall_utc_ns"}
            # A file holds the test's UUID and times; `outcome` compares the digest with the file.
            masked |= {"file_sha256"} & set(columns)
            if table is EventRow:
                masked.add("id")  # they are numbered among those of the service and its machine, which differ
            rows[name] = [
                replace(row, **dict.fromkeys(masked, 0))
                for row in catalogue.rows(table, **purpose_of_all(table))
                if not (isinstance(row, EventRow) and row.topic in ("service", "machine"))
            ]
    return rows


def outcome(folder: Path, kind: str) -> Outcome:
    """Read the result from catalogue and files."""
    rows = rows_of(folder, kind)
    with open_catalogue(folder) as catalogue:
        for row in catalogue.rows(SetRow, **purpose_of_all(SetRow)):
            content = (folder / row.file).read_bytes() if row.file else None
            assert row.file_sha256 == (content and hashlib.sha256(content).hexdigest()), row
    counts = {
        sequence: content
        for file in FolderSetReader(folder).sets().values()
        for sequence, content in _counts(folder / file, (folder / file).read_bytes()).items()
    }
    keys = {row.sequence: (row.position, row.set_key, row.shot_index, row.attempt) for row in rows["shots"]}
    return Outcome(rows=rows, counts=counts, keys=keys)


def purpose_of_all(table: type[Row]) -> Filters:
    """Select scheduled and unscheduled sets, where the table has sets."""
    return {"purpose": "any"} if table in (SetRow, ShotRow, FeatureRow, ThicknessRow, AssessmentRow) else {}


_READ: dict[bytes, dict[int, bytes]] = {}


def _counts(path: Path, content: bytes) -> dict[int, bytes]:
    """Return checked counts of each shot of a file; the same bytes are read once."""
    if content not in _READ:
        reader, reference = FolderSetReader(path.parent), SetReference(path.name)
        assert (damages := reader.verify_set(reference)) == [], "; ".join(map(str, damages))
        records = reader.read_set(reference).records
        _READ[content] = {item.sequence: item.waveform.counts.tobytes() for item in records}
    return _READ[content]


def faults_after_crash(
    state: State,
    acknowledged: Sequence[int],
    folder: Path,
    whole: Outcome,
    settings: Settings,
    *,
    with_holes: bool = False,
    lost_pages: bool = False,
) -> list[str]:
    """Start a recorder twice on what a crash left; return every fault found.

    Parameters
    ----------
    whole
        Outcome of the test that nothing disturbed.
    with_holes
        The disk may have kept the end of a set and lost one of its shots: it is struck again after that end.
    lost_pages
        Pages are missing in the midst of what was not synced: that cannot be distinguished from damage, and
        is reported as such.
    """
    kind = settings.clock.kind
    write_state(state, folder)
    wrong = [f"{name} is published and {fault}" for name, fault in _unreadable(folder)]
    struck = record(settings, folder)
    again = {_of(key) for key in struck} & {whole.keys[number] for number in acknowledged}
    wrong += [f"{len(again)} acknowledged shots are struck again, {min(again)}"] if again else []
    first = outcome(folder, kind)
    wrong += [
        f"acknowledged shot {n} is {first.keys.get(n)}"
        for n in acknowledged
        if first.keys.get(n) != whole.keys[n]
    ]
    expected, found = ({one.keys[n]: counts for n, counts in one.counts.items()} for one in (whole, first))
    wrong += [f"{len(lost)} shots are gone"] if (lost := expected.keys() - found.keys()) else []
    wrong += [f"shot {key} has other counts" for key, counts in found.items() if counts != expected.get(key)]
    wrong += _not_behind({_of(key) for key in struck}, first)
    rows = whole.rows, first.rows
    if first.keys != whole.keys or (with_holes and any(_differing(*rows))):
        # Of a group that nobody had been promised the disk kept later shots and lost earlier ones: these
        # are struck again, behind the others and under numbers of their own.
        rows = _without_numbers(whole.rows), _without_numbers(first.rows)
    aside = sorted(path.name for path in folder.glob("quarantine/*"))
    if aside and lost_pages:  # with an alarm, whose id shifts those of others
        rows = _without_alarms(rows[0]), _without_alarms(rows[1])
    else:
        wrong += [f"{name} is set aside" for name in aside]
    wrong += _differing(*rows)
    files = _lasting(folder)
    if record(settings, folder):
        wrong.append("a second start strikes again")
    if aside:  # it reports what is in the quarantine in other words
        return wrong
    wrong += [f"second start: {fault}" for fault in _differing(first.rows, rows_of(folder, kind))]
    wrong += [f"second start: {name} changed" for name in _changed(files, _lasting(folder))]
    return wrong


def _without_alarms(rows: dict[str, list[Any]]) -> dict[str, list[Any]]:
    return {name: found for name, found in rows.items() if name not in ("alarms", "events")}


def _of(key: ShotKey) -> tuple[str, SetKey, int, int]:
    return key.position, key.set_key, key.shot_index, key.attempt


def _unreadable(folder: Path) -> Iterator[tuple[str, str]]:
    for path in sorted(folder.glob("sets/set_*.h5")):
        try:
            _counts(path, path.read_bytes())
        except Exception as error:  # noqa: BLE001 - whatever a reader meets is what is wrong
            yield path.name, f"cannot be read: {error}"


def _not_behind(struck: set[tuple[str, SetKey, int, int]], found: Outcome) -> list[str]:
    """Numbers follow the order in which shots are taken: those of a start lie behind all others."""
    kept = max((number for number, key in found.keys.items() if key not in struck), default=0)
    return [
        f"shot {number} is new and not behind {kept}"
        for number, key in found.keys.items()
        if key in struck and number < kept
    ]


def _without_numbers(rows: dict[str, list[Any]]) -> dict[str, list[Any]]:
    """Rows without numbers and times of shots and what depends on them, in an order that does not, either.

    An unscheduled set is due once the scheduled one that requests it has its last shot.
    """

    def bare(content: Any) -> Any:
        if not isinstance(content, dict):
            return content
        depends = ("sequence", "file_sha256", "id")
        if content.get("unscheduled_index"):
            depends += ("due_h", "file")
        return {
            name: bare(value)
            for name, value in content.items()
            if name not in depends and not name.endswith("_ns")
        }

    return {table: sorted((bare(as_dict(row)) for row in its), key=repr) for table, its in rows.items()}


def _differing(whole: dict[str, list[Any]], found: dict[str, list[Any]]) -> Iterator[str]:
    for table, rows in whole.items():
        if not alike(rows, found[table]):
            pair = next(
                (pair for pair in zip(rows, found[table], strict=False) if not alike(*pair)),
                "one is longer",
            )
            yield f"{table}: {len(rows)} rows, now {len(found[table])}: {pair}"


def alike(one: Any, other: Any) -> bool:
    """Compare rows exactly, and floats without numbers to nine digits, or places where small.

    A mean depends on the order of what it is of by its last digits, and so does all that follows from it.
    """
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(alike(value, other[name]) for name, value in one.items())
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(alike, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return one == other or math.isclose(one, other, rel_tol=1e-9, abs_tol=1e-9)
    return bool(one == other)


HINTS = ("catalogue.sqlite", "heartbeat.json", "recorder.lock", "live", "logs")
"""Not compared byte by byte: hints, and the catalogue, whose rows are."""


def _lasting(folder: Path) -> State:
    return {name: content for name, content in state_of(folder).items() if not name.startswith(HINTS)}


def _changed(before: State, after: State) -> list[str]:
    changed = {name for name in before.keys() | after.keys() if before.get(name) != after.get(name)}
    if after.get(HISTORY_FILE, b"").startswith(before.get(HISTORY_FILE, b"")):
        changed.discard(HISTORY_FILE)  # a start is logged there, after the earlier lines
    return sorted(changed)


# Designs that are known to lose shots ---------------------------------------------------------------


def kept_open(folder: Path, acknowledge: Callable[[int], None]) -> None:
    """HDF5 kept open: a group a shot, flushed and synced before it is acknowledged."""
    with h5py.File(folder / "open.h5", "w") as file:
        _sync(folder)
        for number in range(1, 21):
            file.create_dataset(f"shot_{number}/counts", data=np.full(SAMPLES, number, np.int16))
            file.flush()
            _sync(folder / "open.h5")
            acknowledge(number)


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    os.fsync(descriptor)
    os.close(descriptor)


def lost_of_kept_open(folder: Path, acknowledged: Sequence[int]) -> list[int]:
    """Return acknowledged shots that a reader of the file does not find."""
    try:
        with h5py.File(folder / "open.h5", "r") as file:
            return [
                number
                for number in acknowledged
                if not np.array_equal(file[f"shot_{number}/counts"][()], np.full(SAMPLES, number, np.int16))
            ]
    except (OSError, KeyError, RuntimeError):
        return list(acknowledged)


def replaced(folder: Path, acknowledge: Callable[[int], None], *, synced: bool = False) -> None:
    """All shots in a file that is replaced by rename: durable only with both syncs."""
    for number in range(1, 21):
        partial_file = folder / "shots.tmp"
        partial_file.write_bytes(np.arange(1, number + 1, dtype="<i8").tobytes())
        if synced:
            _sync(partial_file)
        partial_file.replace(folder / "shots")
        if synced:
            _sync(folder)
        acknowledge(number)


def lost_of_replaced(folder: Path, acknowledged: Sequence[int]) -> list[int]:
    """Return acknowledged numbers that are not in the file."""
    path = folder / "shots"
    content = path.read_bytes() if path.exists() else b""
    found = np.frombuffer(content[: len(content) // 8 * 8], dtype="<i8").tolist()
    return [number for number in acknowledged if number not in found]


DESIGNS: dict[str, Callable[[Path, Callable[[int], None]], object]] = {
    "simulated": lambda folder, acknowledge: record(
        crash_settings("simulated"), folder, acknowledged=acknowledge
    ),
    "wall": lambda folder, acknowledge: record(crash_settings("wall"), folder, acknowledged=acknowledge),
    "worker": lambda folder, acknowledge: record(
        crash_settings("wall"), folder, acknowledged=acknowledge, worker=start_one_worker
    ),
    "kept open": kept_open,
    "replaced": replaced,
    "replaced and synced": partial(replaced, synced=True),
}


def main() -> None:
    """Run designs under the library: ``DESIGN...``, each in a folder of its own with its trace."""
    out = Path(sys.argv[1])
    for design in sys.argv[2:]:
        folder, trace = out / design, out / f"{design}.trace"
        folder.mkdir()
        set_tracing(trace, folder)
        DESIGNS[design](folder, partial(mark, trace))


if __name__ == "__main__":
    main()
