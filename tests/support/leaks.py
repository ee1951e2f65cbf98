"""A test that leaves a thread, a process or an open file behind fails, by name.

What a fixture of a module or of the session holds at the end of its setup belongs to that fixture; while one
lives that holds something, its threads, processes and files may become more, and when the last one has
ended, nothing may be left. `conftest.py` takes the hooks over.
"""

from __future__ import annotations

import gc
import importlib.util
import multiprocessing
import os
import re
import sys
import threading
import time
from collections.abc import Iterator
from multiprocessing import forkserver, resource_tracker
from pathlib import Path

import pytest

GRACE_S = 10.0
"""A process asked to end takes a moment, on a loaded machine a long one; only a leak waits it out."""

LONG_LIVED_FILES = {
    r"anon_inode:.*": "the pollers of gRPC's core, one for the life of a process",
    r".*\.ttf": "matplotlib keeps the fonts that it has drawn with",
}
LASTING = re.compile("|".join(LONG_LIVED_FILES))
PROC = Path("/proc")
MARK = "STARTED_BY_TESTS_OF"
"""Environment variable that every descendant inherits, also one whose parent was killed."""


def mark_descendants() -> None:
    """Let every process that this one starts carry its id."""
    os.environ[MARK] = str(os.getpid())


def open_what_lasts() -> None:
    """Open in advance what a process opens once: the pipe of libuv for signals."""
    if importlib.util.find_spec("uvloop") is not None:
        import uvloop

        uvloop.new_event_loop().close()


def _servants() -> set[str]:
    """Return the processes of the two multiprocessing servers, which live as long as the interpreter."""
    return {str(resource_tracker._resource_tracker._pid), str(forkserver._forkserver._forkserver_pid)}


def _lines_to_servants() -> set[str]:
    """Return descriptors that keep these servers alive."""
    return {str(resource_tracker._resource_tracker._fd), str(forkserver._forkserver._forkserver_alive_fd)}


class _Looker:
    """Scanner of the resources of this process; known processes are only checked for life."""

    def __init__(self) -> None:
        self._strangers: set[str] = set()
        self._ours: set[str] = set()

    def things(self) -> set[str]:
        """Return a name for each thread, descendant and open file."""
        threads = {f"thread {thread.name!r} ({id(thread):#x})" for thread in threading.enumerate()}
        children = {f"process {child.pid}" for child in multiprocessing.active_children()}
        if sys.platform != "linux":
            return threads | children  # neither descendants nor open files can be listed without a library
        return threads | children | self._processes() | _open_files()

    def _processes(self) -> set[str]:
        now = {name for name in os.listdir("/proc") if name.isdigit()}  # noqa: PTH208 - twice as fast
        self._strangers &= now
        self._ours &= now
        for name in now - self._strangers - self._ours:
            wanted = f"{MARK}={os.getpid()}".encode()
            try:
                environment = (PROC / name / "environ").read_bytes()
            except ProcessLookupError:
                environment = (
                    b"\0"  # it has no memory: a thread of the kernel, asked once, or one that has ended
                )
            except OSError:
                continue  # ended meanwhile, or another user's
            if not environment:
                continue  # in the midst of its start
            ours = wanted in environment.split(b"\0")
            (self._ours if ours else self._strangers).add(name)
        others = self._ours - _servants() - {str(os.getpid())}
        return {f"process {name}" for name in others if _runs(name)}


def _runs(name: str) -> bool:
    try:
        return (PROC / name / "stat").read_text(encoding="ascii").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def _open_files() -> set[str]:
    found, lasting, folder = set(), _lines_to_servants(), "/proc/self/fd"
    # Asked twice a test: without pathlib half as long.
    for name in os.listdir(folder):  # noqa: PTH208
        try:
            target = os.readlink(f"{folder}/{name}")  # noqa: PTH115
        except OSError:
            continue  # the listing's own
        if name not in lasting and not LASTING.fullmatch(target):
            found.add(f"file {name} ({target})")
    return found


def _is_deserted(thing: str) -> bool:
    """Return whether this is a connection whose other end is closed.

    The double of NI's library keeps its connection, as NI's driver does, until it is called again; one that
    Python forgets to close warns, and the warning fails its test.
    """
    inode = thing.rpartition("(socket:[")[2].removesuffix("])")
    return inode.isdigit() and inode not in _connected()


def _connected() -> set[str]:
    """Return inodes of this machine's sockets except those that wait to be closed."""
    close_wait, found = "08", set()
    for table, inode in (("tcp", 9), ("tcp6", 9), ("udp", 9), ("udp6", 9), ("unix", 6)):
        lines = (PROC / "self" / "net" / table).read_text(encoding="ascii", errors="replace").splitlines()[1:]
        found |= {fields[inode] for fields in map(str.split, lines) if fields[3] != close_wait}
    return found


class LeakGuard:
    """Comparison of the resources before and after each test."""

    def __init__(self, grace_s: float = GRACE_S) -> None:
        self._grace_s = grace_s
        self._looker = _Looker()
        self._allowed: set[str] = set()
        self._since: dict[str, str] = {}
        self._holders: set[str] = set()
        self._clean: set[str] | None = None

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        if not self._holders:
            self._allowed = self._looker.things() if self._clean is None else self._clean
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[object], request: pytest.FixtureRequest
    ) -> Iterator[object]:
        if fixturedef.scope == "function":
            return (yield)
        name = f"{fixturedef.argname} of {fixturedef.baseid}"
        before = self._looker.things()
        result = yield
        if self._looker.things() - before:
            self._holders.add(name)
            request.node.addfinalizer(lambda: self._holders.discard(name))
        return result

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> Iterator[None]:
        yield
        self._clean = None
        if item.get_closest_marker("hardware"):
            return  # a vendor's driver keeps what it has opened until its process ends
        now = self._looker.things()
        left = now - self._allowed
        if not (left or self._holders):
            self._clean = now  # nothing happens until the next test
        if self._holders:
            for thing in left:
                self._since.setdefault(thing, item.nodeid)
            return
        left = self._after_grace(left)
        leaked = [f"{thing}, there since {self._since.get(thing, item.nodeid)}" for thing in sorted(left)]
        self._since.clear()
        if leaked:
            pytest.fail("left behind: " + "; ".join(leaked), pytrace=False)

    def _after_grace(self, left: set[str]) -> set[str]:
        deadline_s, pause, rounds = time.monotonic() + self._grace_s, threading.Event(), 0
        # Looked up again each time: a process in the midst of its start has not been recognized at first.
        while left := left and {
            thing for thing in self._looker.things() - self._allowed if not _is_deserted(thing)
        }:
            if time.monotonic() > deadline_s:
                break
            if (
                rounds
            ):  # most of it ends by itself within a moment, and a collection costs a tenth of a second
                gc.collect()  # what only a cycle still holds is not left behind
            pause.wait(0.01 * 2**rounds)
            rounds += 1
        return left
