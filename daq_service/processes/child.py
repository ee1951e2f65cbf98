"""What a child process does for itself: hear signals, write its log, leave when its supervisor is gone."""

from __future__ import annotations

import faulthandler
import json
import logging
import logging.handlers
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

log = logging.getLogger(__name__)

LOG_BYTES, LOG_FILES = 5_000_000, 5
"""Each child's log is rotated: at most 25 MB."""


@contextmanager
def stop_on_signals() -> Iterator[threading.Event]:
    """Give an event that Ctrl-C and SIGTERM set."""
    stop = threading.Event()

    def on_signal(number: int, frame: FrameType | None) -> None:
        del number, frame
        stop.set()

    numbers = [signal.SIGINT] + ([signal.SIGTERM] if hasattr(signal, "SIGTERM") else [])
    before = {number: signal.signal(number, on_signal) for number in numbers}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def log_to(path: Path) -> None:
    """Rotated log file, and a file of its own for crashes below Python."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handler = logging.handlers.RotatingFileHandler(
        path, maxBytes=LOG_BYTES, backupCount=LOG_FILES - 1, encoding="utf-8"
    )
    handler.setFormatter(
        logging.Formatter("%(asctime)s.%(msecs)03d %(levelname)s %(name)s: %(message)s", "%Y-%m-%dT%H:%M:%S")
    )
    root = logging.getLogger()
    root.addHandler(handler)
    root.setLevel(logging.INFO)
    # Alembic and numba tell every step at this level.
    for talkative in ("alembic", "numba"):
        logging.getLogger(talkative).setLevel(logging.WARNING)
    faulthandler.enable(path.with_suffix(".crash").open("a", encoding="utf-8"))


def leave_when_pipe_closes(stop: threading.Event) -> None:
    """In a child: set ``stop`` once the supervisor's pipe (standard input) closes."""
    pipe = sys.stdin.fileno()

    def watch() -> None:
        # Nothing is ever sent: the read returns at the end of the pipe. Below Python's buffer, whose
        # lock a thread waiting in it would take into the interpreter's shutdown.
        while os.read(pipe, 1):
            pass
        stop.set()

    threading.Thread(target=watch, name="supervisor-pipe", daemon=True).start()


def tell_supervisor(event: str, **values: object) -> None:
    """In a child: one JSON line to the supervisor; a supervisor that is gone is no error here."""
    try:
        sys.stdout.write(json.dumps({"event": event, **values}) + "\n")
        sys.stdout.flush()
    except OSError as error:
        log.info("nobody reads %s: %s", event, error)
