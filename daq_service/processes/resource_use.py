"""What this process uses of its computer: memory and handles; None where the system does not tell."""

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
            ("rest", ctypes.c_size_t * 6),
        )

    def resident_bytes() -> int | None:
        """Memory of this process that is in the computer's own (its working set)."""
        told = _MemoryCounters()
        told.cb = ctypes.sizeof(told)
        process = wintypes.HANDLE(ctypes.windll.kernel32.GetCurrentProcess())
        answered = ctypes.windll.psapi.GetProcessMemoryInfo(process, ctypes.byref(told), told.cb)
        return told.WorkingSetSize if answered else None

    def open_handles() -> int | None:
        """Count the handles of this process: files, sockets, threads, events."""
        number = wintypes.DWORD()
        process = wintypes.HANDLE(ctypes.windll.kernel32.GetCurrentProcess())
        answered = ctypes.windll.kernel32.GetProcessHandleCount(process, ctypes.byref(number))
        return number.value if answered else None

else:

    def resident_bytes() -> int | None:
        """Memory of this process that is in the computer's own."""
        try:
            return int((_PROC / "statm").read_bytes().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        except (OSError, ValueError, LookupError):  # another system, or /proc is not mounted
            return None

    def open_handles() -> int | None:
        """Count the open files and sockets of this process."""
        try:
            return len(os.listdir(_PROC / "fd")) - 1  # noqa: PTH208 the one that lists them is open meanwhile
        except OSError:
            return None
