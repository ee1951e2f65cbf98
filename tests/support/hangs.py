"""A test that nothing in Python can interrupt ends its process, with the stacks of all its threads.

The time limit of a test is an exception in its main thread. It never comes while that thread waits inside C,
and a library that catches whatever a test raises, as Hypothesis does, begins anew. `conftest.py` takes the
hook over; with several processes of tests the others go on, and the report names the test.
"""

from __future__ import annotations

import faulthandler
import os
from collections.abc import Iterator

import pytest

GRACE_S = 120.0
"""After the time limit: the interrupted test still cleans up."""


class HangGuard:
    """Watchdog for each test, in a thread that needs no Python to run."""

    def __init__(self, grace_s: float = GRACE_S) -> None:
        self._grace_s = grace_s
        self._stderr = os.dup(2)  # what pytest captures would die with the process

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        marker = item.get_closest_marker("timeout")
        limit_s = float(marker.args[0] if marker else item.config.getini("timeout"))
        faulthandler.dump_traceback_later(limit_s + self._grace_s, exit=True, file=self._stderr)
        try:
            return (yield)
        finally:
            faulthandler.cancel_dump_traceback_later()

    def pytest_unconfigure(self) -> None:
        os.close(self._stderr)
