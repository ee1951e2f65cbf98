"""Parameters of the chain: each with its unit, its bounds and its meaning, written once."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, Lt

from hardware_drivers.bounds import bounded
from simulator.materials import youngs_modulus_at_pa

SOFTEST_PA = 1e5
"""Least Young's modulus of a body."""

DampingLaw = Literal["linear", "tsuji", "kuwabara_kono", "hunt_crossley"]


@bounded
class SphereParameters:
    """Bodies of a chain that differ from its other spheres; keys not given are the chain's."""

    body: Annotated[int, Ge(0), Le(2000)]
    """Which body, counted from the striker, 0; the sensor counts as one."""
    last_body: Annotated[int, Ge(0), Le(2000)] | None = None
    """The description holds from `body` to this one; absent: for `body` alone."""
    radius_m: Annotated[float, Gt(0.0), Le(0.5)] | None = None
    """Radius."""
    mass_kg: Annotated[float, Gt(0.0), Le(1e3)] | None = None
    """Mass; absent: that of the radius and density."""
    density_kg_per_m3: Annotated[float, Ge(1.0), Le(1e5)] | None = None
    """Density, instead of `mass_kg`; with neither the density is that of the chain's other spheres."""
    youngs_modulus_pa: Annotated[float, Ge(SOFTEST_PA), Le(2e12)] | None = None
    """Young's modulus."""
    poisson_ratio: Annotated[float, Ge(0.0), Lt(0.5)] | None = None
    """Poisson's ratio."""
    yield_strength_pa: Annotated[float, Gt(0.0), Le(1e11)] | None = None
    """Yield strength."""

    def __post_init__(self) -> None:
        """Raise ValueError for an empty range of bodies, or for both a mass and a density."""
        if self.last_body is not None and self.last_body < self.body:
            raise ValueError(f"last_body is {self.last_body}; it must be at least body = {self.body}")
        if self.mass_kg is not None and self.density_kg_per_m3 is not None:
            raise ValueError(
                f"body {self.body} has mass_kg {self.mass_kg} and density_kg_per_m3 "
                f"{self.density_kg_per_m3}; give one of them"
            )

    @property
    def bodies(self) -> range:
        """Return the indices of the described bodies, counted from the striker (0)."""
        return range(self.body, 1 + (self.body if self.last_body is None else self.last_body))


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """Resolved body: the sensor disk's radius of curvature is infinite."""

    radius_m: float
    mass_kg: float
    youngs_modulus_pa: float
    poisson_ratio: float
    yield_strength_pa: float


