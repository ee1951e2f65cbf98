"""Parameters of plate and corrosion: each with its unit, its bounds and its meaning, written once."""

from __future__ import annotations

from dataclasses import field, fields
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, Lt

from hardware_drivers.bounds import bounded
from simulator.materials import youngs_modulus_at_pa

DEEPEST_PATCH_FRACTION = 0.95
"""Beyond this the remaining membrane is no plate: the position counts as a hole."""

SOFTEST_PLATE_PA = 1e5
"""Least Young's modulus of a plate, also of a warm one."""

MOST_FURTHER_PATCHES = 32


@bounded
class LiquidParameters:
    """Liquid on one face of the complete plate, between side walls over its edges."""

    density_kg_per_m3: Annotated[float, Gt(0.0), Le(2e4)] = 1023.0
    """Density (handbook value of a 3.5 % NaCl solution at 20 C; the paper's plate is in one)."""
    depth_m: Annotated[float, Gt(0.0), Le(1e4)]
    """Depth of the layer (the paper gives none); above some centimeters it does not matter."""


@bounded
class SolidMesh:
    """Mesh of the solid plate; sizes in thicknesses of the plate."""

    degree: Annotated[int, Ge(3), Le(8)] = 4
    """Degree of the polynomials along the plate; through the thickness one less, in thin layers two less."""
    edge_element: Annotated[float, Ge(1e-3), Le(10.0)] = 0.05
    """Size of the elements at the patch's edge, in thicknesses of the plate."""
    contact_element: Annotated[float, Ge(1e-3), Le(10.0)] = 0.5
    """Size of the elements at the contact, in thicknesses: what they do not resolve is corrected."""
    largest_element: Annotated[float, Ge(1e-2), Le(1e3)] = 10.0
    """Largest elements, in thicknesses: they must carry the waves in the plate."""
    growth: Annotated[float, Gt(0.0), Le(5.0)] = 2.0
    """By how much an element grows per distance from the patch's edge or the contact."""

    one_basis: bool = False
    """Whether all depths share one basis: some 6 s once, then 4 ms for a depth; else 1 to 2 s for each."""


