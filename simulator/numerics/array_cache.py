"""Cache of computed arrays on disk, keyed by a hash of everything that determines them.

A file is `MAGIC`, the SHA-256 of the rest, the header's length (u32), the header (JSON, padded with
spaces to a multiple of 64 bytes): ``[[name, shape], ...]``, and the arrays as little-endian float64.
It is written next to its place and renamed, so it is complete or absent, whenever its writer ends; what
a killed writer leaves is swept once it is `STALE_S` old. A damaged file is computed again. A folder that
cannot be read or written costs time, nothing else. Nothing is flushed to the disk's platters: what a
power failure spoils is a damaged file.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import os
import tempfile
import time
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Final

import numpy as np
import platformdirs

from simulator.numerics.arrays import FloatArray
from simulator.numerics.one_thread import describe_blas_libraries
from simulator.numerics.source import hash_source

log = logging.getLogger(__name__)

DEFAULT_CACHE_FOLDER: Final = platformdirs.user_cache_path("solimon", appauthor=False) / "reductions"
"""The user's cache folder; hand in another one to keep tests or machines apart."""

MAGIC: Final = b"solimon1"
DIGEST_BYTES: Final = 32
ALIGNMENT: Final = 64
SUFFIX: Final = ".arrays"
UNFINISHED_SUFFIX: Final = ".part"

STALE_S: Final = 600.0
"""An unfinished file of this age has lost its writer, who needs a moment; a writer that slept meanwhile
finds its file gone, and its arrays are computed again another time."""

FOLDER_LIMIT_BYTES: Final = 500_000_000
"""Beyond this the oldest files are removed: several hundred plates."""


def read_or_compute_arrays(
    folder: Path | None, key: str, compute: Callable[[], Mapping[str, FloatArray]]
) -> dict[str, FloatArray]:
    """Read the arrays stored in `folder` under `key`, or compute and store them.

    Unfinished files of killed writers are removed; a file that cannot be written is only logged.
    Errors of ``compute`` are passed on.

    Parameters
    ----------
    folder
        None computes without any disk. Kept or not, the arrays are the same to the last bit.
    key
        From `compute_cache_key`: every change of the arrays must change it.
    compute
        Makes the arrays, float64 of any shape, by name.
    """
    if folder is None:
        return _as_float64(compute())
    path = folder / f"{key}{SUFFIX}"
    _remove_unfinished_files(folder)
    found = read_arrays(path)
    if found is None:
        found = _as_float64(compute())
        write_arrays(path, found)
    return found


def compute_cache_key(described: Mapping[str, object]) -> str:
    """Return the SHA-256 (hex) of a description, the simulator's code and the numerical libraries.

    Parameters
    ----------
    described
        The name of the computation and all its inputs; a value that `json.dumps` does not accept raises
        TypeError.
    """
    text = json.dumps({"described": described, "made_with": _describe_environment()}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def _describe_environment() -> dict[str, object]:
    """Return the code hash, library versions and BLAS kernels that determine the last digits; cached."""
    libraries = {name: version(name) for name in ("numpy", "scipy", "numba")}
    return {"code": hash_source(), "libraries": libraries, "blas": describe_blas_libraries()}


def read_arrays(path: Path) -> dict[str, FloatArray] | None:
    """Read arrays written by `write_arrays`; None if there is no complete and readable file.

    A damaged or unreadable file is logged; its arrays must be computed again.
    """
    try:
        stored = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        log.warning("cannot read the cached arrays %s (%s); computing them", path, error)
        return None
    content = memoryview(stored)[len(MAGIC) + DIGEST_BYTES :]
    digest = stored[len(MAGIC) : len(MAGIC) + DIGEST_BYTES]
    if not stored.startswith(MAGIC) or hashlib.sha256(content).digest() != digest:
        log.warning("the cached arrays %s are damaged; computing them again", path)
        return None
    header_end = 4 + int.from_bytes(content[:4], "little")
    arrays = {}
    offset = header_end
    for name, shape in json.loads(bytes(content[4:header_end])):
        count = math.prod(shape)
        values = np.frombuffer(content, dtype="<f8", count=count, offset=offset)
        arrays[name] = values.astype(np.float64).reshape(shape)  # a copy, aligned and writable
        offset += 8 * count
    return arrays


def write_arrays(
    path: Path, arrays: Mapping[str, FloatArray], *, limit_bytes: int = FOLDER_LIMIT_BYTES
) -> None:
    """Write `arrays` to `path` atomically; if the folder cannot be written, log that and store nothing.

    Beyond `limit_bytes` the folder loses its oldest files.
    """
    content = _encode_arrays(arrays)
    unfinished = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.stem, suffix=UNFINISHED_SUFFIX)
        unfinished = Path(name)
        with os.fdopen(handle, "wb") as file:
            file.write(MAGIC + hashlib.sha256(content).digest())
            file.write(content)
        unfinished.replace(path)
        _limit_folder_size(path.parent, limit_bytes)
    except OSError as error:
        # Windows lets no one replace a file that another process is reading: then it is there already.
        level = logging.DEBUG if path.is_file() else logging.WARNING
        log.log(level, "cannot keep the arrays in %s (%s); going on without", path.parent, error)
        if unfinished is not None:
            _remove_file(unfinished)


