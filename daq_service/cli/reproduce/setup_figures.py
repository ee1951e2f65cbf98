"""Figures 5 and 6: the two finite-element models with the chain, as far as a schematic can be computed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Rectangle

from daq_service.cli.reproduce import models
from daq_service.cli.reproduce.evidence import FloatArray
from daq_service.cli.reproduce.item import Item, Job, Material, Product, Table, make_value
from daq_service.cli.reproduce.style import BLUE, GREY, VERMILLION, create_sheet, title_panels
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import PlateParameters

SECTION_DEPTH = 0.4
"""Depth at which the section of the solid plate is shown."""
FORCE_STEP_N = 190.0
"""Distance of two bodies' lines: somewhat more than the wave's peak."""
ZOOM_MM = 10.0
"""Half the window of the paper's figure 5(c)."""

_PLATE = PlateParameters()


def _mirror_grid_lines(lines_m: FloatArray) -> FloatArray:
    """Mirror grid lines in m, starting at 0, to both sides of the center; return mm, center once."""
    return 1e3 * np.concatenate((-lines_m[:0:-1], lines_m))


def _draw_grid(
    axis: Axes,
    x_mm: FloatArray,
    y_mm: FloatArray,
    window_mm: tuple[float, float],
    *,
    width: float,
    colour: str,
) -> None:
    """Draw the lines of a tensor grid within a square window, both axes in mm."""
    low, high = window_mm
    x, y = (places[(places >= 1.0001 * low) & (places <= 1.0001 * high)] for places in (x_mm, y_mm))
    lines = [[(value, low), (value, high)] for value in x]
    lines += [[(low, value), (high, value)] for value in y]
    axis.add_collection(LineCollection(lines, linewidths=width, colors=colour))
    axis.set(xlim=window_mm, ylim=window_mm, xlabel="x (mm)", ylabel="y (mm)")
    axis.set_aspect("equal")
    axis.grid(visible=False)


def _draw_patch(axis: Axes, from_mm: float, size_mm: float) -> None:
    """Draw the outline of the square corroded patch from its lower left corner, in mm."""
    corner = (from_mm, from_mm)
    axis.add_patch(Rectangle(corner, size_mm, size_mm, fill=False, ec=VERMILLION, lw=1.4, zorder=3))


def draw_plate_mesh_figure(material: Material) -> Product:
    """Draw the mesh of the plate theory, and a wave in the chain: down, reflected, up.

    Raises NotAvailableError if a job failed.
    """
    mesh: models.MeshLines = material.result("mesh")
    traces: Sequence[models.ForceTrace] = material.result("chain")
    figure, axes = create_sheet(2, 2, height_in=6.6, height_ratios=(1.0, 1.1))
    grid = axes[2].get_gridspec()
    assert grid is not None
    axes[2].remove()
    axes[3].remove()
    wave = figure.add_subplot(grid[1, :])
    x_mm, y_mm = _mirror_grid_lines(mesh.x_m), _mirror_grid_lines(mesh.y_m)
    _draw_grid(axes[0], x_mm, y_mm, (float(x_mm[0]), float(x_mm[-1])), width=0.25, colour=GREY)
    _draw_patch(axes[0], -500.0 * mesh.patch_m, 1e3 * mesh.patch_m)
    _draw_grid(axes[1], x_mm, y_mm, (-ZOOM_MM, ZOOM_MM), width=0.4, colour=GREY)
    for trace in traces:
        time_us = 1e6 * trace.time_s
        early = time_us <= 900.0
        wave.plot(time_us[early], -trace.body + trace.force_n[early] / FORCE_STEP_N, color=BLUE, lw=1.1)
        wave.axhline(-trace.body, color="#cccccc", lw=0.5, zorder=0)
    sensor = ChainParameters().spheres_above
    wave.set_yticks(
        [-trace.body for trace in traces],
        [f"body {trace.body}" + (" = sensor" if trace.body == sensor else "") for trace in traces],
    )
    wave.set(xlabel="time after the striker's touch (µs)", xlim=(0.0, 900.0))
    wave.grid(visible=False)
    wave.annotate("", xy=(880.0, -6.1), xytext=(880.0, -7.1), arrowprops={"arrowstyle": "->", "lw": 0.8})
    wave.text(874.0, -6.65, f"{FORCE_STEP_N:g} N", ha="right", va="center", fontsize=7.5)
    title_panels(
        (axes[0], axes[1], wave),
        (
            f"whole mesh; patch of {1e3 * mesh.patch_m:g} mm",
            "20 mm x 20 mm around the contact",
            "mean contact force at each body; 0 is the striker, the plate lies below body 8",
        ),
    )
    elements = (x_mm.size - 1) * (y_mm.size - 1)
    n = min(trace.time_s.size for trace in traces)
    forces = {f"force_body_{trace.body}_n": trace.force_n[:n] for trace in traces}
    return Product(
        drawing=figure,
        tables={
            "": Table(columns={"time_s": traces[0].time_s[:n], **forces}),
            "mesh": Table(columns={"x_m": mesh.x_m, "y_m": mesh.y_m}),
        },
        found={
            "elements": make_value(float(elements)),
            "contact_element": make_value(1e3 * mesh.contact_element_m),
            "spheres_below": make_value(float(ChainParameters().spheres_below)),
        },
        notes=(
            (
                "The paper's figure 5 is a schematic: chain, springs and dashpots, mesh and element. What "
                "of it can be computed is drawn: the mesh, and the wave in the chain (sensor taken as a "
                "sphere, eqs 1 and 2)."
            ),
            f"{mesh.unknowns} unknowns in the quarter model, which is exact for a centred load.",
        ),
    )


