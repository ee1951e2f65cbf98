"""What a child process does for itself: hear signals, write its log, leave when its supervisor is gone."""

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
LOG_BYTES, LOG_FILES = 5_000_000, 5
"""Each child's log is rotated: at most 25 MB."""


@contextmanager
def stop_on_signals() -> Iterator[threading.Event]:
    """Give an event that Ctrl-C, SIGTERM and a closed terminal (SIGHUP; Ctrl-Break on Windows) set.

    A signal that is ignored at the start stays ignored: `nohup` starts a program that outlives its terminal.

    Raises
    ------
    EndedByLibraryError
        A driver or a library raised what would end the process. Signals raise nothing in here.
    """
    stop = threading.Event()
    # A signal may come while this very thread holds the event's lock, which it would wait for then; this
    # queue alone may be put into from within a handler.
    heard: SimpleQueue[int | None] = SimpleQueue()

    def set_when_heard() -> None:
        while heard.get() is not None:
            stop.set()

    def on_signal(number: int, frame: FrameType | None) -> None:
        del frame
        heard.put(number)

    setter = threading.Thread(target=set_when_heard, name="signals", daemon=True)
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
        # An EOFError would pass for the end of a person's input; a command ends so once it has heard a stop.
        heard_stop = isinstance(ending, KeyboardInterrupt) and stop.is_set()
        if heard_stop or (isinstance(ending, Exception) and not isinstance(ending, EOFError)):
            raise
        raise EndedByLibraryError(ending) from ending
    finally:
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)  # None: of a library in C
        heard.put(None)
        setter.join()


def announced(run: Callable[[], int], *, supervised: bool) -> int:
    """Return the exit code of a child, which is announced to its supervisor first, also that of an error.

    A code without announcement counts as a crash there: a library may end the process with any code.
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
    """A rotated log that ends nothing: a line that the disk does not take is counted and told later.

    Windows renames no file that somebody reads: then the log grows on until it can be rotated.
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
        """Rotate, or go on with the present file."""
        try:
            super().doRollover()
        except OSError:
            self.stream = self._open()

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - logging's name
        """Count a line that was not written; logging itself would print a traceback for each."""
        del record
        self.lost += 1

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line, and before it how many were lost since the last one."""
        lost, self.lost = self.lost, 0
        if lost:
            told = {"name": __name__, "levelno": logging.WARNING, "levelname": "WARNING"}
            super().emit(logging.makeLogRecord({**told, "msg": f"{lost} lines could not be written here"}))
        if self.lost:
            self.lost = lost + 1
        else:
            super().emit(record)


def log_to(path: Path) -> None:
    """Rotated log file, and a file of its own for crashes below Python; a log that cannot be is a warning."""
    handler = LogFile(path)
    handler.setFormatter(
        OneLineFormatter("%(asctime)s.%(msecs)03d %(levelname)s %(name)s: %(message)s", "%Y-%m-%dT%H:%M:%S")
    )
    root = logging.getLogger()
    root.addHandler(handler)
    root.setLevel(logging.INFO)
    logging.captureWarnings(True)  # a terminal that is held would hold the line
    # Alembic and numba tell every step at this level.
    for talkative in ("alembic", "numba"):
        logging.getLogger(talkative).setLevel(logging.WARNING)
    try:
        path.parent.mkdir(exist_ok=True)
        path.touch()
        faulthandler.enable(path.with_suffix(".crash").open("a", encoding="utf-8"))
    except OSError as error:
        print_line(f"solimon: no log in {path.parent}: {error.strerror}; the test goes on without")


@contextmanager
def log_in_thread(path: Path, *, flush_within_s: float = 2.0) -> Iterator[None]:
    """Write the log as `log_to` does, in a thread: a disk that hangs delays no line of the caller."""
    log_to(path)
    root = logging.getLogger()
    handler, lines = root.handlers[-1], SimpleQueue[logging.LogRecord]()
    root.handlers[-1] = logging.handlers.QueueHandler(lines)
    logging.handlers.QueueListener(lines, handler).start()
    try:
        yield
    finally:
        end_s = time.monotonic() + flush_within_s
        while not lines.empty() and time.monotonic() < end_s:
            time.sleep(0.01)


ANNOUNCEMENT = "ends"
"""Event: the process ends now, with the exit code ``code``."""
FAREWELL = b"."
"""What a supervisor sends before it closes a child's pipe: an end without it means that it was killed."""


def leave_when_pipe_closes(stop: threading.Event) -> threading.Event:
    """In a child: set ``stop`` once the supervisor's pipe (standard input) closes.

    Returns
    -------
    threading.Event
        Set before ``stop`` where the supervisor is gone without a word.
    """
    pipe = sys.stdin.fileno()
    left_alone = threading.Event()

    def watch() -> None:
        # Below Python's buffer, whose lock a thread waiting in it would take into the interpreter's shutdown.
        if os.read(pipe, 1) != FAREWELL:
            left_alone.set()
        stop.set()

    threading.Thread(target=watch, name="supervisor-pipe", daemon=True).start()
    return left_alone


def start_detached(command: Sequence[str], given: bytes) -> subprocess.Popen[bytes]:
    """Start a program that no signal to this one's terminal reaches and that outlives it.

    Parameters
    ----------
    given
        What it reads from its standard input.
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
    with suppress(OSError), process.stdin as standard_input:  # it has ended already: its log says why
        standard_input.write(given)
    return process


def notify_supervisor(event: str, **values: object) -> None:
    """In a child: one JSON line to the supervisor.

    A supervisor that is gone is no error here, nor one that stands still: a line that its full pipe does
    not take is dropped (the kernel takes one of this length whole or not at all).
    """
    pipe = sys.stdout.fileno()
    if hasattr(os, "set_blocking") and sys.platform != "win32":
        os.set_blocking(pipe, False)
    try:
        os.write(pipe, json.dumps({"event": event, **values}).encode() + b"\n")
    except OSError as error:
        log.log(logging.DEBUG if event == "beat" else logging.INFO, "nobody reads %s: %s", event, error)
