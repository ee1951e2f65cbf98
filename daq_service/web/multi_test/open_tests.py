"""Tests of a service, each opened on request and closed when idle."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from pathlib import Path

from daq_service.errors import UsageError
from daq_service.web.answers.problem import PROBLEM_TYPES, Problem, not_found
from daq_service.web.auth.middleware import AccessPolicy
from daq_service.web.context import Context
from daq_service.web.multi_test.location import AbsentError, find_folder, locate_test, read_title
from daq_service.web.multi_test.names import build_unique_slugs

log = logging.getLogger(__name__)

IDLE_S = 60.0
"""A test without a request for this time is closed."""
LOOK_EVERY_S = 10.0
MOST_IDLE = 8
"""Maximum of open idle tests: each needs some 5 MB for events and two threads."""


class ServedTest:
    """Test of a service; `title` for a person, `context` while it is open."""

    def __init__(self, name: str, title: str, path: Path) -> None:
        self.name, self.title, self.path = name, title, path
        self.context: Context | None = None
        self.users = 0
        self.notifies: bool | None = None
        """True: it has receivers of notifications and stays open. None: it could not be read yet."""
        self.used_s = 0.0
        self.changing = asyncio.Lock()
        self.resources = AsyncExitStack()


class ServedTests:
    """All tests of a service by their name in addresses; used on the event loop.

    Raises
    ------
    UsageError
        Two paths mean the same folder.
    """

    def __init__(self, paths: Sequence[Path], access_policy: AccessPolicy) -> None:
        folders: dict[Path, Path] = {}
        for path in paths:
            other = folders.setdefault(find_folder(path).resolve(), path)
            if other is not path:
                raise UsageError(f"{other} and {path} mean the same test; leave one of them out")
        self.access_policy = access_policy
        titles = [read_title(path) for path in paths]
        entries = zip(build_unique_slugs(titles), titles, paths, strict=True)
        self.all = {name: ServedTest(name, title, path) for name, title, path in entries}

    def count_streams(self) -> int:
        """Count the open event streams of all open tests."""
        return sum(test.context.hub.clients for test in self.all.values() if test.context is not None)

    def close_streams(self) -> None:
        """Request the end of every open stream without waiting, before the server waits for its responses."""
        for test in self.all.values():
            if test.context is not None:
                test.context.close_streams()

    def find(self, name: str) -> ServedTest:
        """Return the test with this slug (name in URLs).

        Raises
        ------
        Problem
            404: there is none of this name.
        """
        if name not in self.all:
            raise not_found(f"There is no test {name[:80]!r}.", "/api/v1/tests lists them.")
        return self.all[name]

    @asynccontextmanager
    async def use(self, test: ServedTest) -> AsyncIterator[Context]:
        """Open a test unless it is open and yield its context; the test stays open until the block ends.

        Raises
        ------
        Problem
            503: it cannot be shown now, and why.
        """
        test.users += 1
        try:
            async with test.changing:
                context = test.context or await self._open_test(test)
            yield context
        finally:
            test.users -= 1
            test.used_s = time.monotonic()

    async def _open_test(self, test: ServedTest) -> Context:
        """Open a test and start its background tasks; idle tests are closed to keep at most 8 idle ones.

        Raises a Problem (503) if it cannot be shown.
        """
        await self.close_idle_tests(keep=MOST_IDLE - 1)
        try:
            settings, folder = await asyncio.to_thread(locate_test, test.path, self.access_policy)
        except AbsentError as error:
            raise create_test_unavailable(error) from None
        context = Context(settings, folder, access_policy=self.access_policy, open_streams=self.count_streams)
        await test.resources.enter_async_context(context.run_background_tasks())
        test.context = context
        log.info("opened %s: %s", test.name, folder)
        return context

    async def close_idle_tests(self, *, keep: int = MOST_IDLE, for_s: float = 0.0) -> None:
        """Close idle tests except the ``keep`` most recent ones, and all idle for ``for_s`` seconds or more.

        With ``for_s`` 0 only ``keep`` counts. Tests that send notifications or have requests stay open. Waits
        until the tests are closed.
        """
        now_s = time.monotonic()
        shown = [test for test in self.all.values() if test.context is not None and not test.notifies]
        idle = [test for test in shown if not test.users]
        idle.sort(key=lambda test: test.used_s, reverse=True)
        for rank, test in enumerate(idle):
            if rank >= keep or now_s - test.used_s >= for_s > 0.0:
                async with test.changing:
                    if not test.users:  # a request may have come meanwhile
                        await self._close_test(test)

    async def _close_test(self, test: ServedTest) -> None:
        """Stop the background tasks of a test, wait for them, and close its data; no effect if closed."""
        test.context = None
        await test.resources.aclose()
        log.info("closed %s", test.name)

    async def maintain_tests(self) -> None:
        """Open tests with receivers and close those idle for 60 s, every 10 s until canceled."""
        while True:
            await self.open_notifying_tests()
            await asyncio.sleep(LOOK_EVERY_S)
            await self.close_idle_tests(for_s=IDLE_S)

    async def open_notifying_tests(self) -> None:
        """Open the tests that have receivers of notifications; these tests then stay open.

        A test that cannot be read or shown is tried again at the next call.
        """
        for test in self.all.values():
            with suppress(Problem, AbsentError):
                if test.notifies is None:
                    settings, _ = await asyncio.to_thread(locate_test, test.path, self.access_policy)
                    test.notifies = bool(settings.notifications.receivers)
                if test.notifies:
                    async with self.use(test):
                        pass

    async def close(self) -> None:
        """Close all tests, also those in use, and wait for their background tasks."""
        for test in self.all.values():
            async with test.changing:
                await self._close_test(test)


def create_test_unavailable(error: AbsentError) -> Problem:
    """Create, without raising it, the error that a test cannot be shown, with the remedy (503)."""
    return Problem(
        "no-data-yet" if error.state == "no_data" else "test-unavailable",
        f"{error}",
        error.remedy,
        title=PROBLEM_TYPES["test-unavailable"].title,
    )