def draw_solid_mesh_figure(material: Material) -> Product:
    """Draw the mesh of the solid plate in plan and section.

    Raises NotAvailableError if a job failed.
    """
    mesh: models.MeshLines = material.result("mesh")
    speed_m_per_s: float = material.result("impact_speed")
    figure, axes = create_sheet(1, 2, height_in=3.4, width_ratios=(1.0, 1.25))
    plan, section = axes
    x_mm, z_mm = 1e3 * mesh.x_m, 1e3 * mesh.z_m
    half_mm = 20.0
    nodes_mm = 1e3 * mesh.nodes_m
    for places, width, colour in ((nodes_mm, 0.25, "#aaaaaa"), (x_mm, 0.8, GREY)):
        _draw_grid(plan, places, places, (0.0, half_mm), width=width, colour=colour)
    _draw_patch(plan, 0.0, 500.0 * mesh.patch_m)
    edge_mm, remaining_mm = 500.0 * mesh.patch_m, (1.0 - mesh.depth_fraction) * z_mm[-1]
    lines = [
        [(value, 0.0), (value, remaining_mm if value < edge_mm - 1e-6 else z_mm[-1])]
        for value in x_mm[x_mm <= half_mm]
    ]
    lines += [[(0.0 if value < remaining_mm + 1e-6 else edge_mm, value), (half_mm, value)] for value in z_mm]
    section.add_collection(LineCollection(lines, linewidths=0.6, colors=GREY))
    section.annotate(
        "chain", (0.0, 0.0), (1.0, -1.6), color=BLUE, arrowprops={"arrowstyle": "->", "color": BLUE}
    )
    section.text(
        0.5 * edge_mm, 0.5 * (remaining_mm + z_mm[-1]), "corroded", color=VERMILLION, ha="center", va="center"
    )
    section.set(xlim=(0, half_mm), ylim=(z_mm[-1] + 0.5, -2.4), xlabel="x (mm)", ylabel="z (mm)")
    section.grid(visible=False)
    title_panels(
        axes, ("a quarter in plan; thin: nodes", f"section, {100 * mesh.depth_fraction:g} % thinned")
    )
    return Product(
        drawing=figure,
        tables={"": Table(columns={"x_m": mesh.x_m, "y_m": mesh.y_m}), "z": Table(columns={"z_m": mesh.z_m})},
        found={
            "contact_element": make_value(1e3 * mesh.contact_element_m),
            "impact_speed": make_value(speed_m_per_s),
        },
        notes=(
            (
                "The paper's figure 6 is a picture of its ABAQUS model; this is the mesh of ours: elements "
                f"of higher degree that do not lock, {mesh.unknowns} unknowns. The last sphere is a point "
                "mass on Hertz's law."
            ),
            "Its pulses are in figure 13.",
        ),
    )


FIG5 = Item(
    name="fig5",
    make=draw_plate_mesh_figure,
    jobs={
        "mesh": Job(function=models.build_mindlin_mesh, arguments=(_PLATE,)),
        "chain": Job(function=models.compute_forces_along_chain, arguments=(_PLATE,)),
    },
)
FIG6 = Item(
    name="fig6",
    make=draw_solid_mesh_figure,
    jobs={
        "mesh": Job(function=models.build_solid_mesh, arguments=(_PLATE, SECTION_DEPTH)),
        "impact_speed": Job(function=models.compute_impact_speed, arguments=(ChainParameters(), _PLATE)),
    },
)
