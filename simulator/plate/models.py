"""Plate model of a specimen: modes at any depth of the patch."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import asdict, replace
from pathlib import Path
from typing import Protocol

from simulator.numerics.array_cache import compute_cache_key, read_or_compute_arrays
from simulator.numerics.arrays import FloatArray
from simulator.numerics.one_thread import use_one_blas_thread
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin.cache import load_reduced_plate
from simulator.plate.reduced import PlateModes
from simulator.plate.solid.family import SolidFamily, build_solid_family, restore_family
from simulator.plate.solid.plate import check_solid_parameters
from simulator.plate.solid.reduction import SHALLOWEST_FRACTION, find_solid_modes

DEPTHS_KNOWN = 256
"""Depths whose modes a solid plate remembers, the first ones forgotten first."""


class ModalPlate(Protocol):
    """Finite plate under the chain."""

    def modes(self, depth_fraction: float) -> PlateModes:
        """Compute all modes of the model with the patch thinned by `depth_fraction` of the thickness."""
        ...


def prepare_modal_plate(
    plate: PlateParameters, corrosion: CorrosionParameters, cache_folder: Path | None
) -> ModalPlate | None:
    """Prepare the plate of `plate.model` for modes; None for an analytic reference, which has none.

    Parameters
    ----------
    plate, corrosion
        The specimen; `corrosion.depth_fraction` has no influence.
    cache_folder
        Where reductions are kept; None keeps none.

    Raises
    ------
    SpecimenError
        The patch does not fit the plate, or the model does not know it.
    numpy.linalg.LinAlgError
        A matrix of the Mindlin plate is not positive definite.
    """
    if plate.model == "mindlin":
        return load_reduced_plate(plate, corrosion, cache_folder)
    if plate.model == "solid":
        return CachedSolid(plate, corrosion, cache_folder)
    return None


class CachedSolid:
    """Solid plate whose modes are computed once per depth, and cached on disk.

    With `plate.solid.one_basis` what is computed and kept is a basis for all depths.

    Parameters
    ----------
    plate, corrosion
        The specimen; `corrosion.depth_fraction` has no influence.
    folder
        None keeps nothing on disk. Kept or not, the modes are the same to the last bit.

    Raises
    ------
    SpecimenError
        The solid plate does not model such a plate or patch.
    """

    def __init__(self, plate: PlateParameters, corrosion: CorrosionParameters, folder: Path | None) -> None:
        """Check plate and patch; nothing is computed before the first call of `modes`."""
        check_solid_parameters(plate, replace(corrosion, depth_fraction=0.0))
        self._plate = plate
        self._corrosion = corrosion
        self._folder = folder
        self._known: OrderedDict[float, PlateModes] = OrderedDict()
        self._family: SolidFamily | None = None
        self._lock = threading.Lock()

    def modes(self, depth_fraction: float) -> PlateModes:
        """Return the modes of the solid with the patch thinned by `depth_fraction`, from memory if known.

        A call blocks while another thread computes a depth; the last 256 depths are kept. Raise SpecimenError
        if the solid model does not cover this depth.
        """
        with self._lock:  # two threads must not compute the same depth
            found = self._known.get(depth_fraction)
            if found is None:
                found = self._compute_modes(replace(self._corrosion, depth_fraction=depth_fraction))
                self._known[depth_fraction] = found
                if len(self._known) > DEPTHS_KNOWN:
                    self._known.popitem(last=False)
            return found

    def _compute_modes(self, corrosion: CorrosionParameters) -> PlateModes:
        """Compute the modes of a thinned plate: from one basis for all depths if so set, else on its own.

        Raise SpecimenError if the solid model does not cover the plate at this depth.
        """
        check_solid_parameters(self._plate, corrosion)
        lost = corrosion.depth_fraction * corrosion.depth_factor
        if not self._plate.solid.one_basis or lost < SHALLOWEST_FRACTION:
            return self._load_or_compute_modes(corrosion)
        if self._family is None:
            self._family = self._load_or_compute_family()
        with use_one_blas_thread():
            return self._family.modes(1.0 - lost)

    def _load_or_compute_modes(self, corrosion: CorrosionParameters) -> PlateModes:
        """Read the modes of a thinned plate from the disk cache, or compute and store them.

        Raise SpecimenError as `find_solid_modes`.
        """

        def compute() -> dict[str, FloatArray]:
            """Compute the modes in one BLAS thread; return their arrays by name."""
            with use_one_blas_thread():
                return asdict(find_solid_modes(self._plate, corrosion))

        described = {"modes": "solid", "plate": asdict(self._plate), "patch": asdict(corrosion)}
        found = read_or_compute_arrays(self._folder, compute_cache_key(described), compute)
        residual_m_per_n = float(found.pop("residual_compliance_m_per_n"))
        return PlateModes(**found, residual_compliance_m_per_n=residual_m_per_n)

    def _load_or_compute_family(self) -> SolidFamily:
        """Read the basis for all depths from the disk cache, or compute and store it.

        Raise SpecimenError as `build_solid_family`.
        """

        def compute() -> dict[str, FloatArray]:
            """Compute the family in one BLAS thread; return its arrays by name."""
            with use_one_blas_thread():
                return build_solid_family(self._plate, self._corrosion).arrays()

        footprint = asdict(replace(self._corrosion, depth_fraction=0.0))
        described = {"basis": "solid", "plate": asdict(self._plate), "patch": footprint}
        return restore_family(read_or_compute_arrays(self._folder, compute_cache_key(described), compute))
