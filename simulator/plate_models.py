"""Which model of the plate a specimen asks for, as the chain feels it: modes at any depth of the patch."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from simulator.plate_parameters import CorrosionParameters, PlateParameters
from simulator.plate_reduction import PlateModes
from simulator.reduction_cache import reduced_plate


class ModalPlate(Protocol):
    """A finite plate under the chain."""

    def modes(self, depth_fraction: float) -> PlateModes:
        """All modes the model knows with the patch thinned by `depth_fraction`."""
        ...


def modal_plate(
    plate: PlateParameters, corrosion: CorrosionParameters, cache_folder: Path | None
) -> ModalPlate | None:
    """Make the plate of `plate.model` ready; None for an analytic anchor, which has no modes.

    Parameters
    ----------
    plate, corrosion
        The specimen; `corrosion.depth_fraction` has no influence.
    cache_folder
        Where reductions are kept; None keeps none.

    Raises
    ------
    SpecimenError
        The patch does not fit the plate.
    """
    if plate.model == "mindlin":
        return reduced_plate(plate, corrosion, cache_folder)
    return None