@bounded
class PlateParameters:
    """Plate below the chain (paper, section 3)."""

    model: Literal["mindlin", "solid", "infinite_kirchhoff", "rigid_wall"] = "mindlin"
    """`mindlin`: finite Reissner-Mindlin plate; `solid`: three-dimensional; the other two are analytic
    anchors without a patch."""
    width_m: Annotated[float, Gt(0.0), Le(100.0)] = 0.6096
    """Edge along x (paper: 609.6 mm)."""
    height_m: Annotated[float, Gt(0.0), Le(100.0)] = 0.6096
    """Edge along y (paper: 609.6 mm)."""
    thickness_m: Annotated[float, Gt(0.0), Le(1.0)] = 6.35e-3
    """Pristine thickness (paper: 6.35 mm)."""
    youngs_modulus_pa: Annotated[float, Ge(SOFTEST_PLATE_PA), Le(2e12)] = 200e9
    """Young's modulus of the plate at 20 C (paper: 200 GPa)."""
    poisson_ratio: Annotated[float, Ge(0.0), Lt(0.5)] = 0.3
    """Poisson's ratio of the plate (paper: 0.3)."""
    yield_strength_pa: Annotated[float, Gt(0.0), Le(1e11)] = 2.5e8
    """Yield strength of the plate (ASTM A36 steel), a limit of the contact's pressure only."""
    density_kg_per_m3: Annotated[float, Ge(10.0), Le(3e4)] = 7800.0
    """Density of the plate (paper: 7,800 kg/m3)."""
    temperature_c: Annotated[float, Ge(-200.0), Le(1000.0)] = 20.0
    """Temperature of the plate; its modulus is given at 20 C."""
    youngs_modulus_change_per_k: Annotated[float, Ge(-1e-2), Le(1e-2)] = -2.7e-4
    """Relative change of Young's modulus a kelvin (ASME BPVC II-D, table TM-1, carbon steel: 202 GPa at
    25 C, 198 at 100 C, 192 at 200 C)."""
    support: Literal["simply_supported", "clamped", "free"] = "simply_supported"
    """Edges: hard simple support (deflection and tangential rotation zero), clamped, or free."""
    suspension_hz: Annotated[float, Gt(0.0), Le(1e4)] = 10.0
    """Free edges: the plate lies on a soft elastic bed, on which it bobs as a whole at this frequency."""
    liquid: LiquidParameters | None = None
    """Liquid on one face; absent: dry, as the paper's model."""
    contact_x_m: Annotated[float, Ge(-50.0), Le(50.0)] = 0.0
    """Position of the chain, from the plate's center along x."""
    contact_y_m: Annotated[float, Ge(-50.0), Le(50.0)] = 0.0
    """Position of the chain, from the plate's center along y."""
    contact: Literal["node", "patch"] = "node"
    """Load of `mindlin`: a point force on one node (paper), or Hertz's pressure over a circle."""
    contact_radius_m: Annotated[float, Gt(0.0), Le(1.0)] = 2e-4
    """Radius of the circle of `patch` and `solid` (that of Hertz's contact at the paper's largest force)."""
    elements_per_edge: Annotated[int, Ge(8), Le(400)] = 96
    """Elements along each edge, an even number (paper: 96, that is 9,216 elements)."""
    contact_element_m: Annotated[float, Gt(0.0), Le(0.1)] = 1e-4
    """Size of the elements at the contact: part of the model's definition, see docs (paper: 0.1 mm)."""
    solid: SolidMesh = field(default_factory=SolidMesh)
    """Mesh of `solid`, which takes Hertz's pressure over `contact_radius_m`."""

    def __post_init__(self) -> None:
        """Raise ValueError for a grid, modulus, contact or liquid that the model cannot have.

        That is an odd number of elements, too large elements at the contact, a Young's modulus below 1e5 Pa
        at the plate's temperature, a contact over the edge, or a liquid on a model other than ``mindlin``.
        """
        if self.elements_per_edge % 2:
            raise ValueError(f"elements_per_edge is {self.elements_per_edge}; it must be even")
        largest = min(self.width_m, self.height_m) / self.elements_per_edge
        if self.contact_element_m > largest:
            raise ValueError(
                f"contact_element_m is {self.contact_element_m} m; with {self.elements_per_edge} elements on "
                f"the shorter edge it must be at most {largest:.4g} m"
            )
        if self.warm_youngs_modulus_pa < SOFTEST_PLATE_PA:
            raise ValueError(
                f"youngs_modulus_pa would be {self.warm_youngs_modulus_pa:.3g} Pa at temperature_c = "
                f"{self.temperature_c}; at least {SOFTEST_PLATE_PA:g} Pa is needed: check "
                f"youngs_modulus_change_per_k"
            )
        self._check_contact()
        if self.liquid is not None and self.model != "mindlin":
            raise ValueError(
                f"liquid is given for a plate of model {self.model}, which stays dry; leave it out or use "
                f"model = 'mindlin'"
            )

    @property
    def warm_youngs_modulus_pa(self) -> float:
        """Return Young's modulus at the plate's temperature, in Pa."""
        return youngs_modulus_at_pa(
            self.youngs_modulus_pa, self.youngs_modulus_change_per_k, self.temperature_c
        )

    def _check_contact(self) -> None:
        """Raise ValueError if the contact does not fit on the plate or the grid does not resolve it."""
        reach_m = self.contact_radius_m if self.contact == "patch" else self.contact_element_m
        for name, at_m, edge_m in (
            ("contact_x_m", self.contact_x_m, self.width_m),
            ("contact_y_m", self.contact_y_m, self.height_m),
        ):
            if abs(at_m) + max(reach_m, self.contact_element_m) > 0.5 * edge_m:
                raise ValueError(
                    f"{name} is {at_m} m; on an edge of {edge_m} m the contact, {reach_m} m to either side, "
                    f"must be at most {0.5 * edge_m} m from the centre"
                )
        if self.contact == "patch" and self.contact_element_m > self.contact_radius_m:
            raise ValueError(
                f"contact_element_m is {self.contact_element_m} m; to resolve the circle of contact it must "
                f"be at most contact_radius_m, {self.contact_radius_m} m"
            )


