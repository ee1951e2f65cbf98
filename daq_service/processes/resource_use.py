"""Resource use of this process: memory and handles; None where the system does not report it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

_PROC = Path("/proc/self")

if sys.platform == "win32":
    import ctypes
    from ctypes import wintypes

    class _MemoryCounters(ctypes.Structure):
        """``PROCESS_MEMORY_COUNTERS`` of the Windows API."""

        _fields_ = (
            ("cb", wintypes.DWORD),
            ("PageFaultCount", wintypes.DWORD),
            ("PeakWorkingSetSize", ctypes.c_size_t),
            ("WorkingSetSize", ctypes.c_size_t),
            ("remaining", ctypes.c_size_t * 6),
        )

    def resident_bytes() -> int | None:
        """Return the resident memory (working set) of this process in bytes; None if not reported."""
        counters = _MemoryCounters()
        counters.cb = ctypes.sizeof(counters)
        process = wintypes.HANDLE(ctypes.windll.kernel32.GetCurrentProcess())
        succeeded = ctypes.windll.psapi.GetProcessMemoryInfo(process, ctypes.byref(counters), counters.cb)
        return counters.WorkingSetSize if succeeded else None

    def open_handles() -> int | None:
        """Count the handles of this process (files, sockets, threads, events); None if not reported."""
        number = wintypes.DWORD()
        process = wintypes.HANDLE(ctypes.windll.kernel32.GetCurrentProcess())
        succeeded = ctypes.windll.kernel32.GetProcessHandleCount(process, ctypes.byref(number))
        return number.value if succeeded else None

else:

    def resident_bytes() -> int | None:
        """Return the resident memory (working set) of this process in bytes; None if not reported."""
        try:
            return int((_PROC / "statm").read_bytes().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        except (OSError, ValueError, LookupError):  # another system, or /proc is not mounted
            return None

    def open_handles() -> int | None:
        """Count the open files and sockets of this process; None if the system does not report them."""
        try:
            return len(os.listdir(_PROC / "fd")) - 1  # noqa: PTH208 the descriptor of the listing is one of them
        except OSError:
            return None
