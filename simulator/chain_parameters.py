"""Parameters of the chain: each with its unit, its bounds and what it means, written once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from annotated_types import Ge, Gt, Le, Lt

from hardware_drivers.bounds import check_bounds


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
