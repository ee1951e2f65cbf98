"""Every call that changed a file, and what a disk may show after a crash behind any of them.

`traced_files.c` writes the calls down below Python, SQLite and HDF5 alike; `Disk` takes them up one by one
and returns what each model of a crash leaves. The models (`MODELS`):

- ``kill``: everything that was written; the process died, not the machine.
- ``nothing``: of what was not synced nothing, names included.
- ``torn``: of what was not synced a prefix, of each file (within its size in whole sectors) and of the names.
- ``pages``: of what was not synced some pages of 512 or 4096 bytes, zeros between; a prefix of the names.

A name is durable once its folder was synced, nothing less. Names come and go in their order, as journaling
file systems keep it; the contents behind them do not wait for that.
"""

from __future__ import annotations

import hashlib
import os
import random
import struct
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from support import refusing_files

SOURCE = Path(__file__).with_suffix(".c")
MODELS = ("kill", "nothing", "torn", "pages")
SECTOR_BYTES = 512
PAGES_BYTES = (SECTOR_BYTES, 4096)
MARK = "k"
ONE_IN = 8
"""Of the calls after which a start finds the same: on caches, and on frames of a log without a commit."""
FRAME_HEAD_BYTES = 24
"""Of SQLite's write-ahead log; bytes 4 to 8 are 0 unless the frame commits."""
REBUILT = ("-shm",)
"""Shared memory of SQLite, which the first connection empties: mapped, no call tells what is in it."""
_HEAD = struct.Struct("<cIIq")


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """One call: ``kind`` is a letter of `traced_files.c`, or `MARK` for an acknowledgement of the program."""

    kind: str
    path: str
    number: int = 0
    content: bytes = b""


def tracing(library: Path, trace: Path, under: Path) -> dict[str, str]:
    """Return the environment of a program whose calls on files under a folder are traced."""
    return {"LD_PRELOAD": str(library), "TRACE_TO": str(trace), "TRACE_UNDER": str(under)}


def build(folder: Path) -> Path:
    """Compile the library; return its path."""
    return refusing_files.build(folder, SOURCE)


