"""Solid plate at every depth from one basis.

The grid lines lie at the same fractions of both layers whatever the depth, so that displacements of all
nodes mean the same motions everywhere, and the projected layers are known at any thickness
(`solid_reduction.ProjectedSolid`). Krylov spaces at some depths are merged; what lies between is a
combination of them, as the plate changes smoothly with depth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.polynomial import chebyshev
from scipy import linalg

from simulator.numerics.arrays import FloatArray
from simulator.parameters.plate import DEEPEST_PATCH_FRACTION, CorrosionParameters, PlateParameters
from simulator.plate.reduced import PlateModes
from simulator.plate.solid.plate import build_solid_plate
from simulator.plate.solid.reduction import (
    ProjectedSolid,
    contact_residual_m_per_n,
    krylov_fields,
    make_modes_passive,
    project_layers,
)

FAMILY = (
    (0.004, 40),
    (0.05, 25),
    (0.15, 25),
    (0.3, 25),
    (0.45, 25),
    (0.6, 25),
    (0.72, 25),
    (0.82, 25),
    (0.9, 25),
    (0.95, 40),
)
"""Lost parts of the thickness whose Krylov vectors enter the basis, and how many of each."""

MERGE_TOLERANCE = 1e-6
"""Directions weaker than this part of the strongest are left out of the merged basis."""

RESIDUAL_NODES = 13
"""Chebyshev nodes over the logarithm of the remaining thickness, for the compliance under the contact."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolidFamily:
    """Solid plate projected for every depth.

    Attributes
    ----------
    projected
        Both layers in the merged basis.
    residual
        float64: Chebyshev coefficients of the compliance to add to the modes, over `_position_of_depth`.
    """

    projected: ProjectedSolid
    residual: FloatArray

    def modes(self, remaining: float) -> PlateModes:
        """Compute modes with the fraction `remaining` of the thickness left within the patch.

        They are ready for a shot: no negative residual compliance. Raise SpecimenError as
        `make_modes_passive`.
        """
        added = float(chebyshev.chebval(_position_of_depth(remaining), self.residual))
        return make_modes_passive(self.projected.modes(remaining, added))

    def arrays(self) -> dict[str, FloatArray]:
        """Return the arrays by name from which `restore_family` restores this family."""
        return asdict(self.projected) | {"residual": self.residual}


def restore_family(arrays: Mapping[str, FloatArray]) -> SolidFamily:
    """Restore a family from the result of `SolidFamily.arrays`; TypeError or KeyError if one is missing."""
    projected = {name: values for name, values in arrays.items() if name != "residual"}
    return SolidFamily(projected=ProjectedSolid(**projected), residual=arrays["residual"])


def _position_of_depth(remaining: float) -> float:
    """Map a remaining fraction of the thickness to -1..1 by its logarithm.

    The ends are the deepest patch and the full thickness.
    """
    return 1.0 - 2.0 * math.log(remaining) / math.log(1.0 - DEEPEST_PATCH_FRACTION)


def build_solid_family(
    plate: PlateParameters,
    corrosion: CorrosionParameters,
    depths: tuple[tuple[float, int], ...] = FAMILY,
) -> SolidFamily:
    """Merge the Krylov spaces at `depths` and project the solid plate onto them.

    Raise SpecimenError if the solid plate does not model such a plate or patch.

    Parameters
    ----------
    plate, corrosion
        The specimen; `corrosion.depth_fraction` has no influence.
    depths
        Lost parts of the thickness, and how many vectors of each.
    """
    spaces = []
    for lost, vectors in depths:
        built = build_solid_plate(plate, _thin_patch(corrosion, lost))
        spaces.append(krylov_fields(built, vectors))
    built = build_solid_plate(plate, _thin_patch(corrosion, 0.5))
    fields = np.hstack(spaces)
    strength, directions = linalg.eigh(fields.T @ fields, check_finite=False)
    is_strong = strength > MERGE_TOLERANCE**2 * strength[-1]
    basis = fields @ (directions[:, is_strong] / np.sqrt(strength[is_strong]))
    places = chebyshev.chebpts1(RESIDUAL_NODES)
    deepest = math.log(1.0 - DEEPEST_PATCH_FRACTION)
    residuals = []
    for place in places:
        patch = _thin_patch(corrosion, 1.0 - math.exp(0.5 * (1.0 - place) * deepest))
        residuals.append(contact_residual_m_per_n(build_solid_plate(plate, patch), patch))
    coefficients = chebyshev.chebfit(places, np.array(residuals), RESIDUAL_NODES - 1)
    return SolidFamily(projected=project_layers(built, basis), residual=np.asarray(coefficients))


def _thin_patch(corrosion: CorrosionParameters, lost: float) -> CorrosionParameters:
    """Return the patch with this fraction of the thickness lost and a depth factor of 1."""
    return replace(corrosion, depth_fraction=lost, depth_factor=1.0)
