"""Files shared by the processes of a test: one writer, any number of readers, virus scanners and indexers.

There are two kinds. A *durable* file is complete or absent after a power cut: `write_durably`. A *hint*
(heartbeat, live figure, log) may be empty, torn or missing, and readers continue without it:
`write_best_effort`, `read_best_effort`.

Windows neither opens, renames nor removes a file that another process holds in certain ways (sharing
violation, a PermissionError); a moment later it does. Calls that must not fail for that are retried by
`retry`. Where rights are missing for good, the same error is raised after `PATIENCE_S`.

Calls that may fail go through `os` by name, where the fault tests interpose. HDF5 itself
never writes a file: a full disk would end the process.
"""

from __future__ import annotations

import errno
import logging
import os
import sys
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

from daq_service.errors import StorageUnavailableError

log = logging.getLogger(__name__)

T = TypeVar("T")

PATIENCE_S = 5.0
"""A virus scanner holds a new file for some tenths of a second."""
REPORT_AFTER_S = 1.0
"""A longer refusal is logged, also where it ends in time."""
LONGEST_PAUSE_S = 0.05
HINT_SUFFIX = ".tmp"

LARGEST_BYTES = 4 * 1024**3
"""Limit of a file that is read completely: a foreign one may be sparse and of any size."""

BUFFERS_A_CALL = 512
"""Half of the limit of the operating systems."""
O_BINARY = getattr(os, "O_BINARY", 0)


def load_module_toml(module: str) -> dict[str, object]:
    """Read the TOML file next to a module, with the same name and the suffix ``.toml``.

    Parameters
    ----------
    module
        Path of the module (``__file__``).

    Raises
    ------
    OSError, TOMLDecodeError
        The file cannot be read, or is no TOML.
    """
    return tomllib.loads(Path(module).with_suffix(".toml").read_text(encoding="utf-8"))


def retry(
    call: Callable[[], T],
    *,
    is_refusal: Callable[[Exception], bool] = lambda error: isinstance(error, PermissionError),
    patience_s: float = PATIENCE_S,
    report_after_s: float = REPORT_AFTER_S,
    pause: Callable[[float], None] = time.sleep,
) -> T:
    """Call a function, again while it is refused, for up to ``patience_s``; return its result.

    The pauses grow from 1 ms to `LONGEST_PAUSE_S`. Any other error is raised at once, a refusal after
    ``patience_s``.

    Parameters
    ----------
    is_refusal
        Whether an error is worth another try; default: a PermissionError.
    report_after_s
        A refusal that lasts longer is logged once as a warning.
    pause
        Waits a number of seconds; injected by tests.
    """
    started_s = time.monotonic()
    pause_s, reported = 0.001, False
    while True:
        try:
            return call()
        except Exception as error:
            waited_s = time.monotonic() - started_s
            if not is_refusal(error) or waited_s >= patience_s:
                raise
            if not reported and waited_s >= report_after_s:
                log.warning("refused, tried again for %g s at most: %s", patience_s, error)
                reported = True
        pause(pause_s)
        pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)


def read_shared(path: Path, first: int = 0, last: int | None = None) -> bytes:
    """Read a file that another process may be replacing, or its bytes ``first`` to ``last`` (exclusive).

    Bytes after the end of the file are left out. A refusal by Windows is retried for `PATIENCE_S`.

    Raises
    ------
    OSError
        It cannot be read, also after `PATIENCE_S`; or ``last`` is None and more than `LARGEST_BYTES` are
        left.
    """

    def read() -> bytes:
        """Read the requested bytes once; more than `LARGEST_BYTES` without ``last`` raise OSError (EFBIG)."""
        with path.open("rb") as file:
            if last is None and file.seek(0, os.SEEK_END) - first > LARGEST_BYTES:
                raise OSError(errno.EFBIG, f"{os.strerror(errno.EFBIG)}: more than {LARGEST_BYTES} bytes")
            file.seek(first)
            return file.read(-1 if last is None else last - first)

    return retry(read)


