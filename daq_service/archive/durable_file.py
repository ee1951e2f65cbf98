"""Put bytes on a disk so that they survive: a whole file appears, or none.

Every call that may fail goes through `os` by name, which is where the fault tests interpose. Never
is a file of this archive written by HDF5 itself: a full disk would end the process.
"""

from __future__ import annotations

import logging
import os
import sys
import time
from pathlib import Path

log = logging.getLogger(__name__)

_O_BINARY = getattr(os, "O_BINARY", 0)


def write_durably(path: Path, content: bytes, *, temporary: Path) -> tuple[float, float, float]:
    """Write a temporary file, sync it, rename it, sync its folder.

    On an error nothing new is left, as far as the disk still allows it; a ``path`` that existed
    stays, old or new.

    Returns
    -------
    tuple of float
        Seconds spent on writing, on fsync, and on rename and fsync of the folder.

    Raises
    ------
    OSError
        ``content`` is not durable. A failed fsync is never repeated on the same file, since the
        second one may succeed although the data are gone: call again, which writes a new file.
    """
    start = time.perf_counter()
    existed = path.exists()
    renamed = False
    try:
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | _O_BINARY, 0o644)
        try:
            _write_all(descriptor, content)
            written = time.perf_counter()
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        synced = time.perf_counter()
        os.replace(temporary, path)  # noqa: PTH105 - the seam is os
        renamed = True
        sync_folder(path.parent)
    except OSError:
        if not renamed:
            remove_quietly(temporary)
        elif not existed:
            remove_quietly(path)
        raise
    return written - start, synced - written, time.perf_counter() - synced


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable; Windows has no such call and keeps names in its own journal."""
    if sys.platform == "win32":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove_quietly(path: Path) -> None:
    """Remove a file that must not stay; a disk that refuses even this is logged."""
    try:
        os.unlink(path)  # noqa: PTH108 - the seam is os
    except FileNotFoundError:
        return
    except OSError as error:
        log.warning("cannot remove the unfinished %s: %s", path, error)


def _write_all(descriptor: int, content: bytes) -> None:
    rest = memoryview(content)
    while rest:
        rest = rest[os.write(descriptor, rest) :]
