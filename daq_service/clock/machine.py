"""Clocks of the computer: monotonic time, time since its boot, UTC and whether that is synchronised."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from daq_service.clock.boot import boot_name
from hardware_drivers.nanoseconds import NS_PER_S

KERNEL_GIVES_UP_US = 16_000_000
"""Linux: the kernel's estimate of the error of a clock that nobody synchronises, or no longer does."""


def select_elapsed_clock(platform: str = sys.platform) -> Callable[[], int]:
    """Return the function that reads the time since the boot in ns, sleep included, on this platform.

    This clock cannot be set. Linux and macOS have it in addition to the usual monotonic clock, which stops in
    their sleep; that of Windows (GetTickCount64, from Python 3.13 on QueryPerformanceCounter) counts on.
    Elsewhere sleep is not counted.
    """
    name = {"linux": "CLOCK_BOOTTIME", "darwin": "CLOCK_MONOTONIC_RAW"}.get(platform, "")
    clock_id = getattr(time, name, None)
    return time.monotonic_ns if clock_id is None else partial(time.clock_gettime_ns, clock_id)


elapsed_ns = select_elapsed_clock()


def is_synchronised(platform: str = sys.platform) -> bool:
    """Return whether the kernel reports the system's UTC as synchronised; False if it is unknown.

    Only Linux is asked (adjtimex): its maximum error must be below `KERNEL_GIVES_UP_US`. The flag of the
    kernel is not used, because some programs set it for another reason.
    """
    if platform != "linux":
        return False
    import ctypes

    class Timex(ctypes.Structure):
        """The beginning of ``struct timex`` (adjtimex(2)); ``modes`` 0 only reads."""

        _fields_ = (
            ("modes", ctypes.c_uint),
            ("offset", ctypes.c_long),
            ("freq", ctypes.c_long),
            ("maxerror", ctypes.c_long),
            ("rest", ctypes.c_byte * 256),
        )

    timex = Timex()
    try:
        succeeded = ctypes.CDLL(None).adjtimex(ctypes.byref(timex)) >= 0
    except (OSError, AttributeError):
        return False
    return bool(succeeded and timex.maxerror < KERNEL_GIVES_UP_US)


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineClock:
    """Times of this computer, and how it waits; a test passes times of its own.

    Attributes
    ----------
    mono_ns
        Monotonic time, for intervals and deadlines.
    elapsed_ns
        Time since the boot, sleep included.
    utc_ns
        UTC of the system, which may be set.
    boot_name
        Name of this boot; None where it has none.
    is_synchronised
        The kernel reports UTC as synchronised.
    sleep
        Waits a number of seconds.
    """

    mono_ns: Callable[[], int] = time.monotonic_ns
    elapsed_ns: Callable[[], int] = elapsed_ns
    utc_ns: Callable[[], int] = time.time_ns
    boot_name: Callable[[], str | None] = boot_name
    is_synchronised: Callable[[], bool] = is_synchronised
    sleep: Callable[[float], None] = time.sleep

    def mono_s(self) -> float:
        """Return the monotonic time in s, counted from an arbitrary start."""
        return self.mono_ns() / NS_PER_S


MACHINE = MachineClock()
"""The clock of the computer that runs this process."""
