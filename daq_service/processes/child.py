"""Functions of a child process: handle signals, write its log, leave when its supervisor is gone."""

from __future__ import annotations

import faulthandler
import json
import logging
import logging.handlers
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import SimpleQueue
from types import FrameType

from daq_service.errors import EndedByLibraryError, SolimonError
from daq_service.processes.printing import print_line
from daq_service.settings.foreign_text import OneLineFormatter

log = logging.getLogger(__name__)

PROGRAM = (sys.executable, "-P", "-m", "daq_service.cli")
"""``solimon`` without its script. -P: a file of the present folder replaces no module of Python's."""
FLUSHED_WITHIN_S = 2.0
LOG_BYTES, LOG_FILES = 5_000_000, 5
"""Each child's log is rotated: at most 25 MB."""


@contextmanager
def stop_on_signals() -> Iterator[threading.Event]:
    """Yield an event that Ctrl-C, SIGTERM and a closed terminal (SIGHUP; Ctrl-Break on Windows) set.

    A signal that is ignored at the start stays ignored: `nohup` starts a program that outlives its terminal.
    The former handlers are restored at the end. Only the main thread of a process may call this.

    Raises
    ------
    EndedByLibraryError
        A driver or a library raised SystemExit, EOFError, or KeyboardInterrupt without a signal. Other
        exceptions pass through; signals raise nothing here.
    """
    stop = threading.Event()
    # A signal may come while this thread holds the event's lock: a handler that sets the event would
    # deadlock. Only this queue may be written to from a handler.
    signals: SimpleQueue[int | None] = SimpleQueue()

    def set_on_signal() -> None:
        """Set the event at each queued signal, until None ends the queue."""
        while signals.get() is not None:
            stop.set()

    def on_signal(number: int, frame: FrameType | None) -> None:
        """Queue the number of a signal for the waiting thread, without taking a lock."""
        del frame
        signals.put(number)

    setter = threading.Thread(target=set_on_signal, name="signals", daemon=True)
    setter.start()
    names = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in numbers}
    before = {number: handler for number, handler in before.items() if handler is not signal.SIG_IGN}
    for number in before:
        signal.signal(number, on_signal)
    try:
        yield stop
    except BaseException as ending:
        # An EOFError would be taken for the end of a person's input; KeyboardInterrupt ends a command
        # once it has received a stop signal.
        stopped_by_signal = isinstance(ending, KeyboardInterrupt) and stop.is_set()
        if stopped_by_signal or (isinstance(ending, Exception) and not isinstance(ending, EOFError)):
            raise
        raise EndedByLibraryError(ending) from ending
    finally:
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)  # None: of a library in C
        signals.put(None)
        setter.join()


def run_and_announce_exit(run: Callable[[], int], *, supervised: bool) -> int:
    """Run a child, announce its exit code (also after a SolimonError) to the supervisor, and return the code.

    A SolimonError is raised again after its announcement; other exceptions pass without one. A code without
    announcement counts as a crash in the supervisor: a library may end the process with any code. Without
    ``supervised`` nothing is announced.
    """
    announce = notify_supervisor if supervised else lambda event, **values: None
    try:
        code = run()
    except SolimonError as error:
        announce(ANNOUNCEMENT, code=error.exit_code)
        raise
    announce(ANNOUNCEMENT, code=code)
    return code


class LogFile(logging.handlers.RotatingFileHandler):
    """Rotated log whose errors end nothing: a line that the disk refuses is counted and reported later.

    Windows does not rename a file that another process reads: the log then grows until it can be rotated.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(
            path,
            maxBytes=LOG_BYTES,
            backupCount=LOG_FILES - 1,
            encoding="utf-8",
            delay=True,
            errors="replace",
        )
        self.lost = 0

    def doRollover(self) -> None:  # noqa: N802 - logging's name
        """Rotate the log; if the file system refuses, reopen and continue the present file."""
        try:
            super().doRollover()
        except OSError:
            self.stream = self._open()

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - logging's name
        """Count a line that could not be written, instead of printing a traceback for each."""
        del record
        self.lost += 1

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line, preceded by a warning with the number of lines lost since the last written one.

        If that warning cannot be written, the line is counted as lost, too.
        """
        lost, self.lost = self.lost, 0
        if lost:
            warning = {"name": __name__, "levelno": logging.WARNING, "levelname": "WARNING"}
            super().emit(logging.makeLogRecord({**warning, "msg": f"{lost} lines could not be written here"}))
        if self.lost:
            self.lost = lost + 1
        else:
            super().emit(record)


