"""Parameters of plate and corrosion: each with its unit, its bounds and what it means, written once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from annotated_types import Ge, Gt, Le, Lt

from hardware_drivers.bounds import check_bounds

DEEPEST_PATCH_FRACTION = 0.95
"""Beyond this the remaining membrane is no plate: the position counts as a hole."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlateParameters:
    """Plate below the chain (paper, section 3)."""

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid", "use_attribute_docstrings": True}

    model: Literal["mindlin", "infinite_kirchhoff", "rigid_wall"] = "mindlin"
    """`mindlin`: finite Reissner-Mindlin plate; the other two are analytic anchors without a patch."""
    width_m: Annotated[float, Gt(0.0), Le(100.0)] = 0.6096
    """Edge along x (paper: 609.6 mm)."""
    height_m: Annotated[float, Gt(0.0), Le(100.0)] = 0.6096
    """Edge along y (paper: 609.6 mm)."""
    thickness_m: Annotated[float, Gt(0.0), Le(1.0)] = 6.35e-3
    """Pristine thickness (paper: 6.35 mm)."""
    youngs_modulus_pa: Annotated[float, Ge(1e5), Le(2e12)] = 200e9
    """Young's modulus of the plate (paper: 200 GPa)."""
    poisson_ratio: Annotated[float, Ge(0.0), Lt(0.5)] = 0.3
    """Poisson's ratio of the plate (paper: 0.3)."""
    density_kg_per_m3: Annotated[float, Ge(10.0), Le(3e4)] = 7800.0
    """Density of the plate (paper: 7,800 kg/m3)."""
    support: Literal["simply_supported", "clamped"] = "simply_supported"
    """Edges: hard simple support (deflection and tangential rotation zero) or clamped."""
    elements_per_edge: Annotated[int, Ge(8), Le(400)] = 96
    """Elements along each edge, an even number (paper: 96, that is 9,216 elements)."""
    contact_element_m: Annotated[float, Gt(0.0), Le(0.1)] = 1e-4
    """Size of the elements at the contact: part of the model's definition, see docs (paper: 0.1 mm)."""

    def __post_init__(self) -> None:
        check_bounds(self)
        if self.elements_per_edge % 2:
            raise ValueError(f"elements_per_edge is {self.elements_per_edge}; it must be even")
        largest = min(self.width_m, self.height_m) / self.elements_per_edge
        if self.contact_element_m > largest:
            raise ValueError(
                f"contact_element_m is {self.contact_element_m} m; with {self.elements_per_edge} elements on "
                f"the shorter edge it must be at most {largest:.4g} m"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrosionParameters:
    """A centred thinned patch; the mid-surface stays where it is (paper, section 3)."""

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid", "use_attribute_docstrings": True}

    shape: Literal["square", "round"] = "square"
    """Outline of the patch."""
    size_m: Annotated[float, Gt(0.0), Le(100.0)] = 25.4e-3
    """Edge of a square patch, diameter of a round one (paper: 25.4 mm at B, 50.8 mm at C)."""
    depth_fraction: Annotated[float, Ge(0.0), Le(DEEPEST_PATCH_FRACTION)] = 0.0
    """Lost part of the thickness: 0 pristine, at most 0.95; beyond that the position is a hole."""

    def __post_init__(self) -> None:
        check_bounds(self)
