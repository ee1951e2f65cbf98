"""Parameters of the twin: each with its unit, its bounds and what it means, written once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from annotated_types import Ge, Gt, Le, Lt

from hardware_drivers.bounds import check_bounds

DEEPEST_PATCH_FRACTION = 0.95
"""Beyond this the remaining membrane is no plate: the position counts as a hole."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainParameters:
    """Chain of spheres with one sensor in it (paper, section 2 and equations 1-2)."""

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid", "use_attribute_docstrings": True}

    radius_m: Annotated[float, Gt(0.0), Le(0.5)] = 9.525e-3
    """Radius of every sphere (paper: 19.05 mm spheres)."""
    mass_kg: Annotated[float, Gt(0.0), Le(1e3)] = 28.2e-3
    """Mass of every sphere (paper: 28.2 g)."""
    youngs_modulus_pa: Annotated[float, Ge(1e5), Le(2e12)] = 200e9
    """Young's modulus of spheres and sensor disks (paper: 200 GPa)."""
    poisson_ratio: Annotated[float, Ge(0.0), Lt(0.5)] = 0.3
    """Poisson's ratio of spheres and disks (paper, section 3: 0.3; section 2 says 0.28)."""
    spheres_above: Annotated[int, Ge(1), Le(1000)] = 4
    """Spheres above the sensor, the striker counted (paper: 4)."""
    spheres_below: Annotated[int, Ge(1), Le(1000)] = 4
    """Spheres between sensor and plate (paper: N = 4)."""
    sensor: Literal["sphere", "disk"] = "disk"
    """`disk`: two steel disks with flat faces, the real transducer; `sphere`: equations 1-2 to the letter."""
    sensor_mass_kg: Annotated[float, Gt(0.0), Le(1e3)] = 26.9e-3
    """Mass of a `disk` sensor (two 19.05 mm x 6.05 mm steel disks); a `sphere` sensor weighs `mass_kg`."""
    drop_height_m: Annotated[float, Gt(0.0), Le(1.0)] = 5e-3
    """Height the striker falls from (paper: 5 mm)."""
    tilt_rad: Annotated[float, Ge(0.0), Le(0.2)] = 0.0
    """Tilt of the sensor disk against the chain's axis; it adds damping at the sensor's faces."""
    damping_n_s_per_m: Annotated[float, Ge(0.0), Le(1e5)] = 4.5
    """Dashpot at every contact inside the chain (paper: 4.5 N s/m)."""
    contact_damping_n_s_per_m: Annotated[float, Ge(0.0), Le(1e5)] = 34.05
    """Dashpot at the contact between chain and plate (paper: 34.05 N s/m)."""
    gravity_m_per_s2: Annotated[float, Ge(0.0), Le(100.0)] = 9.81
    """Gravity along the chain; 0 for a chain without static preload (the drop speed keeps 9.81)."""

    def __post_init__(self) -> None:
        check_bounds(self)
        density_kg_per_m3 = self.mass_kg / (4.0 / 3.0 * math.pi * self.radius_m**3)
        if not 1.0 <= density_kg_per_m3 <= 1e5:
            raise ValueError(
                f"mass_kg is {self.mass_kg} kg and radius_m {self.radius_m} m: a density of "
                f"{density_kg_per_m3:.3g} kg/m3, outside 1..100000; check the units"
            )


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
