"""A small supervisor of two children that also run alone: the recorder and the web service.

Children share nothing but the data folder. Each holds the reading end of a pipe (its standard
input) whose other end the supervisor keeps open: when the supervisor ends, however it ends, the
pipe closes and the children leave safely. A recorder whose heartbeat is overdue is killed and
started again; so is a child that crashed. A child that ends with an exit code of the table
(2 usage, 3 rig, 4 storage, 5 busy) said what is wrong: everything stops and the code is passed on. A
recorder that its operator told to stop (130) stays stopped.
"""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from daq_service.errors import EXIT_INTERRUPTED, EXIT_OK
from daq_service.processes.heartbeat import overdue_s, read_heartbeat

log = logging.getLogger(__name__)

FINAL_CODES = (2, 3, 4, 5)
RESTART_DELAYS_S = (0.2, 1.0, 2.0, 5.0, 10.0, 30.0)
HEALTHY_AFTER_S = 60.0
"""A child that lived this long starts again at the first delay."""
STARTING_GRACE_S = 60.0
"""Imports and compilation of kernels: no heartbeat is expected before."""
LEAVE_WITHIN_S = 4.0
"""Children that are told to leave get this long; the whole must end within 5 s."""
LOOK_EVERY_S = 0.05

Message = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class ChildPlan:
    """How to start a child.

    Attributes
    ----------
    arguments
        Command line after ``solimon``; ``{cause}`` in it becomes why the child is started again.
    watched
        True: its heartbeat is watched.
    environment
        Variables added to this process's own.
    """

    name: str
    arguments: Sequence[str]
    watched: bool = False
    environment: Mapping[str, str] = field(default_factory=dict)


@dataclass(slots=True)
class _Child:
    plan: ChildPlan
    process: subprocess.Popen[bytes] | None = None
    started_s: float = 0.0
    start_at_s: float = 0.0
    quick_failures: int = 0
    cause: str = ""
    finished: bool = False
    exit_code: int = EXIT_OK
    extra: list[str] = field(default_factory=list)


