"""Common style of all figures: Okabe-Ito colours, print-sized type, the paper's values in black.

Object-oriented API only: no window, no global state of pyplot. PNG and SVG carry no date and a fixed
salt, so the same numbers give the same bytes.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from daq_service.shared_file import load_module_toml
from daq_service.web.report.figures import RULES as REPORT_RULES

# Okabe and Ito (2008), Color Universal Design; yellow is left out, it vanishes on paper.

BLUE, VERMILLION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
PURPLE, SKY, BLACK, GREY = "#CC79A7", "#56B4E9", "#000000", "#767676"
COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY)
OF_POSITION = {"A": ORANGE, "B": BLUE, "C": VERMILLION, "D": GREEN}

WIDTH_IN = 7.2
DPI = 150

RULES: Any = {**REPORT_RULES, **load_module_toml(__file__)}
PAPER_LINE: Mapping[str, Any] = {"color": BLACK, "linestyle": (0, (5, 3)), "linewidth": 1.0}
PAPER_MARK: Mapping[str, Any] = {
    "color": BLACK,
    "marker": "D",
    "markersize": 4.5,
    "linestyle": "none",
    "zorder": 5,
}


def create_sheet(
    rows: int = 1, columns: int = 1, *, height_in: float, **options: Any
) -> tuple[Figure, list[Axes]]:
    """Create a figure of width `WIDTH_IN` and its axes in reading order; height in inches."""
    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    return figure, list(np.ravel(axes))


def choose_colour(position: str, positions: Sequence[str]) -> str:
    """Return the color of a position as hexadecimal text; the paper's letters have fixed ones.

    Raises ValueError if the position is not in the list.
    """
    if position in OF_POSITION:
        return OF_POSITION[position]
    return COLOURS[list(positions).index(position) % len(COLOURS)]


def title_panels(axes: Sequence[Axes], titles: Sequence[str]) -> None:
    """Set the titles of the panels with the letters (a) to (j), as the paper does; at most ten."""
    for letter, axis, title in zip("abcdefghij", axes, titles, strict=False):
        axis.set_title(f"({letter}) {title}")


def create_panels(positions: Sequence[str], label: str, *, height_in: float) -> tuple[Figure, list[Axes]]:
    """Create a figure with a panel over the hours of the test for each position, on common axes.

    ``label`` is that of the y axis; the height is in inches.
    """
    figure, axes = create_sheet(1, len(positions), height_in=height_in, sharex=True, sharey=True)
    for axis in axes:
        axis.set_xlabel("hour of the test (h)")
    axes[0].set_ylabel(label)
    title_panels(axes, [f"position {name}" for name in positions])
    return figure, axes


def add_legend(figure: Figure, *, ncols: int) -> None:
    """Add a legend of all panels below the figure, each label once."""
    handles = {
        label: handle
        for axis in figure.axes
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=ncols)


METADATA: Mapping[str, dict[str, str | None]] = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": "solimon"},
}


def render_figure(figure: Figure, endings: Sequence[str] = tuple(METADATA)) -> dict[str, bytes]:
    """Render a figure and return the bytes by file ending, PNG and SVG unless others are given.

    The same figure gives the same bytes. Call this within `RULES`; the layout is fixed afterwards.
    """
    pictures = {}
    for ending in endings:
        buffer = io.BytesIO()
        figure.savefig(buffer, format=ending, dpi=DPI, metadata=METADATA[ending])
        pictures[ending] = buffer.getvalue()
        figure.set_layout_engine("none")  # laid out once, for both
    return pictures
