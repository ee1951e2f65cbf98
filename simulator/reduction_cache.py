"""Reduced plates kept on disk, found by a hash of everything that makes them.

A file holds the SHA-256 of its content and then the content (three arrays in numpy's `.npz`). It is
written beside its place and renamed, so it is complete or absent; a damaged one is computed again. A
folder that cannot be read or written costs time, nothing else.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import os
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Final

import numpy as np
import platformdirs
import scipy

from simulator import mindlin_plate, plate_reduction
from simulator.one_thread import one_blas_thread
from simulator.plate_parameters import CorrosionParameters, PlateParameters
from simulator.plate_reduction import ReducedPlate

log = logging.getLogger(__name__)

DEFAULT_CACHE_FOLDER: Final = platformdirs.user_cache_path("solimon", appauthor=False) / "reductions"
"""The user's cache folder; hand in another one to keep tests or machines apart."""

DIGEST_BYTES = 32


def reduced_plate(
    plate: PlateParameters, corrosion: CorrosionParameters, folder: Path | None = DEFAULT_CACHE_FOLDER
) -> ReducedPlate:
    """Reduce the plate for this outline of the patch, or read the reduction kept in `folder`.

    Parameters
    ----------
    plate, corrosion
        The specimen; `corrosion.depth_fraction` has no influence.
    folder
        None computes without any disk. Cached or not, the answer is the same to the last bit.
    """
    path = None if folder is None else folder / f"{reduction_key(plate, corrosion)}.reduction"
    found = None if path is None else _read(path)
    if found is not None:
        return found
    with one_blas_thread():
        reduction = plate_reduction.reduce_plate(mindlin_plate.build_plate(plate, corrosion))
    if path is not None:
        _write(path, reduction)
    return reduction


def reduction_key(plate: PlateParameters, corrosion: CorrosionParameters) -> str:
    """Hash of the specimen, of the code that reduces it and of the libraries that compute it."""
    footprint = asdict(corrosion)
    del footprint["depth_fraction"]
    sources = [Path(str(module.__file__)).read_bytes() for module in (mindlin_plate, plate_reduction)]
    described = json.dumps(
        {
            "plate": asdict(plate),
            "patch": footprint,
            "code": [hashlib.sha256(source).hexdigest() for source in sources],
            "numpy": np.__version__,
            "scipy": scipy.__version__,
        },
        sort_keys=True,
    )
    return hashlib.sha256(described.encode()).hexdigest()


def _read(path: Path) -> ReducedPlate | None:
    try:
        stored = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        log.warning("cannot read the cached reduction %s (%s); computing it", path, error)
        return None
    digest, content = stored[:DIGEST_BYTES], stored[DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        log.warning("the cached reduction %s is damaged; computing it again", path)
        return None
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        return ReducedPlate(stiffness=arrays["stiffness"], mass=arrays["mass"], load=arrays["load"])


def _write(path: Path, reduction: ReducedPlate) -> None:
    buffer = io.BytesIO()
    np.savez(buffer, stiffness=reduction.stiffness, mass=reduction.mass, load=reduction.load)
    content = buffer.getvalue()
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=path.stem, suffix=".part")
        with os.fdopen(handle, "wb") as file:
            file.write(hashlib.sha256(content).digest() + content)
        Path(temporary).replace(path)
    except OSError as error:
        log.warning("cannot keep the reduction in %s (%s); going on without", path.parent, error)
        if temporary is not None:
            _discard(Path(temporary))


def _discard(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        log.warning("cannot remove %s (%s)", path, error)