def _as_float64(arrays: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Convert arrays to C-contiguous float64; copy only those that are not."""
    return {name: np.asarray(values, dtype=np.float64, order="C") for name, values in arrays.items()}


def _encode_arrays(arrays: Mapping[str, FloatArray]) -> bytes:
    """Encode arrays as little-endian float64 after a header (length, JSON names and shapes)."""
    header = json.dumps([[name, values.shape] for name, values in arrays.items()]).encode()
    before = len(MAGIC) + DIGEST_BYTES + 4
    header += b" " * (-(before + len(header)) % ALIGNMENT)
    blocks = [np.asarray(values, dtype="<f8").tobytes() for values in arrays.values()]
    return b"".join((len(header).to_bytes(4, "little"), header, *blocks))


def _remove_unfinished_files(folder: Path) -> None:
    """Remove unfinished files older than 600 s, left by killed writers; on Windows an open file stays."""
    now = time.time()
    for entry in _list_cache_files(folder):
        if entry.name.endswith(UNFINISHED_SUFFIX):
            status = _get_file_status(entry)
            if status is not None and now - status.st_mtime > STALE_S:
                _remove_file(Path(entry.path))


def _limit_folder_size(folder: Path, limit_bytes: int) -> None:
    """Remove the oldest cache files until the folder is within the limit in bytes; the newest stays."""
    files = [
        (entry, _get_file_status(entry)) for entry in _list_cache_files(folder) if entry.name.endswith(SUFFIX)
    ]
    oldest = sorted(((s.st_mtime_ns, s.st_size, e.path) for e, s in files if s is not None), reverse=True)
    total = sum(size for _, size, _ in oldest)
    while total > limit_bytes and len(oldest) > 1:
        _, size, path = oldest.pop()
        total -= size
        _remove_file(Path(path))


def _list_cache_files(folder: Path) -> list[os.DirEntry[str]]:
    """List the directory entries of a cache folder; return an empty list if it cannot be read."""
    try:
        with os.scandir(folder) as found:
            return list(found)
    except OSError as error:  # absent until the first file is written; else writing will say it
        log.debug("cannot list %s (%s)", folder, error)
        return []


def _get_file_status(entry: os.DirEntry[str]) -> os.stat_result | None:
    """Return the status of a file; None if it cannot be read, such as after another process removed it."""
    try:
        return entry.stat()
    except OSError as error:  # renamed or removed by another process
        log.debug("cannot look at %s (%s)", entry.path, error)
        return None


def _remove_file(path: Path) -> None:
    """Remove a file; log a failure instead of raising an error."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        log.warning("cannot remove %s (%s)", path, error)
