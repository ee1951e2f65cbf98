"""A picture of each series, in the look of the reproduction's figures."""

from __future__ import annotations

from matplotlib.axes import Axes

from daq_service.cli.keeping.certify.quantity import Series
from daq_service.cli.reproduce.style import BLUE, GREY, house_style, rendered, sheet

HEIGHT_IN = 1.9
SCALES = ((1e9, "GB"), (1e6, "MB"), (1e3, "kB"))


def picture(series: Series) -> bytes:
    """PNG of a series that has values."""
    with house_style():
        figure, (axes,) = sheet(height_in=HEIGHT_IN)
        scale, unit = _scale(series)
        few = len(series.hours) <= 120
        for name, (hours, values) in (series.others or {}).items():
            _line(axes, hours, [value / scale for value in values], GREY, name)
        axes.plot(
            series.hours,
            [value / scale for value in series.values],
            color=BLUE,
            drawstyle="steps-post" if series.steps else "default",
            marker="o" if few else None,
            label="valid" if series.name.startswith("records") else "measured",
        )
        if series.others:
            axes.legend(loc="best", ncols=3)
        axes.set_xlabel("hour of the test")
        axes.set_ylabel(unit if unit != "1" else "number")
        axes.margins(x=0.01)
        axes.ticklabel_format(axis="y", style="plain", useOffset=False)
        low, high = axes.get_ylim()
        if low > 0 and series.unit == "1":
            axes.set_ylim(0, high)
        return rendered(figure)["png"]


def _line(axes: Axes, hours: object, values: object, colour: str, name: str) -> None:
    style = "--" if name in ("forecast", "planned") else "-"
    axes.plot(hours, values, color=colour, linestyle=style, linewidth=1.0, label=name)  # type: ignore[arg-type] # matplotlib takes any sequence


def _scale(series: Series) -> tuple[float, str]:
    if series.unit != "B":
        return 1.0, series.unit
    most = max([abs(value) for value in series.values], default=0.0)
    return next(((scale, name) for scale, name in SCALES if most >= scale), (1.0, "B"))