def read_best_effort(path: Path) -> bytes | None:
    """Read a file without waiting; return None if it is absent or (logged) cannot be read now."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        log.debug("%s cannot be read now: %s", path, error)
        return None


def write_best_effort(path: Path, content: bytes) -> OSError | None:
    """Replace a file by rename, without fsync or retry; return the error if it was not replaced, else None.

    The temporary file has the same name with the suffix `HINT_SUFFIX`; after an error it may remain.
    """
    partial = path.with_suffix(HINT_SUFFIX)
    try:
        partial.write_bytes(content)
        os.replace(partial, path)  # noqa: PTH105 - the seam is os
    except OSError as error:
        return error
    return None


def write_durably(
    path: Path, content: bytes | Iterator[bytes], *, temporary: Path, mode: int = 0o644
) -> tuple[float, float, float]:
    """Write a file that survives a power cut: write and sync a temporary file, rename it, sync the folder.

    Content may come in parts. On an error no new file remains, as far as the disk still allows it; a ``path``
    that existed remains, old or new. Refusals by Windows are retried for `PATIENCE_S`.

    Parameters
    ----------
    temporary
        Path of the temporary file, on the same volume; overwritten if it exists.
    mode
        Rights of the new file; Windows ignores them and applies those of the folder.

    Returns
    -------
    tuple of float
        Seconds spent on writing, on fsync, and on rename and fsync of the folder.

    Raises
    ------
    OSError
        ``content`` is not durable. A failed fsync is never repeated on the same file, since the second one
        may succeed although the data are gone: call again, which writes a new file.
    """
    start = time.perf_counter()
    existed = path.exists()
    renamed = False
    try:
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | O_BINARY
        descriptor = retry(lambda: os.open(temporary, flags, mode))
        try:
            for part in [content] if isinstance(content, bytes) else content:
                write_all(descriptor, [part])
            written = time.perf_counter()
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        synced = time.perf_counter()
        retry(lambda: os.replace(temporary, path))  # noqa: PTH105 - the seam is os
        renamed = True
        sync_folder(path.parent)
    except Exception:
        if not renamed:
            remove_quietly(temporary)
        elif not existed:
            remove_quietly(path)
        raise
    return written - start, synced - written, time.perf_counter() - synced


def write_output(path: Path, content: bytes | Iterator[bytes]) -> None:
    """Write or replace a file that a person requested, durably, and completely or not at all.

    Missing parent folders are created.

    Raises
    ------
    StorageUnavailableError
        The disk refuses; the message names the file.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_durably(path, content, temporary=path.with_name(f".{path.name}.part"))
    except OSError as error:
        raise StorageUnavailableError(
            f"{path} cannot be written: {error.strerror or error}; free or repair the disk"
        ) from error


def sync_folder(folder: Path, *, patience_s: float = PATIENCE_S) -> None:
    """Sync a folder to disk (fsync), so that new names in it survive a power cut; do nothing on Windows.

    Windows has no such call and journals names itself. A PermissionError at opening is retried.

    Raises
    ------
    OSError
        The folder cannot be opened, also after ``patience_s``, or the sync fails.
    """
    if sys.platform == "win32":
        return
    descriptor = retry(lambda: os.open(folder, os.O_RDONLY), patience_s=patience_s)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove_quietly(path: Path) -> None:
    """Remove a file if it exists; no OSError is raised.

    A refusal is retried for `PATIENCE_S`; an error that remains is logged as a warning.
    """
    try:
        retry(lambda: os.unlink(path))  # noqa: PTH108 - the seam is os
    except FileNotFoundError:
        return
    except OSError as error:
        log.warning("cannot remove the unfinished %s: %s", path, error)


def write_all(descriptor: int, buffers: Sequence[bytes | memoryview]) -> None:
    """Write all buffers completely, in order, to an open file descriptor.

    Up to `BUFFERS_A_CALL` buffers are passed per call where the system has ``writev``.

    Raises
    ------
    OSError
        The disk refuses; a part may be written.
    """
    step = BUFFERS_A_CALL if hasattr(os, "writev") else 1
    for start in range(0, len(buffers), step):
        batch = buffers[start : start + step]
        if len(batch) > 1:
            written = os.writev(descriptor, batch)
            if written == sum(map(len, batch)):
                continue
            batch = [b"".join(batch)[written:]]
        remaining = memoryview(batch[0])
        while remaining:
            remaining = remaining[os.write(descriptor, remaining) :]
