"""Inherited settings of a process, reset to what solimon expects.

Streams, signals, timers, limits and the mask of new files come from a shell, a scheduler or another program.
None of them may change what an exit code means, end a test or silence its alarms.
"""

from __future__ import annotations

import io
import os
import signal
import sys
from pathlib import Path


def reset_inherited_settings() -> None:
    """Reset streams, encodings, file mask, signals, timers and limits that this process inherited.

    Closed standard streams are replaced by the null device, text that cannot be encoded is escaped, new files
    are not writable by others, and a deleted working directory is replaced by the root. Not on Windows:
    signals are unblocked, SIGTTOU is ignored, interval timers stop, and the soft limits of CPU time, file
    size and memory become the hard ones. Ignored signals stay ignored (`child.stop_on_signals`), but for
    SIGCHLD, without which the exit code of every child would be read as 0.
    """
    for descriptor, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(descriptor)
        except OSError:
            # The next opened file would get this descriptor, and with it all printed text.
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
        if getattr(sys, name) is None:
            mode = "w" if descriptor else "r"
            setattr(sys, name, open(descriptor, mode, encoding="utf-8", closefd=False))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    os.umask(os.umask(0) & 0o077 | 0o002)  # the owner reads and writes, others do not write
    try:
        Path.cwd()
    except OSError:  # deleted: workers of a process start in its folder
        os.chdir(os.sep)
    if sys.platform == "win32":
        return
    import resource

    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.signal(signal.SIGTTOU, signal.SIG_IGN)  # `stty tostop` would stop a background process that prints
    for timer in (signal.ITIMER_REAL, signal.ITIMER_VIRTUAL, signal.ITIMER_PROF):
        signal.setitimer(timer, 0.0)
    for limit in (resource.RLIMIT_CPU, resource.RLIMIT_FSIZE, resource.RLIMIT_AS, resource.RLIMIT_DATA):
        _, hard = resource.getrlimit(limit)
        resource.setrlimit(limit, (hard, hard))
