"""Draw a figure of each series in the style of the reproduction's figures."""

from __future__ import annotations

from collections.abc import Iterable

import matplotlib as mpl
from matplotlib.figure import Figure

from daq_service.cli.maintenance.acceptance.page import choose_display_unit
from daq_service.cli.maintenance.acceptance.quantity import Series
from daq_service.cli.reproduce.style import BLUE, GREY, ORANGE, RULES, VERMILLION, render_figure

SIZE_IN = (4.7, 1.9)
"""Two of them side by side fill a sheet of paper."""
FEW = 120
"""Maximum number of readings drawn as dots."""
DASHED = ("forecast", "planned")


def draw_series(series: Series, gaps: Iterable[tuple[float, float]] = ()) -> bytes:
    """Draw a series over the hours of the test as a PNG image and return its bytes.

    ``gaps`` are shaded ranges of hours. At most two of the series' other lines are drawn.
    """
    scale, unit = choose_display_unit(series.text.unit, max(map(abs, series.values), default=0.0))
    with mpl.rc_context(RULES):
        figure = Figure(figsize=SIZE_IN, layout="constrained")
        axes = figure.subplots()
        for from_h, until_h in gaps:
            axes.axvspan(from_h, until_h, color=VERMILLION, alpha=0.15, linewidth=0.0)
        others = series.others.items()
        for (name, (hours, values)), colour in zip(others, (GREY, ORANGE), strict=False):
            scaled = [value / scale for value in values]
            style = "--" if name in DASHED else "-"
            axes.plot(hours, scaled, color=colour, linestyle=style, linewidth=1.0, label=name)
        axes.plot(
            series.hours,
            [value / scale for value in series.values],
            color=BLUE,
            drawstyle="steps-post" if series.steps else "default",
            marker="o" if len(series.hours) <= FEW else None,
            label=series.label,
        )
        if others:
            axes.legend(loc="best", ncols=3)
        axes.set_xlabel("hour of the test")
        axes.set_ylabel("number" if unit == "1" else unit)
        axes.margins(x=0.01)
        axes.ticklabel_format(axis="y", style="plain", useOffset=False)
        if series.text.unit == "1":
            axes.set_ylim(bottom=0.0)
        return render_figure(figure, ["png"])["png"]
