"""What a worker process does for itself: deaf to the terminal, gone when the process that asked for it is."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading


def leave_with_parent() -> None:
    """Prepare this process: Ctrl-C reaches every process of a terminal, and the parent alone decides.

    A parent that is killed cannot tell its workers, and the pipes of a pool do not.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def leave() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=leave, name="leave-with-parent", daemon=True).start()
