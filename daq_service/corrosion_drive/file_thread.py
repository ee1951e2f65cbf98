"""Thread for jobs on files, so that a disk that hangs delays nothing else."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Self

FLUSH_WITHIN_S = 5.0


class FileThread:
    """Thread that runs the newest job; a pending job is replaced by a newer one."""

    def __init__(self) -> None:
        """Create the thread; it starts when the context is entered."""
        self._changed = threading.Condition()
        self._job: Callable[[], None] | None = None
        self._busy = self._closed = False
        self._thread = threading.Thread(target=self._run_newest_jobs, name="files", daemon=True)

    def __enter__(self) -> Self:
        """Start the thread."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Close the thread; a pending job is run first.

        Wait for that up to `FLUSH_WITHIN_S`, but not at all while a job is running: it may hang.
        """
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join(0.0 if self._busy else FLUSH_WITHIN_S)

    def run(self, job: Callable[[], None]) -> None:
        """Queue a job to run as soon as the previous one has ended; return without waiting.

        It replaces a job that has not started, which then never runs.
        """
        with self._changed:
            self._job = job
            self._changed.notify_all()

    def flush(self, within_s: float = FLUSH_WITHIN_S) -> bool:
        """Wait until no job is pending or running; return False if that takes longer than ``within_s``.

        After an error of a job the thread has ended, and a pending job is waited for in vain.
        """
        with self._changed:
            return self._changed.wait_for(lambda: self._job is None and not self._busy, within_s)

    def _run_newest_jobs(self) -> None:
        """Run the newest job whenever there is one, until the thread is closed (body of the thread).

        A job that is pending then is run before the end. An error of a job ends the thread.
        """
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._job is not None or self._closed)
                if (job := self._job) is None:
                    return
                self._job, self._busy = None, True
            try:
                job()
            finally:
                with self._changed:
                    self._busy = False
                    self._changed.notify_all()
