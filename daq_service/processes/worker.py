"""Worker processes that ignore Ctrl-C, end with their parent, and are noticed when they die."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor


def leave_with_parent() -> None:
    """Ignore Ctrl-C in this process, and end it with code 1, without cleanup, when its parent ends.

    Without a parent of `multiprocessing` only Ctrl-C is ignored. A parent that is killed cannot notify its
    workers, and the pipes of a pool do not.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def leave() -> None:
        """Wait for the end of the parent, then end this process."""
        parent.join()
        os._exit(1)

    threading.Thread(target=leave, name="leave-with-parent", daemon=True).start()


def start_one_worker(
    initializer: Callable[..., None] = leave_with_parent, *arguments: object
) -> ProcessPoolExecutor:
    """Start a pool of one spawned process at once; the caller shuts it down.

    If the process dies, its tasks raise BrokenExecutor.

    Parameters
    ----------
    initializer
        Called in the process with ``arguments``; it has to call `leave_with_parent`.
    """
    executor = ProcessPoolExecutor(
        max_workers=1,
        # A fork would copy the locks of the recorder's threads, its sockets and its lock on the folder.
        mp_context=multiprocessing.get_context("spawn"),
        initializer=initializer,
        initargs=arguments,
    )
    # The process starts with its first task.
    executor.submit(os.getpid)
    if sys.platform != "win32":
        # A worker that is killed while it writes its result leaves an incomplete one. The pool would read on
        # for ever while it holds the writing end itself: without it, the pipe ends with the worker.
        executor._result_queue._writer.close()  # type: ignore[attr-defined]
    return executor
