"""Figures of a report as SVG: each set a point, outliers and bad sets by shape, gaps shaded.

Object-oriented API only, text stays text, and the same numbers give the same bytes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from daq_service.shared_file import load_module_toml
from daq_service.web.report.contents import OF_FORECAST, Columns, Contents, PositionReport

# Okabe and Ito (2008), Color Universal Design.
BLUE, VERMILLION, PURPLE, GREEN, GREY = "#0072B2", "#D55E00", "#9c4a7c", "#009E73", "#555555"
WIDTH_IN, PANEL_IN = 7.2, 1.75
SUMMARY_IN = (3.5, 1.5)
"""Width and height: two figures next to each other fill a sheet of paper."""
DOTS = {"linestyle": "none", "marker": "o", "color": BLUE}
MARGIN = 0.01
"""Fraction of the hours at both ends, so that the first and last points are fully visible."""
POOR = "suspect or bad"
ABOVE: Any = {"loc": "lower left", "bbox_to_anchor": (0.0, 0.98), "ncols": 4, "columnspacing": 1.0}
"""Position of a legend above the axes."""
RULES: Any = load_module_toml(__file__)
_NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}


def draw_position_figure(contents: Contents, position: PositionReport) -> str:
    """Draw the trend of a position over the hours of the test as SVG element; empty without values.

    A transducer has three panels, with a wall thickness four, a probe one. Equal contents, equal bytes.
    """
    values, assessments = position.values, position.assessments
    panels = [partial(_draw_thickness, values, position.limit, "95 % interval")]
    if assessments is not None:
        points = partial(partial, _draw_points, values)
        panels = [
            points("tof_pp_s", 1e6, "time of flight (µs)"),
            points("amplitude_ratio", 1.0, "amplitude ratio"),
            partial(_draw_distance, assessments),
        ]
    if (wall := position.wall) is not None and any(wall["thickness_m"]):
        limit_m = next((one for one in wall["minimum_m"] if one is not None), None)
        panels.append(partial(_draw_thickness, wall, limit_m, "90 % interval"))
    size_in = (WIDTH_IN, 0.35 + PANEL_IN * len(panels))
    return _draw_panels(contents, position, panels, size_in, f"figure-{position.name}")


def draw_summary_figure(contents: Contents, position: PositionReport) -> str:
    """Draw thickness, control chart or squared distance of a position as small SVG; empty without values.

    A transducer has the control chart if it decides its alarm. Equal contents give equal bytes.
    """
    assessments, by_chart = position.assessments, contents.settings.alarms.decides_by == "chart"
    if assessments is None:
        panel = partial(_draw_thickness, position.values, position.limit, "95 % interval")
    else:
        draw = _draw_chart if by_chart and any(assessments["mewma_statistic"]) else _draw_distance
        panel = partial(draw, assessments)
    return _draw_panels(contents, position, [panel], SUMMARY_IN, f"summary-{position.name}")


def _draw_panels(
    contents: Contents,
    position: PositionReport,
    panels: Sequence[Callable[[Axes], None]],
    size_in: tuple[float, float],
    prefix: str,
) -> str:
    """Draw panels of a position below each other over the hours of the report as SVG element.

    It is empty if the position has no values. ``prefix`` makes its ids unique.
    """
    if not position.values["due_h"]:
        return ""
    with mpl.rc_context(RULES):
        figure = Figure(figsize=size_in, layout="constrained")
        axes = [axis for (axis,) in figure.subplots(len(panels), 1, squeeze=False, sharex=True)]
        for panel, axis in zip(panels, axes, strict=True):
            panel(axis)
            _mark_gaps_and_alarms(contents, position, axis)
        to_h = min(contents.to_h, contents.now_h)
        if len(panels) > 1 and (forecast := (position.wall or {}).get("forecast_h")):
            to_h = max(to_h, forecast[-1] or 0.0)
        margin_h = MARGIN * (to_h - contents.from_h)
        axes[0].set_xlim(contents.from_h - margin_h, to_h + margin_h)
        axes[-1].set_xlabel("time since start (h)")
        return render_svg(figure, prefix)


def render_svg(figure: Figure, prefix: str) -> str:
    """Render a figure as SVG element of a page; ``prefix`` makes its ids unique."""
    content = io.StringIO()
    figure.savefig(content, format="svg", metadata=_NO_METADATA)
    return _extract_svg_element(content.getvalue(), prefix)


def _draw_distance(assessments: Columns, axis: Axes) -> None:
    """Draw the squared distance of a transducer's sets with its limits; outliers are diamonds."""
    diamonds = {"marker": "D", "markersize": 5, "markerfacecolor": "none", "color": VERMILLION}
    outliers = DOTS | diamonds | {"label": "outlier"}
    _draw_line(axis, assessments, "distance_squared", DOTS | {"label": "D²"})
    _draw_line(axis, assessments, "distance_squared", outliers, rows=assessments["outlier"], gid="outliers")
    _draw_line(axis, assessments, "limit_f_predictive", {"color": VERMILLION, "label": "F limit"})
    dashed = {"color": PURPLE, "linestyle": "--", "label": "mean + 3 SD"}
    _draw_line(axis, assessments, "limit_mean_3sd", dashed)
    _finish_statistic_axis(axis, assessments["distance_squared"], "squared distance")


