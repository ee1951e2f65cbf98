"""The name of a boot, by which monotonic times of different processes compare."""

from __future__ import annotations

import sys
import uuid
from collections.abc import Callable
from pathlib import Path

WINDOWS_BOOT_COUNTER = 0x7FFE0000 + 0x2C4
"""``KUSER_SHARED_DATA.BootId`` (ntddk.h, since Windows 10) in the page that the kernel shows every process at
this address. It counts starts of the kernel; the registry's copy of it may lag behind, the boot loader's GUID
may stay the same."""
_PROCESS_FRAME = f"process-{uuid.uuid4()}"


def _read_sysctl_text(name: str) -> str:
    """Read the text of a kernel variable of macOS (``sysctlbyname``), at most 63 characters.

    Raises
    ------
    OSError
        There is no such variable, or its text is longer.
    AttributeError
        The system has no ``sysctlbyname``.
    UnicodeDecodeError
        The text is not ASCII.
    """
    import ctypes

    size = ctypes.c_size_t(64)
    text = ctypes.create_string_buffer(size.value)
    if ctypes.CDLL(None).sysctlbyname(name.encode(), text, ctypes.byref(size), None, ctypes.c_size_t(0)) != 0:
        raise OSError(f"sysctl {name} is not answered")
    return text.value.decode("ascii")


def _read_memory_word(address: int) -> int:
    """Read an unsigned 32-bit word of this process's memory; an unmapped address ends the process."""
    import ctypes

    return ctypes.c_uint32.from_address(address).value


def boot_name(
    platform: str = sys.platform,
    *,
    linux_file: Path = Path("/proc/sys/kernel/random/boot_id"),
    sysctl: Callable[[str], str] = _read_sysctl_text,
    word_at: Callable[[int], int] = _read_memory_word,
) -> str | None:
    """Return the name of the current boot: the same in each process, different after the next start.

    The time of the boot is no name: the kernels of Windows and macOS move it when the clock is set.

    Parameters
    ----------
    linux_file, sysctl, word_at
        File or functions that read the kernel's value on Linux, macOS and Windows; injected by tests.

    Returns
    -------
    str or None
        None where the kernel names no boot (Windows before 10, other systems), or its value cannot be read.
    """
    try:
        if platform == "win32":
            counter = word_at(WINDOWS_BOOT_COUNTER)
            return f"windows-boot-{counter}" if counter else None
        text = sysctl("kern.bootsessionuuid") if platform == "darwin" else linux_file.read_text("ascii")
    except (OSError, AttributeError, ValueError):
        return None
    return text.strip() or None


def read_boot_id() -> str:
    """Return an identifier of the current boot; if the kernel names none, a random one of this process.

    Monotonic times of processes with equal identifiers can be compared.
    """
    return boot_name() or _PROCESS_FRAME