class Supervisor:
    """Starts the children, watches them, and takes them down together.

    Parameters
    ----------
    on_message
        Called with each JSON line a child prints: ``(child name, message)``.
    give_up
        True: end when a child has used up all restart delays, instead of trying for ever.
    program
        Command line before a plan's arguments.
    restart_delays_s
        Wait before each restart of a child that keeps failing.
    """

    def __init__(
        self,
        plans: Sequence[ChildPlan],
        folder: Path,
        *,
        on_message: Callable[[str, Message], None],
        give_up: bool = False,
        program: Sequence[str] = (sys.executable, "-m", "daq_service.cli"),
        restart_delays_s: Sequence[float] = RESTART_DELAYS_S,
    ) -> None:
        self._children = [_Child(plan=plan) for plan in plans]
        self._folder = folder
        self._on_message = on_message
        self._give_up = give_up
        self._readers: list[threading.Thread] = []
        self._program = program
        self._restart_delays_s = restart_delays_s

    def run(self, stop: threading.Event, *, stay: bool) -> int:
        """Supervise until ``stop``, a final exit code, or (unless ``stay``) the recorder's end."""
        try:
            while not stop.is_set():
                for child in self._children:
                    code = self._look_after(child, stop)
                    if code is not None:
                        return code
                recorders = [child for child in self._children if child.plan.watched]
                if recorders and all(child.finished for child in recorders) and not stay:
                    return max(child.exit_code for child in recorders)
                stop.wait(LOOK_EVERY_S)
            return EXIT_OK
        finally:
            self._take_down()

    def _look_after(self, child: _Child, stop: threading.Event) -> int | None:
        """Start, restart or kill one child as it needs; an exit code ends the supervision."""
        now = time.monotonic()
        if child.finished:
            return None
        if child.process is None:
            if now >= child.start_at_s:
                self._readers = [reader for reader in self._readers if reader.is_alive()]
                self._start(child)
            return None
        code = child.process.poll()
        if code is None:
            if child.plan.watched:
                self._kill_if_overdue(child)
            return None
        self._close_pipe(child)
        child.process = None
        if code in (EXIT_OK, EXIT_INTERRUPTED) and child.plan.watched:
            # Done, or stopped by its operator: to start it again would strike on against the order.
            child.finished = True
            child.exit_code = code
            if code == EXIT_INTERRUPTED and not stop.is_set():
                self._on_message(child.plan.name, {"event": "stopped"})
            return None
        if code in FINAL_CODES:
            return code
        return self._plan_restart(child, code, now)

    def _plan_restart(self, child: _Child, code: int, now: float) -> int | None:
        if now - child.started_s >= HEALTHY_AFTER_S:
            child.quick_failures = 0
        if self._give_up and child.quick_failures >= len(self._restart_delays_s):
            log.error("%s failed %d times in a row; giving up", child.plan.name, child.quick_failures)
            return 1
        delay_s = self._restart_delays_s[min(child.quick_failures, len(self._restart_delays_s) - 1)]
        child.quick_failures += 1
        child.start_at_s = now + delay_s
        child.cause = child.cause or _how_it_ended(code)
        log.warning("%s %s; started again in %g s", child.plan.name, child.cause, delay_s)
        return None

    def _start(self, child: _Child) -> None:
        arguments = [argument.replace("{cause}", child.cause) for argument in child.plan.arguments]
        child.process = subprocess.Popen(
            [*self._program, *arguments, *child.extra],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **child.plan.environment},
        )
        child.started_s = time.monotonic()
        child.cause = ""
        reader = threading.Thread(
            target=self._read_messages,
            args=(child, child.process),
            name=f"{child.plan.name}-messages",
            daemon=True,
        )
        reader.start()
        self._readers.append(reader)

    def _read_messages(self, child: _Child, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None
        with process.stdout as lines:
            for line in lines:
                try:
                    message = json.loads(line)
                except ValueError:
                    log.warning("%s printed a line that is no message: %r", child.plan.name, line[:200])
                    continue
                if message.get("event") == "listening" and not child.extra:
                    # A restarted web service must answer where the browsers already are.
                    child.extra = ["--port", str(message["port"])]
                self._on_message(child.plan.name, message)

    def _kill_if_overdue(self, child: _Child) -> None:
        assert child.process is not None
        beat = read_heartbeat(self._folder)
        if beat is None or beat.process != child.process.pid:
            if time.monotonic() - child.started_s > STARTING_GRACE_S:
                child.cause = f"gave no heartbeat within {STARTING_GRACE_S:g} s of its start"
                child.process.kill()
            return
        late_s = overdue_s(beat, mono_ns=time.monotonic_ns())
        if late_s > 0.0:
            child.cause = (
                f"hung while {beat.doing}: heartbeat {late_s:.1f} s past its deadline of "
                f"{beat.deadline_s:g} s"
            )
            child.process.kill()

    @staticmethod
    def _close_pipe(child: _Child) -> None:
        if child.process is not None and child.process.stdin is not None:
            try:
                child.process.stdin.close()
            except OSError as error:
                log.debug("closing the pipe of %s: %s", child.plan.name, error)

    def _take_down(self) -> None:
        """Close every pipe at once, then wait; whoever stays is killed."""
        for child in self._children:
            self._close_pipe(child)
        deadline = time.monotonic() + LEAVE_WITHIN_S
        for child in self._children:
            if child.process is None:
                continue
            try:
                child.process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                log.error("%s did not leave within %g s; killed", child.plan.name, LEAVE_WITHIN_S)
                child.process.kill()
                child.process.wait()
        for reader in self._readers:
            # Its pipe is closed at the other end; what the child said last is still to be heard.
            reader.join(max(0.1, deadline - time.monotonic()))


def _how_it_ended(code: int) -> str:
    return f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