def log_to_file(path: Path) -> None:
    """Log to a rotated file, and crashes below Python to a file with the suffix ``.crash``.

    Adds a handler to the root logger, sets it to INFO (Alembic and numba to WARNING) and captures Python
    warnings. If the folder or a file cannot be created, a warning is printed and the process continues.
    """
    handler = LogFile(path)
    handler.setFormatter(
        OneLineFormatter("%(asctime)s.%(msecs)03d %(levelname)s %(name)s: %(message)s", "%Y-%m-%dT%H:%M:%S")
    )
    root = logging.getLogger()
    root.addHandler(handler)
    root.setLevel(logging.INFO)
    logging.captureWarnings(True)  # a held terminal would block the recording thread
    # Alembic and numba log every step at this level.
    for verbose_package in ("alembic", "numba"):
        logging.getLogger(verbose_package).setLevel(logging.WARNING)
    try:
        path.parent.mkdir(exist_ok=True)
        path.touch()
        faulthandler.enable(path.with_suffix(".crash").open("a", encoding="utf-8"))
    except OSError as error:
        print_line(f"solimon: no log in {path.parent}: {error.strerror}; the test continues without it")


@contextmanager
def log_in_thread(path: Path) -> Iterator[None]:
    """Log as `log_to_file` within a context, but write in a thread: a slow disk does not delay the caller.

    On exit waits at most `FLUSHED_WITHIN_S` (2 s) for queued lines; later ones are lost.
    """
    log_to_file(path)
    root = logging.getLogger()
    handler, lines = root.handlers[-1], SimpleQueue[logging.LogRecord]()
    root.handlers[-1] = logging.handlers.QueueHandler(lines)
    logging.handlers.QueueListener(lines, handler).start()
    try:
        yield
    finally:
        end_s = time.monotonic() + FLUSHED_WITHIN_S
        while not lines.empty() and time.monotonic() < end_s:
            time.sleep(0.01)


ANNOUNCEMENT = "ends"
"""Event that announces the end of the process with the exit code ``code``."""
FAREWELL = b"."
"""Sent by a supervisor before it closes a child's pipe; without it the supervisor was killed."""


def stop_when_pipe_closes(stop: threading.Event) -> threading.Event:
    """Start a thread that sets ``stop`` in a child once the supervisor's pipe (standard input) closes.

    Returns at once.

    Returns
    -------
    threading.Event
        Set before ``stop`` if the supervisor ended without `FAREWELL`.
    """
    pipe = sys.stdin.fileno()
    supervisor_killed = threading.Event()

    def wait_for_close() -> None:
        # Not through Python's buffer: a thread that waits in it holds its lock at the interpreter's shutdown.
        """Wait for the farewell or the end of the pipe, then set the events."""
        if os.read(pipe, 1) != FAREWELL:
            supervisor_killed.set()
        stop.set()

    threading.Thread(target=wait_for_close, name="supervisor-pipe", daemon=True).start()
    return supervisor_killed


def start_detached_process(command: Sequence[str], standard_input: bytes) -> subprocess.Popen[bytes]:
    """Start a program that outlives this one, without signals of its terminal, and return the process.

    Its standard output and error are discarded. A program that ends before it reads its input is no error.

    Parameters
    ----------
    standard_input
        Content of its standard input, closed afterwards.

    Raises
    ------
    OSError
        The program cannot be started.
    """
    flags = 0
    if sys.platform == "win32":
        flags = subprocess.DETACHED_PROCESS | subprocess.CREATE_NEW_PROCESS_GROUP
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        creationflags=flags,
    )
    assert process.stdin is not None
    with suppress(OSError), process.stdin as pipe:  # it has ended already: its log says why
        pipe.write(standard_input)
    return process


def notify_supervisor(event: str, **values: object) -> None:
    """Send a message from a child to its supervisor as one JSON line on standard output, without blocking.

    ``values`` must be JSON-ready. A supervisor that is gone or suspended is no error here: a line that does
    not fit into the full pipe is dropped (the kernel takes it completely or not at all) and logged. Standard
    output stays non-blocking, except on Windows.
    """
    pipe = sys.stdout.fileno()
    if hasattr(os, "set_blocking") and sys.platform != "win32":
        os.set_blocking(pipe, False)
    try:
        os.write(pipe, json.dumps({"event": event, **values}).encode() + b"\n")
    except OSError as error:
        log.log(logging.DEBUG if event == "beat" else logging.INFO, "no reader for %s: %s", event, error)
