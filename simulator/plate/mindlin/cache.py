"""Cache of reduced plates on disk: one for every depth of a patch (see `array_cache`)."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from simulator.numerics.array_cache import DEFAULT_CACHE_FOLDER, compute_cache_key, read_or_compute_arrays
from simulator.numerics.arrays import FloatArray
from simulator.numerics.one_thread import use_one_blas_thread
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin.plate import build_plate
from simulator.plate.mindlin.reduction import reduce_plate
from simulator.plate.reduced import ReducedPlate

__all__ = ["DEFAULT_CACHE_FOLDER", "hash_reduction", "load_reduced_plate"]


def load_reduced_plate(
    plate: PlateParameters, corrosion: CorrosionParameters, folder: Path | None = DEFAULT_CACHE_FOLDER
) -> ReducedPlate:
    """Return the reduced plate for this outline of the patch: read from the cache, or computed and stored.

    The reduction runs with BLAS limited to one thread.

    Parameters
    ----------
    plate, corrosion
        The specimen; `corrosion.depth_fraction` has no influence.
    folder
        None computes without any disk. Cached or not, the answer is the same to the last bit.

    Raises
    ------
    SpecimenError
        A patch does not fit on the plate, overlaps another one or cannot be meshed.
    numpy.linalg.LinAlgError
        A matrix is not positive definite.
    """

    def compute_arrays() -> dict[str, FloatArray]:
        """Reduce the plate in one BLAS thread; return its arrays by name."""
        with use_one_blas_thread():
            return asdict(reduce_plate(build_plate(plate, corrosion)))

    return ReducedPlate(**read_or_compute_arrays(folder, hash_reduction(plate, corrosion), compute_arrays))


def hash_reduction(plate: PlateParameters, corrosion: CorrosionParameters) -> str:
    """Return the cache key of a reduction: SHA-256 of specimen (without depth), code and libraries."""
    footprint = asdict(corrosion)
    del footprint["depth_fraction"]
    return compute_cache_key({"reduction": "mindlin", "plate": asdict(plate), "patch": footprint})