def _draw_chart(assessments: Columns, axis: Axes) -> None:
    """Draw the statistic of a transducer's control chart with its limit."""
    _draw_line(axis, assessments, "mewma_statistic", DOTS)
    _draw_line(axis, assessments, "mewma_limit", {"color": VERMILLION, "label": "limit"})
    _finish_statistic_axis(axis, assessments["mewma_statistic"], "control chart")


def _finish_statistic_axis(axis: Axes, values: Sequence[float | None], label: str) -> None:
    """Label the axis of a statistic and add its legend; it is logarithmic if any value is positive."""
    if any(value is not None and value > 0.0 for value in values):
        axis.set_yscale("log")
        axis.yaxis.set_major_formatter(LogFormatter())
        axis.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=(1, 0.4)))
    axis.set_ylabel(label)
    axis.legend(**ABOVE)


def _draw_thickness(values: Columns, limit_m: float | None, interval: str, axis: Axes) -> None:
    """Draw the wall thickness (mm) of sets with the interval of each, labeled, and the alarm limit."""
    low_mm, high_mm = (1e3 * np.array(values[f"interval_{end}_m"], dtype=float) for end in ("low", "high"))
    axis.fill_between(values["due_h"], low_mm, high_mm, color=GREY, alpha=0.25, lw=0.0, label=interval)
    _draw_points(values, "thickness_m", 1e3, "wall (mm)", axis)
    if "forecast_h" in values and values["forecast_h"][-1] is not None:  # of the newest set
        hours = [values[name][-1] for name in ("due_h", "forecast_h")]
        ends = zip(("interval_low_m", "thickness_m", "interval_high_m"), OF_FORECAST, strict=True)
        low, middle, high = ([1e3 * values[name][-1] for name in names] for names in ends)
        axis.fill_between(hours, low, high, color=BLUE, alpha=0.15, lw=0.0, label="forecast, 5 to 95 %")
        axis.plot(hours, middle, color=BLUE, linestyle="--", gid="forecast")
    if limit_m is not None:
        axis.axhline(1e3 * limit_m, color=VERMILLION, label="limit")
    axis.legend(**ABOVE)


def _draw_points(columns: Columns, name: str, factor: float, label: str, axis: Axes) -> None:
    """Draw each set as a point, or as a cross if its quality is not good; ``factor`` converts the unit.

    Bars have the standard error, if known. ``label`` names the axis. The legend appears only with crosses.
    """
    for gid, good, style in (
        (name, True, DOTS),
        (f"{name}-poor", False, {"linestyle": "none", "marker": "x", "color": VERMILLION, "label": POOR}),
    ):
        rows = [(quality == "good") is good for quality in columns["quality"]]
        if any(rows):
            _draw_line(axis, columns, name, style, rows=rows, factor=factor, gid=gid)
    if errors := columns.get(f"standard_error_{name}"):
        middle, half = (factor * np.array(one, dtype=float) for one in (columns[name], errors))
        axis.errorbar(columns["due_h"], middle, half, fmt="none", ecolor=BLUE, alpha=0.4, elinewidth=0.8)
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
