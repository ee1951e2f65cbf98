"""Figures 8, 9 and 11: time of flight, amplitude ratio and ISW amplitude over the test, and their fits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from analysis.errors import AnalysisError
from analysis.statistics.trend import Trend, fit_trend
from daq_service.cli.reproduce import item
from daq_service.cli.reproduce.evidence import FloatArray, Series
from daq_service.cli.reproduce.paper_values import list_paper_values
from daq_service.cli.reproduce.style import BLACK, PAPER_MARK, add_legend, choose_colour, create_panels
from daq_service.cli.reproduce.texts import TEXTS, Trended

POSITIONS = "BCD"
"""Of the paper's fits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fit:
    """Parabola of one position in the axis's unit, and the hour of its last point."""

    trend: Trend
    last_h: float

    @property
    def values(self) -> dict[str, float]:
        """Return the values at hour 0 and at the last point, in the axis's unit, and the change in %."""
        start, end = self.trend.constant, float(self.trend.at(self.last_h))
        return {"start": start, "end": end, "change": 100.0 * (end / start - 1.0)}


_Fits = Mapping[str, _Fit | str]
"""Fit of each position, or why there is none."""


def draw_feature_trend(material: item.Material, feature: Trended) -> item.Product:
    """Draw a feature of all transducers over the test with second-order fits and the paper's values.

    Raises NotAvailableError if the test has no transducer.
    """
    test, names = material.test, material.transducers
    fits = {name: _fit_position(test.pulses[name], feature) for name in names}
    figure, axes = create_panels(names, feature.label, height_in=3.3)
    for axis, name in zip(axes, names, strict=True):
        _draw_feature_panel(axis, test.pulses[name], feature, fits[name], choose_colour(name, names))
    add_legend(figure, ncols=3)

    def build_columns(pulses: Series) -> dict[str, FloatArray]:
        """Build the columns of a transducer: the feature and its fit, NaN without one; in SI units."""
        fit, hours = fits[pulses.position], pulses.hour_h
        fitted = fit.trend.at(hours) / feature.scale if isinstance(fit, _Fit) else np.full(hours.size, np.nan)
        return {feature.column: pulses.values[feature.column], f"fit_of_{feature.column}": fitted}

    return item.Product(
        drawing=figure,
        tables={"": item.stack_columns(test, build_columns), "fits": _make_fit_table(fits)},
        found={
            f"{name}_{position}": _select_fit_value(fits, position, what)
            for what, name in feature.quantities.items()
            for position in POSITIONS
        },
        notes=tuple(f"No fit at {name}: {fit}." for name, fit in fits.items() if isinstance(fit, str)),
    )


def _fit_position(pulses: Series, feature: Trended) -> _Fit | str:
    """Fit a parabola to the sets of a position, or return the reason why there is no fit."""
    values = feature.scale * pulses.values[feature.column]
    try:
        trend = fit_trend(pulses.hour_h, values)
    except AnalysisError as error:
        return str(error)
    return _Fit(trend=trend, last_h=float(pulses.hour_h[np.isfinite(values)][-1]))


def _draw_feature_panel(axis: Axes, pulses: Series, feature: Trended, fit: _Fit | str, colour: str) -> None:
    """Draw a feature of one transducer with its fit and, if printed, the paper's start and end."""
    values, label = feature.scale * pulses.values[feature.column], "sets, mean of the valid strikes"
    axis.plot(pulses.hour_h, values, ".", color=colour, alpha=0.45, ms=2.5, label=label)
    last_h = float(pulses.hour_h[-1])
    if isinstance(fit, _Fit):
        last_h = fit.last_h
        hours = np.linspace(0.0, last_h, 100)
        axis.plot(hours, fit.trend.at(hours), color=BLACK, lw=1.2, label="our fit, second order")
    paper = {value.quantity: value.value for value in list_paper_values(feature.item)}
    start, end, change = (
        paper.get(f"{feature.quantities.get(what)}_{pulses.position}") for what in ("start", "end", "change")
    )
    if start is None or change is None:
        return
    axis.plot([0.0], [start], **PAPER_MARK, label="paper, beginning and end")
    axis.plot([last_h], [start * (1.0 + 0.01 * change) if end is None else end], **PAPER_MARK)


def _make_fit_table(fits: _Fits) -> item.Table:
    """Build a table of coefficients in the axis's unit: constant + linear t + quadratic t^2, t in h.

    Positions without a fit are left out.
    """
    rows = {name: fit for name, fit in fits.items() if isinstance(fit, _Fit)}
    trends = [fit.trend for fit in rows.values()]
    return item.Table(
        columns={
            "position": list(rows),
            "constant": [trend.constant for trend in trends],
            "linear_per_h": [trend.linear for trend in trends],
            "quadratic_per_h2": [trend.quadratic for trend in trends],
            "r_squared": [trend.r_squared for trend in trends],
            "residual_sd": [trend.residual_sd for trend in trends],
            "points": [trend.n_points for trend in trends],
            "last_h": [fit.last_h for fit in rows.values()],
        }
    )


def _select_fit_value(fits: _Fits, position: str, what: str) -> item.Found:
    """Return "start", "end" or "change" of a position's fit, or the reason why it is missing."""
    fit = fits.get(position)
    if fit is None:
        return item.no_value(f"the test has no solitary-wave position {position}")
    if isinstance(fit, str):
        return item.no_value(fit)
    return item.make_value(fit.values[what], f"to hour {fit.last_h:g}")


FIG8, FIG9, FIG11 = (
    item.Item(name=feature.item, make=partial(draw_feature_trend, feature=feature), needs_test=True)
    for feature in TEXTS.trends
)
