"""The experiment's two clocks behind one Protocol (`hardware_drivers.instruments.Clock`).

The wall clock runs a real test. The simulated clock jumps to the next due time, or walks there at a
chosen pace so that a person can watch. Heartbeats and driver deadlines never use these clocks but
the machine's monotonic time.
"""

from __future__ import annotations

import sys
import threading
import time
import uuid
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S

IDLE_INTERVAL_S = 0.05
"""How often a waiting clock lets its caller look around; the Protocol allows 0.2 s."""

WINDOWS_BOOT_COUNTER = 0x7FFE0000 + 0x2C4
"""``KUSER_SHARED_DATA.BootId`` (ntddk.h, since Windows 10) in the page that the kernel shows every process at
this address. It counts starts of the kernel; the registry's copy of it may lag behind, the boot loader's GUID
may stay the same."""
_PROCESS_FRAME = f"process-{uuid.uuid4()}"


def parse_utc(text: str) -> int:
    """RFC 3339 time to integer nanoseconds of UTC.

    Raises
    ------
    ValueError
        Not a time, or a time without an offset.
    """
    moment = datetime.fromisoformat(text)
    if moment.tzinfo is None:
        raise ValueError(f"{text!r} has no UTC offset; write it like 2024-01-01T00:00:00Z")
    delta = moment.astimezone(UTC) - datetime(1970, 1, 1, tzinfo=UTC)
    return (delta.days * 86_400 + delta.seconds) * NS_PER_S + delta.microseconds * 1000


def format_utc(utc_ns: int, decimals: int = 9) -> str:
    """Integer nanoseconds of UTC to RFC 3339 (ISO 8601), cut to ``decimals`` (0 to 9) of the seconds."""
    whole, rest = divmod(utc_ns, NS_PER_S)
    stamp = datetime.fromtimestamp(whole, tz=UTC).strftime("%Y-%m-%dT%H:%M:%S")
    return stamp + (f".{rest:09d}"[: decimals + 1] if decimals else "") + "Z"


def _sysctl_text(name: str) -> str:
    """Text of a kernel variable of macOS."""
    import ctypes

    size = ctypes.c_size_t(64)
    text = ctypes.create_string_buffer(size.value)
    if ctypes.CDLL(None).sysctlbyname(name.encode(), text, ctypes.byref(size), None, ctypes.c_size_t(0)) != 0:
        raise OSError(f"sysctl {name} is not answered")
    return text.value.decode("ascii")


def _word_at(address: int) -> int:
    """Unsigned 32-bit word of this process's memory."""
    import ctypes

    return ctypes.c_uint32.from_address(address).value


def boot_name(
    platform: str = sys.platform,
    *,
    linux_file: Path = Path("/proc/sys/kernel/random/boot_id"),
    sysctl: Callable[[str], str] = _sysctl_text,
    word_at: Callable[[int], int] = _word_at,
) -> str | None:
    """Name of this boot: the same in each of its processes, another after the next start of the machine.

    The time of the boot is no name: the kernels of Windows and macOS move it when the clock is set.

    Parameters
    ----------
    linux_file, sysctl, word_at
        How the kernel is asked on Linux, macOS and Windows; injected by tests.

    Returns
    -------
    str or None
        None where the kernel names no boot (Windows before 10, other systems).
    """
    try:
        if platform == "win32":
            counter = word_at(WINDOWS_BOOT_COUNTER)
            return f"windows-boot-{counter}" if counter else None
        text = sysctl("kern.bootsessionuuid") if platform == "darwin" else linux_file.read_text("ascii")
    except (OSError, AttributeError, ValueError):
        return None
    return text.strip() or None


def boot_id() -> str:
    """Frame in which monotonic times compare: this boot, or this process where no boot has a name."""
    return boot_name() or _PROCESS_FRAME


def since_boot_ns() -> int:
    """Time of this boot, sleep included where the system counts it; no step of UTC moves it."""
    if sys.platform == "linux":
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    if sys.platform == "darwin":  # there Python's monotonic time stands still in sleep
        return time.clock_gettime_ns(time.CLOCK_MONOTONIC)
    return time.monotonic_ns()


class WallClock:
    """UTC and monotonic time of this machine."""

    def __init__(self) -> None:
        self._wake = threading.Event()

    def utc_ns(self) -> int:
        """Experiment time is the machine's UTC."""
        return time.time_ns()

    def mono_ns(self) -> int:
        """Monotonic time of the machine."""
        return time.monotonic_ns()

    def wait_until(self, utc_ns: int, idle: Callable[[], bool]) -> bool:
        """Wait in short steps; a clock step or a laptop's sleep only changes the steps left."""
        while (left_ns := utc_ns - self.utc_ns()) > 0:
            if not idle():
                return False
            self._wake.wait(min(left_ns / NS_PER_S, IDLE_INTERVAL_S))
        return idle()


class SimulatedClock:
    """Experiment time that passes only while somebody waits.

    Parameters
    ----------
    start_utc_ns
        First reading; a resumed experiment passes the time of its last committed row.
    pace_h_per_s
        Hours of experiment a second of wall time; None jumps.
    sleep
        Waits a number of seconds; injected by tests.
    """

    def __init__(
        self,
        start_utc_ns: int,
        *,
        pace_h_per_s: float | None = None,
        sleep: Callable[[float], None] = time.sleep,
        wall_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        if pace_h_per_s is not None and not pace_h_per_s > 0.0:
            raise ValueError(f"pace_h_per_s is {pace_h_per_s}; it must be positive, or None to jump")
        self._utc_ns = start_utc_ns
        self._pace_h_per_s = pace_h_per_s
        self._sleep = sleep
        self._wall_ns = wall_ns
        # Where experiment time met wall time last: pacing is measured from here, so that the
        # time spent on striking and storing is part of the pace and not added to it.
        self._anchor = (start_utc_ns, wall_ns())

    def utc_ns(self) -> int:
        """Experiment time."""
        return self._utc_ns

    def mono_ns(self) -> int:
        """Experiment time again: a simulated clock is never set back."""
        return self._utc_ns

    def finish_now(self) -> None:
        """Stop pacing: jump from here on."""
        self._pace_h_per_s = None

    def wait_until(self, utc_ns: int, idle: Callable[[], bool]) -> bool:
        """Jump, or walk at the pace, to ``utc_ns``; a time in the past is reached at once."""
        while self._pace_h_per_s is not None and utc_ns > self._utc_ns:
            due_wall_ns = (
                self._anchor[1] + (utc_ns - self._anchor[0]) / (self._pace_h_per_s * NS_PER_H) * NS_PER_S
            )
            left_s = (due_wall_ns - self._wall_ns()) / NS_PER_S
            if left_s <= 0.0:
                break
            if not idle():
                return False
            self._sleep(min(left_s, IDLE_INTERVAL_S))
        self._utc_ns = max(self._utc_ns, utc_ns)
        return idle()
