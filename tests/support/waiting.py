"""Waits of tests that have other processes and threads to wait for: bounded, and never part of the answer.

A wait that runs out says "machine too slow", which is about the machine; an answer that came and is wrong
fails the test's own assertion.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from multiprocessing.process import BaseProcess
from subprocess import Popen, TimeoutExpired
from typing import Any, TypeVar

WAIT_S = 120.0
"""Deadline of what takes seconds at most: reached on a machine that hangs, not on one that is busy."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.001, 0.05
"""Pauses double: what is asked for may cost as much as what is waited for."""
PAUSE_PER_QUESTION = 9.0
"""A pause lasts at least so many times as long as its question computed: asking takes a tenth of a core."""

T = TypeVar("T")


class MachineTooSlowError(Exception):
    """Timeout of a wait in a test; whether the result would be right is unknown."""

    def __init__(self, what: str) -> None:
        super().__init__(f"machine too slow: {what} did not happen within {WAIT_S:g} s")


def happened(wait: Callable[[float], bool], what: str) -> None:
    """Wait with a function that takes a timeout and returns whether it happened."""
    if not wait(WAIT_S):
        raise MachineTooSlowError(what)


def until(found: Callable[[], T | None], what: str) -> T:
    """Poll until the result is something other than None, False or empty."""
    deadline_s = time.monotonic() + WAIT_S
    pause, pause_s = threading.Event(), FIRST_PAUSE_S
    asked_s = time.thread_time()
    while not (answer := found()):
        if time.monotonic() > deadline_s:
            raise MachineTooSlowError(what)
        pause.wait(max(pause_s, PAUSE_PER_QUESTION * (time.thread_time() - asked_s)))
        asked_s = time.thread_time()
        pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)
    return answer


def ended(running: threading.Thread | BaseProcess | Popen[Any], what: str) -> None:
    """Wait for the end of a thread or a process."""
    if not isinstance(running, Popen):
        running.join(WAIT_S)
        still = running.is_alive()
    else:
        try:
            running.wait(WAIT_S)
        except TimeoutExpired:
            still = True
        else:
            still = False
    if still:
        raise MachineTooSlowError(what)
