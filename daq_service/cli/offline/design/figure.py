"""Draw the arrays of a design: d' over the peak pressure at the plate, a color for each material."""

from __future__ import annotations

import math
from collections.abc import Sequence

import matplotlib as mpl

from daq_service.cli.offline.design.candidates import MATERIALS
from daq_service.cli.offline.design.information import DEPTHS, Design
from daq_service.cli.reproduce import style


def draw_designs(designs: Sequence[Design], largest_pa: float, title: str, ending: str) -> bytes:
    """Draw usable arrays as dots, refused ones as crosses, confirmed ones as diamonds; return SVG or PNG.

    The first two designs, the configured and the best one, have labels. ``largest_pa`` is the bound of the
    pressure.
    """
    names = [name for name in MATERIALS if any(one.name.startswith(name) for one in designs)]
    colours = dict(zip(names, style.COLOURS, strict=False))
    with mpl.rc_context(style.RULES):
        figure, (axis,) = style.create_sheet(height_in=4.2)
        axis.axvline(1e-9 * largest_pa, color=style.GREY, lw=0.8, label="bound")
        for one in designs:
            if not math.isfinite(one.distances[1]):
                continue
            name = next((name for name in names if one.name.startswith(name)), "")
            colour, marker = colours.get(name, style.BLACK), "x" if one.refused else "o"
            label = f"{name or one.name}{', refused' if one.refused else ''}"
            x = 1e-9 * one.pressure_pa
            axis.plot(x, one.distances[1], marker, color=colour, ms=5, label=label)
            if one.confirmed is not None:
                axis.plot(x, one.confirmed[1], "D", mec=colour, mfc="none", ms=7, label="simulated sets")
        for one in designs[:2]:
            axis.annotate(f" {one.name}", (1e-9 * one.pressure_pa, one.distances[1]), fontsize=7)
        axis.set(xlabel="peak pressure at the plate (GPa)", ylim=(0.0, None))
        axis.set_ylabel(f"d' at a loss of {100.0 * DEPTHS[1]:g} %")
        axis.set_title(title, fontsize=8)
        style.add_legend(figure, ncols=4)
        return style.render_figure(figure, [ending])[ending]
