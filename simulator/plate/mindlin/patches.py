"""Patches of a plate: outlines and profiles, their lines in the grid, their symmetry.

Coordinates have their origin at the contact. Patches may touch each other but not overlap. A flat patch
takes part of an element by the fraction of its area that the outline covers (only circles cut elements:
straight edges are grid lines); a smooth profile is evaluated point by point.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np

from simulator.errors import SpecimenError
from simulator.numerics.arrays import FloatArray
from simulator.parameters.plate import CorrosionParameters, PatchParameters, PlateParameters

TOUCHING = 1e-9
"""Outlines that overlap by less than this part of their size touch."""


def check_patches(plate: PlateParameters, corrosion: CorrosionParameters) -> None:
    """Check that the patches are within the plate and do not overlap; raise if not.

    Raises
    ------
    SpecimenError
        Naming the patch, its place and the limit.
    """
    for patch in corrosion.patches:
        if patch.shape != "rectangular" and patch.size_m > min(plate.width_m, plate.height_m):
            raise SpecimenError(
                f"the patch is {patch.size_m} m wide, the plate only "
                f"{min(plate.width_m, plate.height_m)} m; make corrosion.size_m smaller"
            )
        for axis, offset_m, half_m, contact_m, edge_m in zip(
            "xy",
            (patch.offset_x_m, patch.offset_y_m),
            patch.half_sizes_m,
            (plate.contact_x_m, plate.contact_y_m),
            (plate.width_m, plate.height_m),
            strict=True,
        ):
            if abs(contact_m + offset_m) + half_m > 0.5 * edge_m * (1.0 + TOUCHING):
                raise SpecimenError(
                    f"a patch reaches {abs(contact_m + offset_m) + half_m:.6g} m from the plate's centre "
                    f"along {axis}, past its edge at {0.5 * edge_m} m. Make the patch smaller or "
                    f"change its offset_{axis}_m ({offset_m} m from the contact at {contact_m} m)"
                )
    for one, other in itertools.combinations(corrosion.patches, 2):
        if _outlines_overlap(one, other):
            raise SpecimenError(
                f"the patches at ({one.offset_x_m}, {one.offset_y_m}) m and ({other.offset_x_m}, "
                f"{other.offset_y_m}) m from the contact overlap; move them apart or make them smaller"
            )


def _outlines_overlap(one: PatchParameters, other: PatchParameters) -> bool:
    """Check whether two outlines overlap by more than rounding; outlines that touch do not."""
    distances = abs(one.offset_x_m - other.offset_x_m), abs(one.offset_y_m - other.offset_y_m)
    reach = [a + b for a, b in zip(one.half_sizes_m, other.half_sizes_m, strict=True)]
    slack = TOUCHING * min(reach)
    if distances[0] >= reach[0] - slack or distances[1] >= reach[1] - slack:
        return False
    if one.shape == other.shape == "round":
        return math.hypot(*distances) < reach[0] - slack
    if "round" in (one.shape, other.shape):
        disk, box = (one, other) if one.shape == "round" else (other, one)
        gap = [max(d - half, 0.0) for d, half in zip(distances, box.half_sizes_m, strict=True)]
        return math.hypot(*gap) < 0.5 * disk.size_m - slack
    return True


def list_patch_lines(
    corrosion: CorrosionParameters, contact_element_m: float
) -> tuple[list[float], list[float]]:
    """Return the sorted coordinates x and y, in m, that need a grid line in addition to the contact's.

    They are the edges of all patches; a circle has those of its bounding square. A smooth profile also
    has lines half-way to its middle, except within the elements at the contact.
    """
    lines: tuple[set[float], set[float]] = set(), set()
    for patch in corrosion.patches:
        for along, offset_m, half_m in zip(
            lines, (patch.offset_x_m, patch.offset_y_m), patch.half_sizes_m, strict=True
        ):
            along.update((offset_m - half_m, offset_m + half_m))
            if patch.profile != "flat":
                inner = (offset_m - 0.5 * half_m, offset_m, offset_m + 0.5 * half_m)
                along.update(line for line in inner if abs(line) > contact_element_m)
    return sorted(lines[0]), sorted(lines[1])


def find_symmetric_axes(plate: PlateParameters, corrosion: CorrosionParameters) -> tuple[bool, bool]:
    """Return whether plate, contact and patches are symmetric in x, and in y (exactly)."""
    patches = set(corrosion.patches)
    in_x = plate.contact_x_m == 0.0 and {replace(p, offset_x_m=-p.offset_x_m) for p in patches} == patches
    in_y = plate.contact_y_m == 0.0 and {replace(p, offset_y_m=-p.offset_y_m) for p in patches} == patches
    return in_x, in_y


def patch_fraction(
    x_m: FloatArray, y_m: FloatArray, patch: PatchParameters | CorrosionParameters
) -> FloatArray:
    """Compute the fraction, 0 to 1, of each element's area within one patch's outline.

    Returns
    -------
    float64, shape (len(x) - 1, len(y) - 1)
    """
    x, y = x_m - patch.offset_x_m, y_m - patch.offset_y_m
    if patch.shape != "round":
        inside = [
            # Grid lines on the edges are as exact as `plate_mesh.SAME_LINE` lets them be.
            np.maximum(np.abs(lines[1:]), np.abs(lines[:-1])) <= half_m + 2.1e-9 * (lines[-1] - lines[0])
            for lines, half_m in zip((x, y), patch.half_sizes_m, strict=True)
        ]
        return np.asarray(np.outer(*inside), dtype=np.float64)
    corner = _disk_corner_area(x[:, None], y[None, :], 0.5 * patch.size_m)
    covered = corner[1:, 1:] - corner[:-1, 1:] - corner[1:, :-1] + corner[:-1, :-1]
    fraction = covered / np.outer(np.diff(x_m), np.diff(y_m))
    # Differences of nearly equal areas leave rounding where the circle does not reach.
    return np.asarray(np.clip(np.where(fraction < 1e-9, 0.0, fraction), 0.0, 1.0))


def _disk_corner_area(x_m: FloatArray, y_m: FloatArray, radius_m: float) -> FloatArray:
    """Compute the signed area in m2 of a disk within the rectangles from the origin to (x, y)."""
    x = np.minimum(np.abs(x_m), radius_m)
    y = np.minimum(np.abs(y_m), radius_m)
    flat = np.minimum(np.sqrt(radius_m**2 - y**2), x)  # up to here the rectangle's top is inside

    def below_arc(t: FloatArray) -> FloatArray:
        """Return the area below the arc between 0 and t."""
        arc = t * np.sqrt(np.maximum(radius_m**2 - t**2, 0.0)) + radius_m**2 * np.arcsin(t / radius_m)
        return np.asarray(0.5 * arc)

    area = flat * y + below_arc(x) - below_arc(flat)
    return np.asarray(np.sign(x_m) * np.sign(y_m) * area)


def evaluate_profile_depth(x_m: FloatArray, y_m: FloatArray, patch: PatchParameters) -> FloatArray:
    """Evaluate the depth of a smooth patch at points in m, relative to its middle; 0 outside."""
    half_x, half_y = patch.half_sizes_m
    u, v = (x_m - patch.offset_x_m) / half_x, (y_m - patch.offset_y_m) / half_y
    law = _bowl_profile if patch.profile == "bowl" else _cosine_profile
    return np.asarray(law(np.hypot(u, v)) if patch.shape == "round" else law(u) * law(v))


def _bowl_profile(r: FloatArray) -> FloatArray:
    """Return the depth of a bowl over the relative radius, ``1 - r^2``: 1 in the middle, 0 from r = 1 on."""
    return np.asarray(np.maximum(1.0 - r**2, 0.0))


def _cosine_profile(r: FloatArray) -> FloatArray:
    """Return the depth of a raised cosine over the relative radius: 1 in the middle, 0 from r = 1 on."""
    return np.asarray(0.5 * (1.0 + np.cos(math.pi * np.minimum(np.abs(r), 1.0))))
