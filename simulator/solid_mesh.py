"""Mesh of the solid plate: each parameter with its bounds and what it means, written once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from annotated_types import Ge, Gt, Le

from hardware_drivers.bounds import check_bounds


@dataclass(frozen=True, slots=True, kw_only=True)
class SolidMesh:
    """Mesh of the solid plate; sizes in thicknesses of the plate."""

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid", "use_attribute_docstrings": True}

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
    """Whether all depths share one basis: some 17 s once, then 9 ms for a depth; else 1 to 2 s for each."""

    def __post_init__(self) -> None:
        check_bounds(self)