PatchShape = Literal["square", "round", "rectangular"]
PatchSize = Annotated[float, Gt(0.0), Le(100.0)]
PatchOffset = Annotated[float, Ge(-100.0), Le(100.0)]
PatchProfile = Literal["flat", "bowl", "cosine"]
DepthFactor = Annotated[float, Gt(0.0), Le(1.0)]


@bounded
class PatchParameters:
    """Outline and profile of one thinned patch."""

    shape: PatchShape = "square"
    """Outline of the patch."""
    size_m: PatchSize = 25.4e-3
    """Edge of a square patch, diameter of a round one, edge along x of a rectangle."""
    size_y_m: PatchSize | None = None
    """Edge of a rectangle along y; other outlines have none."""
    offset_x_m: PatchOffset = 0.0
    """Centre of the patch from the contact, along x."""
    offset_y_m: PatchOffset = 0.0
    """Centre of the patch from the contact, along y."""
    profile: PatchProfile = "flat"
    """Depth over the patch, as in `corrosion.profile`."""
    depth_factor: DepthFactor = 1.0
    """Largest depth of this patch over the depth of the position."""

    def __post_init__(self) -> None:
        """Raise ValueError unless a rectangular patch, and no other, has ``size_y_m``."""
        if (self.shape == "rectangular") != (self.size_y_m is not None):
            raise ValueError(
                f"size_y_m is {self.size_y_m} for a {self.shape} patch; a rectangular one needs it, no other "
                f"has it"
            )

    @property
    def half_sizes_m(self) -> tuple[float, float]:
        """Return half the patch's extent along x and y, in m; the radius twice for a round one."""
        return 0.5 * self.size_m, 0.5 * (self.size_m if self.size_y_m is None else self.size_y_m)


@bounded
class CorrosionParameters:
    """Thinned patch at the contact and further ones; the mid-surface stays as it is (paper, section 3)."""

    shape: PatchShape = "square"
    """Outline of the patch."""
    size_m: PatchSize = 25.4e-3
    """Edge of a square patch, diameter of a round one (paper: 25.4 mm at B, 50.8 mm at C), edge along x of a
    rectangle."""
    size_y_m: PatchSize | None = None
    """Edge of a rectangle along y; other outlines have none."""
    offset_x_m: PatchOffset = 0.0
    """Centre of the patch from the contact, along x."""
    offset_y_m: PatchOffset = 0.0
    """Centre of the patch from the contact, along y."""
    profile: PatchProfile = "flat"
    """Depth over the patch: `flat` (paper), `bowl` 1 - (r / R)^2 or `cosine` (1 + cos(pi r / R)) / 2. Over a
    square or a rectangle it is the product of these along x and y."""
    depth_factor: DepthFactor = 1.0
    """Largest depth of this patch over `depth_fraction`; below 1 where a further patch is deeper."""
    further: tuple[PatchParameters, ...] = ()
    """More patches, as `[[corrosion.further]]`, all thinning with the one `depth_fraction`; none may
    overlap."""
    depth_fraction: Annotated[float, Ge(0.0), Le(DEEPEST_PATCH_FRACTION)] = 0.0
    """Lost part of the thickness: 0 pristine, at most 0.95; beyond that the position is a hole."""

    def __post_init__(self) -> None:
        """Raise ValueError for more than 32 further patches, or a first patch with a wrong ``size_y_m``."""
        if len(self.further) > MOST_FURTHER_PATCHES:
            raise ValueError(
                f"further has {len(self.further)} patches; at most {MOST_FURTHER_PATCHES} are possible"
            )
        _ = self.patches  # the first one must make sense, too

    @property
    def patches(self) -> tuple[PatchParameters, ...]:
        """Return all patches: the one of these parameters, then the further ones."""
        first = {part.name: getattr(self, part.name) for part in fields(PatchParameters)}
        return PatchParameters(**first), *self.further

    @property
    def half_sizes_m(self) -> tuple[float, float]:
        """Return half the first patch's extent along x and y, in m."""
        return self.patches[0].half_sizes_m