@bounded
class ChainParameters:
    """Chain of spheres with one sensor in it (paper, section 2 and equations 1-2)."""

    radius_m: Annotated[float, Gt(0.0), Le(0.5)] = 9.525e-3
    """Radius of every sphere (paper: 19.05 mm spheres)."""
    mass_kg: Annotated[float, Gt(0.0), Le(1e3)] = 28.2e-3
    """Mass of every sphere (paper: 28.2 g)."""
    youngs_modulus_pa: Annotated[float, Ge(SOFTEST_PA), Le(2e12)] = 200e9
    """Young's modulus of spheres and sensor disks at 20 C (paper: 200 GPa)."""
    poisson_ratio: Annotated[float, Ge(0.0), Lt(0.5)] = 0.3
    """Poisson's ratio of spheres and disks (paper, section 3: 0.3; section 2 says 0.28)."""
    yield_strength_pa: Annotated[float, Gt(0.0), Le(1e11)] = 1.9e9
    """Yield strength of spheres and disks (hardened AISI 440C steel), a limit of pressures only."""
    spheres_above: Annotated[int, Ge(1), Le(1000)] = 4
    """Spheres above the sensor, the striker counted (paper: 4)."""
    spheres_below: Annotated[int, Ge(0), Le(1000)] = 4
    """Spheres between sensor and plate (paper: N = 4); 0 puts a `sphere` sensor on the plate."""
    spheres: tuple[SphereParameters, ...] = ()
    """Bodies that differ from the others, as `[[chain.spheres]]`; the paper has none."""
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
    damping_law: DampingLaw = "linear"
    """How the dashpots grow with the overlap d, gamma (d / reference)^p: `linear` p = 0 (equation 1),
    `tsuji` 1/4, `kuwabara_kono` 1/2, `hunt_crossley` 3/2."""
    damping_reference_overlap_m: Annotated[float, Ge(1e-9), Le(1e-2)] = 1e-5
    """Overlap at which the dashpots have the values above, so that these keep their unit under every law."""
    gravity_m_per_s2: Annotated[float, Ge(0.0), Le(100.0)] = 9.81
    """Gravity along the chain; 0 for a chain without static preload (the drop speed keeps 9.81)."""
    precompression_n: Annotated[float, Ge(0.0), Le(1e6)] = 0.0
    """Constant force on the body below the striker, as of a soft spring; every contact below carries it."""
    temperature_c: Annotated[float, Ge(-200.0), Le(1000.0)] = 20.0
    """Temperature of the chain; moduli are given at 20 C."""
    youngs_modulus_change_per_k: Annotated[float, Ge(-1e-2), Le(1e-2)] = -2.7e-4
    """Relative change of Young's modulus a kelvin (ASME BPVC II-D, table TM-1, carbon steel: 202 GPa at
    25 C, 198 at 100 C, 192 at 200 C)."""

    def __post_init__(self) -> None:
        """Raise ValueError for a density, sphere or modulus out of bounds, or a disk sensor on the plate."""
        _check_density("mass_kg", self.mass_kg, self.radius_m)
        if self.spheres_below == 0 and self.sensor == "disk":
            raise ValueError(
                "spheres_below is 0 under a disk sensor: a flat disk on a flat plate has no contact of "
                "Hertz; put at least one sphere below it, or take sensor = 'sphere'"
            )
        if self.spheres:
            self._check_spheres()
        if self.temperature_c != 20.0:
            self._check_moduli()

    @property
    def bodies(self) -> int:
        """Return the number of bodies of the chain; the striker and the sensor count."""
        return self.spheres_above + 1 + self.spheres_below

    def body(self, index: int) -> Body:
        """Return the body with an index, 0 the striker, with Young's modulus at the chain's temperature."""
        radius, mass = self.radius_m, self.mass_kg
        modulus, poisson, strength_pa = self.youngs_modulus_pa, self.poisson_ratio, self.yield_strength_pa
        is_disk = self.sensor == "disk" and index == self.spheres_above
        for other in self.spheres:
            if index in other.bodies:
                radius = radius if other.radius_m is None else other.radius_m
                mass = self._mass_kg(other)
                modulus = modulus if other.youngs_modulus_pa is None else other.youngs_modulus_pa
                poisson = poisson if other.poisson_ratio is None else other.poisson_ratio
                strength_pa = strength_pa if other.yield_strength_pa is None else other.yield_strength_pa
        return Body(
            radius_m=math.inf if is_disk else radius,
            mass_kg=self.sensor_mass_kg if is_disk else mass,
            youngs_modulus_pa=youngs_modulus_at_pa(
                modulus, self.youngs_modulus_change_per_k, self.temperature_c
            ),
            poisson_ratio=poisson,
            yield_strength_pa=strength_pa,
        )

    def with_worn_contacts(self, radius_factor: float) -> ChainParameters:
        """Return the chain with all radii of curvature multiplied by a factor and the same masses."""
        spheres = tuple(
            other
            if other.radius_m is None and other.density_kg_per_m3 is None
            else replace(
                other,
                radius_m=None if other.radius_m is None else other.radius_m * radius_factor,
                mass_kg=self._mass_kg(other),
                density_kg_per_m3=None,
            )
            for other in self.spheres
        )
        return replace(self, radius_m=self.radius_m * radius_factor, spheres=spheres)

    def _mass_kg(self, other: SphereParameters) -> float:
        """Return the mass of a differing sphere in kg: as given, by density, or by its radius cubed."""
        if other.mass_kg is not None:
            return other.mass_kg
        radius = self.radius_m if other.radius_m is None else other.radius_m
        if other.density_kg_per_m3 is not None:
            return other.density_kg_per_m3 * _volume_m3(radius)
        return self.mass_kg if other.radius_m is None else self.mass_kg * (radius / self.radius_m) ** 3

    def _check_spheres(self) -> None:
        """Raise ValueError for a described body that does not exist, is described twice or is implausible.

        Implausible are a density outside 1 to 100,000 kg/m3, and a radius, mass or density of a sensor disk.
        """
        described: set[int] = set()
        for other in self.spheres:
            if other.bodies[-1] >= self.bodies:
                raise ValueError(
                    f"chain.spheres describes body {other.bodies[-1]}; the chain has bodies 0 to "
                    f"{self.bodies - 1}: striker, {self.spheres_above - 1} spheres, sensor, "
                    f"{self.spheres_below} spheres"
                )
            if twice := described.intersection(other.bodies):
                raise ValueError(f"chain.spheres describes body {min(twice)} twice; keep one description")
            described.update(other.bodies)
            shaped = (other.radius_m, other.mass_kg, other.density_kg_per_m3) != (None, None, None)
            if shaped and self.sensor == "disk" and self.spheres_above in other.bodies:
                raise ValueError(
                    f"chain.spheres gives radius, mass or density to body {self.spheres_above}, the sensor "
                    f"disk; set sensor_mass_kg, or leave this body out"
                )
            radius = self.radius_m if other.radius_m is None else other.radius_m
            _check_density(f"mass_kg of body {other.body}", self._mass_kg(other), radius)

    def _check_moduli(self) -> None:
        """Raise ValueError if a Young's modulus is below 1e5 Pa at the chain's temperature."""
        given = [self.youngs_modulus_pa]
        given += [other.youngs_modulus_pa for other in self.spheres if other.youngs_modulus_pa is not None]
        softest = youngs_modulus_at_pa(min(given), self.youngs_modulus_change_per_k, self.temperature_c)
        if softest < SOFTEST_PA:
            raise ValueError(
                f"youngs_modulus_pa would be {softest:.3g} Pa at temperature_c = {self.temperature_c}; at "
                f"least {SOFTEST_PA:g} Pa is needed: check youngs_modulus_change_per_k"
            )


def _volume_m3(radius_m: float) -> float:
    """Return the volume of a sphere in m3."""
    return 4.0 / 3.0 * math.pi * radius_m**3


def _check_density(name: str, mass_kg: float, radius_m: float) -> None:
    """Raise ValueError if mass and radius give a density outside 1 to 100,000 kg/m3."""
    density_kg_per_m3 = mass_kg / _volume_m3(radius_m)
    if not 1.0 <= density_kg_per_m3 <= 1e5:
        raise ValueError(
            f"{name} is {mass_kg} kg and radius_m {radius_m} m: a density of "
            f"{density_kg_per_m3:.3g} kg/m3, outside 1..100000; check the units"
        )
