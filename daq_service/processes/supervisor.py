"""Supervisor of two child processes that also run alone: the recorder and the web service.

The children share only the data folder. Each holds the reading end of a pipe (its standard input) whose other
end the supervisor keeps open: when the supervisor ends, however it ends, the pipe closes and the children end
safely. A recorder whose heartbeat is overdue is killed and started again; so is a child that crashed. A
driver or a vendor's library may end the process with any exit code, so a code counts only if the child
announced it on its pipe before it ended (`child.run_and_announce_exit`). A child that announces a code of the
table (2 usage, 3 rig, 4 storage, 5 busy) names its problem: everything stops and the supervisor returns the
code. Where other children stay, a recorder whose test has started ends alone, and its code is returned when
they are stopped. A web service that has listened once is always restarted: it ends no test. A recorder that
its operator stopped (130) stays stopped.
"""

from __future__ import annotations

import json
import logging
import os
import queue
import subprocess
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from daq_service.clock import MACHINE, MachineClock
from daq_service.errors import EXIT_INTERRUPTED, EXIT_OK
from daq_service.processes.child import ANNOUNCEMENT, FAREWELL, PROGRAM
from daq_service.processes.heartbeat import WEB_FILE, Beat, compute_beat_age_s, parse_beat, read_heartbeat
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

FINAL_CODES = (2, 3, 4, 5)
RESTART_DELAYS_S = (0.2, 1.0, 2.0, 5.0, 10.0, 30.0)
HEALTHY_AFTER_S = 60.0
"""A child that ran this long is restarted after the first delay."""
STARTING_GRACE_S = 60.0
"""Imports and compilation of kernels: no heartbeat is expected before."""
LEAVE_WITHIN_S = 4.0
"""Time for children to end by themselves; the whole shutdown must end within 5 s."""
LOOK_EVERY_S = 0.05
ANNOUNCED_WITHIN_S = 1.0
"""Time to read the last line of an ended child, also where its workers hold the pipe."""

Message = Mapping[str, Any]
Starter = Callable[[Sequence[str], Mapping[str, str]], "subprocess.Popen[bytes]"]


def start_process(command: Sequence[str], environment: Mapping[str, str]) -> subprocess.Popen[bytes]:
    """Start a program with pipes for its streams, and variables added to those of this process.

    Without pipes, a driver that prints would wait for a terminal that a person holds. Raises OSError if the
    program cannot be started.
    """
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, env={**os.environ, **environment})


