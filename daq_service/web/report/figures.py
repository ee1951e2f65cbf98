"""Figures of a report as SVG: each set a point, outliers and bad sets by shape, gaps shaded.

Object-oriented API only, text stays text, and the same numbers give the same bytes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from daq_service.shared_file import load_module_toml
from daq_service.web.report.contents import Columns, Contents, PositionReport
from hardware_drivers.methods import PULSE_ECHO

# Okabe and Ito (2008), Color Universal Design.
BLUE, VERMILLION, PURPLE, GREEN, GREY = "#0072B2", "#D55E00", "#9c4a7c", "#009E73", "#555555"
WIDTH_IN, PANEL_IN = 7.2, 1.75
MARGIN = 0.01
"""Fraction of the hours at both ends, so that the first and last points are fully visible."""
POOR = "suspect or bad"
ABOVE: Any = {"loc": "lower left", "bbox_to_anchor": (0.0, 0.98), "ncols": 4}
"""Position of a legend above the axes."""
RULES: Any = load_module_toml(__file__)
_NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}


def draw_position_figure(contents: Contents, position: PositionReport) -> str:
    """Draw the trend of a position over the hours of the test as SVG element; empty without values.

    A transducer has three panels, a probe one; equal contents give equal bytes.
    """
    if not position.values["due_h"]:
        return ""
    with mpl.rc_context(RULES):
        panels = _draw_echo_panels if position.method == PULSE_ECHO else _draw_wave_panels
        number = 1 if position.method == PULSE_ECHO else 3
        figure = Figure(figsize=(WIDTH_IN, 0.35 + PANEL_IN * number), layout="constrained")
        axes = [axis for (axis,) in figure.subplots(number, 1, squeeze=False, sharex=True)]
        panels(contents, position, axes)
        for axis in axes:
            _mark_gaps_and_alarms(contents, position, axis)
        to_h = min(contents.to_h, contents.now_h)
        margin_h = MARGIN * (to_h - contents.from_h)
        axes[0].set_xlim(contents.from_h - margin_h, to_h + margin_h)
        axes[-1].set_xlabel("time since start (h)")
        return render_svg(figure, f"figure-{position.name}")


def render_svg(figure: Figure, prefix: str) -> str:
    """Render a figure as SVG element of a page; ``prefix`` makes its ids unique."""
    content = io.StringIO()
    figure.savefig(content, format="svg", metadata=_NO_METADATA)
    return _extract_svg_element(content.getvalue(), prefix)


def _draw_wave_panels(contents: Contents, position: PositionReport, axes: Sequence[Axes]) -> None:
    """Draw time of flight (µs), amplitude ratio and squared distance of a transducer into three panels.

    The distance has a logarithmic axis if any value is positive.
    """
    assert position.assessments is not None, "these have them"
    for axis, name, factor, label in (
        (axes[0], "tof_pp_s", 1e6, "time of flight (µs)"),
        (axes[1], "amplitude_ratio", 1.0, "amplitude ratio"),
    ):
        _draw_points(axis, position.values, name, factor, label)
    distance = axes[2]
    assessments = position.assessments
    dots = {"linestyle": "none", "marker": "o", "color": BLUE, "label": "D²"}
    diamonds = {"marker": "D", "markersize": 5, "markerfacecolor": "none", "color": VERMILLION}
    outliers = dots | diamonds | {"label": "outlier"}
    _draw_line(distance, assessments, "distance_squared", dots)
    _draw_line(
        distance, assessments, "distance_squared", outliers, rows=assessments["outlier"], gid="outliers"
    )
    _draw_line(distance, assessments, "limit_f_predictive", {"color": VERMILLION, "label": "F limit"})
    dashed = {"color": PURPLE, "linestyle": "--", "label": "paper's limit"}
    _draw_line(distance, assessments, "limit_mean_3sd", dashed)
    if any(value is not None and value > 0.0 for value in assessments["distance_squared"]):
        distance.set_yscale("log")
        distance.yaxis.set_major_formatter(LogFormatter())
        distance.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=(2, 0.4)))
    distance.set_ylabel("squared distance")
    distance.legend(**ABOVE)


def _draw_echo_panels(contents: Contents, position: PositionReport, axes: Sequence[Axes]) -> None:
    """Draw the wall thickness (mm) of a probe with its alarm limit and the interval of the newest value."""
    _draw_points(axes[0], position.values, "thickness_m", 1e3, "wall (mm)")
    if position.limit is not None:
        axes[0].axhline(1e3 * position.limit, color=VERMILLION, label="alarm below")
    last = position.last.last_thickness
    if last is not None and last.interval_low_m is not None and last.interval_high_m is not None:
        ends = [1e3 * last.interval_low_m, 1e3 * last.interval_high_m]
        hours, label = [last.due_h] * 2, "95 % interval of the newest"
        axes[0].plot(hours, ends, color=GREY, marker="_", label=label)
    axes[0].legend(**ABOVE)


def _draw_points(axis: Axes, columns: Columns, name: str, factor: float, label: str) -> None:
    """Draw each set as a point, or as a cross if its quality is not good; ``factor`` converts the unit.

    ``label`` names the axis. The legend appears only with crosses.
    """
    for gid, good, style in (
        (name, True, {"linestyle": "none", "marker": "o", "color": BLUE}),
        (f"{name}-poor", False, {"linestyle": "none", "marker": "x", "color": VERMILLION, "label": POOR}),
    ):
        rows = [(quality == "good") is good for quality in columns["quality"]]
        if any(rows):
            _draw_line(axis, columns, name, style, rows=rows, factor=factor, gid=gid)
    axis.set_ylabel(label)
    if axis.get_legend_handles_labels()[1]:
        axis.legend(**ABOVE)


def _draw_line(
    axis: Axes,
    columns: Columns,
    name: str,
    style: Mapping[str, Any],
    *,
    rows: Sequence[bool | None] | None = None,
    factor: float = 1.0,
    gid: str = "",
) -> None:
    """Draw a column times ``factor``, or only the selected rows of it, over the hours.

    Missing values are left out and do not interrupt the line. ``style`` are options of `Axes.plot`; ``gid``
    is the id in the SVG, by default the column's name.
    """
    wanted = [True] * len(columns[name]) if rows is None else rows
    cells = zip(columns["due_h"], columns[name], wanted, strict=True)
    points = [(hour, factor * value) for hour, value, drawn in cells if drawn and value is not None]
    axis.plot([hour for hour, _ in points], [value for _, value in points], gid=gid or name, **style)


def _mark_gaps_and_alarms(contents: Contents, position: PositionReport, axis: Axes) -> None:
    """Mark gaps (shaded), alarms (dashed) and annotations (dotted) of a position in a panel.

    Alarms and annotations without a position are marked, too; withdrawn annotations are left out.
    """
    for gap in contents.gaps:
        if gap.position == position.name:
            axis.axvspan(gap.from_h, gap.to_h, color=GREY, alpha=0.2, linewidth=1.0)
    for alarm in contents.alarms:
        if alarm.position in (position.name, None) and contents.from_h <= alarm.raised_h < contents.to_h:
            axis.axvline(alarm.raised_h, color=VERMILLION, linewidth=0.9, linestyle=(0, (5, 2)))
    for note in contents.annotations:
        if note.position in (position.name, None) and note.withdrawn_utc_ns is None:
            for hour in sorted({note.from_h, note.to_h}):
                if contents.from_h <= hour < contents.to_h:
                    axis.axvline(hour, color=GREEN, linewidth=0.9, linestyle=":")


def _extract_svg_element(svg: str, prefix: str) -> str:
    """Extract the SVG element from a document and prefix its ids and references.

    Raises ValueError without an SVG element.
    """
    element = svg[svg.index("<svg") :]
    element = re.sub(r'\bid="', f'id="{prefix}-', element)
    element = re.sub(r'(xlink:href="#|url\(#)', rf"\g<1>{prefix}-", element)
    return element.replace("<svg ", '<svg aria-hidden="true" focusable="false" ', 1)