@contextmanager
def fast_folder() -> Iterator[Path]:
    """Yield a folder in memory if there is one: hundreds of states are written and synced."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as folder:
        yield Path(folder)


def mark(trace: Path, number: int) -> None:
    """Mark in the traced program that data are acknowledged from now on."""
    with trace.open("ab", buffering=0) as file:
        file.write(_HEAD.pack(MARK.encode(), 0, 0, number))


def read_trace(trace: Path, under: Path) -> list[Call]:
    """Return the calls in their order, paths relative to the folder."""
    content, calls, at = trace.read_bytes(), [], 0
    prefix = len(f"{under}/")
    while at < len(content):
        kind, path_length, content_length, number = _HEAD.unpack_from(content, at)
        at += _HEAD.size
        path = content[at : at + path_length].decode()[prefix:]
        at += path_length
        calls.append(
            Call(kind=kind.decode(), path=path, number=number, content=content[at : at + content_length])
        )
        at += content_length
        if calls[-1].kind in "rl":
            other = calls[-1].content.decode()[prefix:]
            calls[-1] = Call(kind=calls[-1].kind, path=path, content=other.encode())
    return calls


@dataclass(slots=True)
class _File:
    """Bytes of a file; ``pending`` since its last sync: (offset, bytes), or (size, None) for another size."""

    now: bytearray = field(default_factory=bytearray)
    synced: bytearray = field(default_factory=bytearray)
    pending: list[tuple[int, bytes | None]] = field(default_factory=list)

    def change(self, offset: int, content: bytes | None) -> None:
        self.pending.append((offset, content))
        _apply(self.now, offset, content)

    def sync(self) -> None:
        self.synced[:] = self.now
        self.pending.clear()

    def left(self, model: str, chance: random.Random) -> bytes:
        if model == "kill":
            return bytes(self.now)
        found = bytearray(self.synced)
        if model == "torn" and self.pending:
            whole = chance.randint(0, len(self.pending))
            for offset, content in self.pending[:whole]:
                _apply(found, offset, content)
            for offset, content in self.pending[whole : whole + 1]:
                if content is not None:
                    end = offset + chance.randrange(len(content) + 1)
                    if offset + len(content) <= len(found):  # within a file a disk writes whole sectors
                        end = max(offset, end - end % SECTOR_BYTES)
                    _apply(found, offset, content[: end - offset])
        if model == "pages" and self.pending:
            page = chance.choice(PAGES_BYTES)
            for offset, content in self.pending:
                for first, piece in [(offset, None)] if content is None else _pieces(offset, content, page):
                    if chance.random() < 0.5:
                        _apply(found, first, piece)
            if chance.random() < 0.5:  # the size is kept with the names, not with the pages
                _apply(found, len(self.now), None)
        return bytes(found)


def _apply(target: bytearray, offset: int, content: bytes | None) -> None:
    end = offset if content is None else offset + len(content)
    if len(target) < end:
        target.extend(bytes(end - len(target)))
    if content is None:
        del target[offset:]
    else:
        target[offset:end] = content


def _pieces(offset: int, content: bytes, page: int) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at < len(content):
        length = page - (offset + at) % page
        yield offset + at, content[at : at + length]
        at += length


State = Mapping[str, bytes | None]
"""Path to bytes of each file; None: a folder."""


class Disk:
    """A folder on a disk that makes durable only what is synced.

    Attributes
    ----------
    marks
        Numbers that the program has promised something of.
    """

    def __init__(self) -> None:
        self.marks: list[int] = []
        self._names: dict[str, _File | None] = {}
        self._synced: dict[str, _File | None] = {}
        self._pending: list[dict[str, tuple[_File | None] | None]] = []
        """Changes of names in their order: path to what it stands for from then on, None where it goes."""

    def take(self, call: Call) -> bool:
        """Apply a call; return whether a crash after it may leave another state."""
        path, file = call.path, self._names.get(call.path)
        match call.kind:
            case "k":
                self.marks.append(call.number)
                return False
            case "p":
                assert path.endswith(REBUILT), f"{path} is mapped: its changes are not seen"
                return False
            case "o":
                if path not in self._names:
                    self._name({path: (_File(),)})
                elif file is not None and call.number:
                    file.change(0, None)
            case "w" if file is not None:
                file.change(call.number, call.content)
            case "t" if file is not None:
                file.change(call.number, None)
            case "a" if file is not None and call.number > len(file.now):
                file.change(call.number, None)
            case "m":
                self._name({path: (None,)})
            case "r":
                self._name({path: None, call.content.decode(): (file,)})
            case "l":
                self._name({call.content.decode(): (file,)})
            case "u":
                self._name({path: None})
            case "s":
                self._sync(path, file)
        return True

    def _name(self, change: dict[str, tuple[_File | None] | None]) -> None:
        self._pending.append(change)
        _rename(self._names, change)

    def _sync(self, path: str, file: _File | None) -> None:
        if file is not None:
            file.sync()
            return
        within = [change for change in self._pending if path in map(_folder_of, change)]
        for change in within:
            _rename(self._synced, change)
        self._pending = [change for change in self._pending if change not in within]

    def left(self, model: str, chance: random.Random) -> State:
        """Return the content of the disk after a crash at this point."""
        names = dict(self._names if model == "kill" else self._synced)
        if model in ("torn", "pages"):
            for change in self._pending[: chance.randint(0, len(self._pending))]:
                _rename(names, change)
        state: dict[str, bytes | None] = {}
        for path in sorted(names):
            folder, file = _folder_of(path), names[path]
            if (not folder or folder in state) and not path.endswith(REBUILT):
                state[path] = None if file is None else file.left(model, chance)
        return state


def _rename(names: dict[str, _File | None], change: Mapping[str, tuple[_File | None] | None]) -> None:
    for path, target in change.items():
        if target is None:
            names.pop(path, None)
        else:
            names[path] = target[0]


def _folder_of(path: str) -> str:
    return "" if "/" not in path else str(PurePosixPath(path).parent)


def states(
    calls: list[Call],
    *,
    seed: int = 1,
    models: tuple[str, ...] = MODELS,
    some: int | None = None,
    caches: tuple[str, ...] | None = None,
) -> Iterator[tuple[str, State, list[int]]]:
    """Yield each crash state once: its name (boundary and model), the folder, the marks before it.

    Parameters
    ----------
    some
        So many by chance instead of all: one model each, in turn. A call that leaves nothing new hands its
        turn on to the next one.
    caches
        How paths begin that can be lost. If given, a crash comes behind one in `ONE_IN` calls on these, and
        of those that write a frame of SQLite's log without a commit: whoever opens the log forgets it.
    """
    disk, chance, seen, passed, owed = Disk(), random.Random(seed), set[bytes](), 0, 0
    forgotten = set() if caches is None else _uncommitted(calls)
    chosen = None if some is None else set(chance.sample(range(len(calls)), some))
    for number, call in enumerate(calls):
        if not disk.take(call) and chosen is None:
            continue
        if chosen is not None:
            owed += number in chosen
            if not owed:
                continue
        if number in forgotten or call.path.startswith(caches or ()):
            passed += 1
            if passed % ONE_IN:
                continue
        chosen_models = models if chosen is None else (models[len(seen) % len(models)],)
        for model in chosen_models:
            state = disk.left(model, chance)
            key = hashlib.sha1(repr(disk.marks[-1:]).encode(), usedforsecurity=False)
            for path, content in state.items():
                key.update(f"{path} {content is None} {0 if content is None else len(content)} ".encode())
                key.update(content or b"")
            if key.digest() not in seen:
                seen.add(key.digest())
                owed -= 1
                yield f"{model} after call {number} ({call.kind} {call.path})", state, list(disk.marks)


def _uncommitted(calls: list[Call]) -> set[int]:
    """Return numbers of the calls that write heads or pages of a frame that does not commit."""
    found, commits = set[int](), True
    for number, call in enumerate(calls):
        if call.kind == "w" and call.path.endswith("-wal"):
            if len(call.content) == FRAME_HEAD_BYTES:
                commits = call.content[4:8] != bytes(4)
            if not commits:
                found.add(number)
    return found


def write_state(state: State, folder: Path) -> None:
    """Write a state to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for path, content in state.items():
        if content is None:
            (folder / path).mkdir()
        else:
            (folder / path).write_bytes(content)


def state_of(folder: Path) -> State:
    """Read a folder as a state."""
    found: dict[str, bytes | None] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if not name.endswith(REBUILT):
            found[name] = None if path.is_dir() else path.read_bytes()
    return found


def set_tracing(trace: Path, under: Path) -> None:
    """Start another trace in a program that was started with the library."""
    os.environ.update(TRACE_TO=str(trace), TRACE_UNDER=str(under))