@dataclass(frozen=True, slots=True, kw_only=True)
class ChildPlan:
    """Start parameters of a child.

    Attributes
    ----------
    arguments
        Command line after ``solimon``; ``{cause}`` in it is replaced by the cause of a restart.
    watched
        True: the recorder, whose heartbeat is watched from its start; that of others, from their first beat.
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
    started_ns: int = 0
    start_at_ns: int = 0
    reported_beat: Beat | None = None
    """Newest beat on its pipe."""
    beat: Beat | None = None
    """Newest beat on its pipe or in its file."""
    quick_failures: int = 0
    cause: str = ""
    has_started: bool = False
    """The child has reported a set, or the address at which it listens."""
    finished: bool = False
    exit_code: int = EXIT_OK
    announced: int | None = None
    """Exit code announced by the present process."""
    reader: threading.Thread | None = None
    extra: list[str] = field(default_factory=list)


class Supervisor:
    """Starts the children, watches them, and ends them together.

    Parameters
    ----------
    on_message
        Called with ``(child name, message)`` for each JSON line a child prints, of its beats only for those
        with a new activity, for ``restarts`` of it (``cause``, ``in_s``), and for lines ``printed`` on
        standard error (``text``). It may block (a console with selected text): children do not wait for it.
    give_up
        True: end when a child has used up all restart delays, instead of trying for ever.
    program
        Command line before a plan's arguments.
    restart_delays_s
        Wait before each restart of a child that keeps failing.
    leave_within_s
        Time for children to end by themselves before they are killed.
    guard
        Called at every check: it does the work of a recorder that is missing or hangs.
    start, read_beat
        Start a program, read the heartbeat of a folder.
    """

    def __init__(
        self,
        plans: Sequence[ChildPlan],
        folder: Path,
        *,
        on_message: Callable[[str, Message], None],
        give_up: bool = False,
        program: Sequence[str] = PROGRAM,
        restart_delays_s: Sequence[float] = RESTART_DELAYS_S,
        leave_within_s: float = LEAVE_WITHIN_S,
        guard: Callable[[], None] = lambda: None,
        start: Starter = start_process,
        read_beat: Callable[[Path], Beat | None] = read_heartbeat,
        machine: MachineClock = MACHINE,
    ) -> None:
        self._children = [_Child(plan=plan) for plan in plans]
        self._folder = folder
        self._on_message = on_message
        self._give_up = give_up
        self._readers: list[threading.Thread] = []
        self._messages: queue.SimpleQueue[tuple[str, Message]] = queue.SimpleQueue()
        self._program = program
        self._restart_delays_s = restart_delays_s
        self._leave_within_s = leave_within_s
        self._guard = guard
        self._start_process = start
        self._read_beat = read_beat
        self._machine, self._boot = machine, machine.boot_name()
        self._stay = False

    def run(self, stop: threading.Event, *, stay: bool) -> int:
        """Supervise until ``stop``, a final exit code, or (unless ``stay``) the recorder's end.

        Returns the exit code; after ``stop`` the highest one of the ended children, 130 excluded. Before it
        returns, all children are ended, and killed after ``leave_within_s``. Raises OSError if a child cannot
        be started.
        """
        self._stay = stay
        try:
            while not stop.is_set():
                for child in self._children:
                    code = self._check_child(child, stop)
                    if code is not None:
                        return code
                self._deliver_messages()
                recorders = [child for child in self._children if child.plan.watched]
                if not stay and recorders and all(child.finished for child in recorders):
                    return max(child.exit_code for child in recorders)
                self._guard()
                stop.wait(LOOK_EVERY_S)
            codes = (child.exit_code for child in self._children)
            return max((code for code in codes if code != EXIT_INTERRUPTED), default=EXIT_OK)
        finally:
            self._end_children()
            self._deliver_messages()

    def _deliver_messages(self) -> None:
        """Pass the queued messages of the children to ``on_message``, in order of arrival."""
        while not self._messages.empty():
            self._on_message(*self._messages.get())

    def _check_child(self, child: _Child, stop: threading.Event) -> int | None:
        """Start, restart or finish one child, or kill it if its heartbeat is overdue; queue messages of it.

        Returns None, or the exit code with which the supervision ends. Raises OSError if it cannot be
        started.
        """
        if child.finished:
            return None
        if child.process is None:
            if self._machine.mono_ns() >= child.start_at_ns:
                self._readers = [reader for reader in self._readers if reader.is_alive()]
                self._start_child(child)
            return None
        code = child.process.poll()
        if code is None:
            if (child.plan.watched or child.reported_beat) and (cause := self._find_overdue_reason(child)):
                child.cause = cause
                child.process.kill()
            return None
        assert child.reader is not None, "it was started with the process"
        child.reader.join(ANNOUNCED_WITHIN_S)
        self._close_pipe(child)
        child.process = None
        if child.announced is None:
            return self._schedule_restart(child, code)
        code = child.announced
        if code in (EXIT_OK, EXIT_INTERRUPTED) and child.plan.watched:
            # Done, or stopped by its operator: a restart would strike on against the command.
            child.finished = True
            child.exit_code = code
            if code == EXIT_INTERRUPTED and not stop.is_set():
                self._messages.put((child.plan.name, {"event": "stopped"}))
            return None
        if code in FINAL_CODES and child.plan.watched and child.has_started and self._stay:
            # The test has started: the dashboard stays, and the code is returned at the end.
            log.error("%s ended with exit code %d; the dashboard stays", child.plan.name, code)
            child.finished, child.exit_code = True, code
            self._messages.put((child.plan.name, {"event": "failed", "code": code}))
            return None
        if code in FINAL_CODES and (child.plan.watched or not child.has_started):
            return code
        return self._schedule_restart(child, code)

    def _schedule_restart(self, child: _Child, code: int) -> int | None:
        """Schedule the restart of a child after the next delay, log it and queue the message; return None.

        Returns exit code 1 instead if the supervisor may give up and all delays are used up.
        """
        now_ns = self._machine.mono_ns()
        if now_ns - child.started_ns >= HEALTHY_AFTER_S * NS_PER_S:
            child.quick_failures = 0
        if self._give_up and child.quick_failures >= len(self._restart_delays_s):
            log.error("%s failed %d times in a row; giving up", child.plan.name, child.quick_failures)
            return 1
        delay_s = self._restart_delays_s[min(child.quick_failures, len(self._restart_delays_s) - 1)]
        child.quick_failures += 1
        child.start_at_ns = now_ns + round(delay_s * NS_PER_S)
        child.cause = child.cause or _describe_exit_code(code)
        if child.announced is None and code in (EXIT_OK, EXIT_INTERRUPTED, *FINAL_CODES):
            child.cause += ", which it had not announced"
        log.warning("%s %s; started again in %g s", child.plan.name, child.cause, delay_s)
        self._messages.put((child.plan.name, {"event": "restarts", "cause": child.cause, "in_s": delay_s}))
        return None

    def _start_child(self, child: _Child) -> None:
        """Start the process of a child and the threads that read its standard error and output.

        Resets its beats, announced code and cause. Raises OSError if the program cannot be started.
        """
        arguments = [argument.replace("{cause}", child.cause) for argument in child.plan.arguments]
        child.started_ns, child.cause = self._machine.mono_ns(), ""
        child.reported_beat = child.beat = child.announced = None
        child.process = self._start_process(
            [*self._program, *arguments, *child.extra], child.plan.environment
        )
        for target in (self._read_errors, self._read_messages):
            child.reader = threading.Thread(
                target=target, args=(child, child.process), name=f"{child.plan.name}-pipe", daemon=True
            )
            child.reader.start()
            self._readers.append(child.reader)

    def _read_errors(self, child: _Child, process: subprocess.Popen[bytes]) -> None:
        """Queue each line of a child's standard error as an event ``printed``, until the stream ends."""
        assert process.stderr is not None
        with process.stderr as lines:
            for line in lines:
                text = line.decode(errors="replace").rstrip()
                self._messages.put((child.plan.name, {"event": "printed", "text": text}))

    def _read_messages(self, child: _Child, process: subprocess.Popen[bytes]) -> None:
        """Read the JSON lines of a child's standard output until it ends; queue or store them.

        Beats, the announced exit code and the port of a web service (for its restart) are stored; other lines
        are queued, beats only with a new activity. A line that is no message is logged.
        """
        assert process.stdout is not None
        with process.stdout as lines:
            for line in lines:
                try:
                    message = json.loads(line)
                    event = message["event"]
                    if event == "beat":
                        before, child.reported_beat = child.reported_beat, parse_beat(message)
                        if before is not None and before.doing == child.reported_beat.doing:
                            continue
                    if event == ANNOUNCEMENT:
                        if child.process is process:
                            child.announced = int(message["code"])
                        continue
                    if event == "listening" and not child.extra:
                        # A restarted web service must answer where the browsers already are.
                        child.extra = ["--port", str(message["port"])]
                except (ValueError, TypeError, LookupError, AttributeError, OverflowError):
                    log.warning("%s printed a line that is not a message: %r", child.plan.name, line[:200])
                    continue
                child.has_started = child.has_started or event in ("progress", "listening")
                self._messages.put((child.plan.name, message))

    def _find_overdue_reason(self, child: _Child) -> str:
        """Return the reason why a running child must be killed; empty while its heartbeat is in time.

        Overdue is a beat past its deadline, or no beat within 60 s of the start. Updates ``child.beat``.
        """
        beats = (child.reported_beat, self._read_child_beat(child))
        now_ns = self._machine.mono_ns()
        # A folder has one recorder: a beat since the start is this child's. Process numbers are reused, and
        # a launcher (Windows, virtual environments) has another one than its Python. A file that cannot be
        # read or written does not discard earlier beats.
        for beat in beats:
            if (
                beat is not None
                and beat.mono_ns >= (child.started_ns if child.beat is None else child.beat.mono_ns)
                and compute_beat_age_s(beat, boot=self._boot, mono_ns=now_ns) is not None
            ):
                child.beat = beat
        if child.beat is None:
            late = now_ns - child.started_ns > STARTING_GRACE_S * NS_PER_S
            return f"gave no heartbeat within {STARTING_GRACE_S:g} s of its start" if late else ""
        late_s = (now_ns - child.beat.mono_ns) / NS_PER_S - child.beat.deadline_s
        if late_s <= 0.0:
            return ""
        return (
            f"hung while {child.beat.doing}: heartbeat {late_s:.1f} s past its deadline of "
            f"{child.beat.deadline_s:g} s"
        )

    def _read_child_beat(self, child: _Child) -> Beat | None:
        """Return the heartbeat in the file of a child: of the folder's recorder, or of this web service.

        None if there is none, or if a web service with another process number wrote it.
        """
        if child.plan.watched:
            return self._read_beat(self._folder)
        # A supervisor that was suspended reads its pipe late. Another service may serve the folder.
        beat = read_heartbeat(self._folder, WEB_FILE)
        return beat if beat and child.reported_beat and beat.process == child.reported_beat.process else None

    @staticmethod
    def _close_pipe(child: _Child) -> None:
        """Write `FAREWELL` to the standard input of a child and close it; a closed pipe is no error."""
        if child.process is not None and child.process.stdin is not None:
            with suppress(OSError, ValueError):  # the child is gone, or its pipe is closed already
                child.process.stdin.write(FAREWELL)
                child.process.stdin.close()

    def _end_children(self) -> None:
        """Close the pipes of all children and wait up to ``leave_within_s``; kill those that do not end.

        Their last messages are then read, for at least 0.1 s each.
        """
        for child in self._children:
            self._close_pipe(child)
        deadline_ns = self._machine.mono_ns() + round(self._leave_within_s * NS_PER_S)

        def remaining_s(minimum_s: float) -> float:
            """Return the time until the deadline, s, but at least ``minimum_s``."""
            return max(minimum_s, (deadline_ns - self._machine.mono_ns()) / NS_PER_S)

        for child in self._children:
            if child.process is None:
                continue
            try:
                child.process.wait(remaining_s(0.0))
            except subprocess.TimeoutExpired:
                log.error("%s did not leave within %g s; killed", child.plan.name, self._leave_within_s)
                child.process.kill()
                child.process.wait()
        for reader in self._readers:
            # Its pipe is closed at the other end; the last messages of the child are still to be read.
            reader.join(remaining_s(0.1))


def _describe_exit_code(code: int) -> str:
    """Return a phrase for how a process ended; a negative exit code is the signal that killed it."""
    return f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
