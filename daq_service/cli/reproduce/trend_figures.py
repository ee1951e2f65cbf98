"""Figures 8, 9 and 11: time of flight, amplitude ratio and ISW amplitude over the test, and their fits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from analysis.errors import AnalysisError
from analysis.statistics.trend import Trend, fit_trend
from daq_service.cli.reproduce import item
from daq_service.cli.reproduce.evidence import Evidence, FloatArray, SolitaryWaves
from daq_service.cli.reproduce.paper_values import printed
from daq_service.cli.reproduce.style import BLACK, PAPER_MARK, colour_of, name_panels, sheet


@dataclass(frozen=True, slots=True, kw_only=True)
class _FeatureStyle:
    """Style of a feature's figure: column, factor to the axis's unit, label."""

    column: str
    scale: float
    label: str
    paper_marks: Callable[[str], Sequence[tuple[str, float]]]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fit:
    """Parabola of one position in the axis's unit, and the hours of its first and last point."""

    trend: Trend
    last_h: float

    @property
    def change_percent(self) -> float:
        return 100.0 * (float(self.trend.at(self.last_h)) / self.trend.constant - 1.0)


def _fits(test: Evidence, style: _FeatureStyle) -> dict[str, _Fit | str]:
    """Fit every position, or return why there is no fit."""
    fits: dict[str, _Fit | str] = {}
    for name, pulses in test.pulses.items():
        values = style.scale * pulses.values[style.column]
        present = np.isfinite(values)
        try:
            trend = fit_trend(pulses.hour_h, values)
        except AnalysisError as error:
            fits[name] = str(error)
            continue
        fits[name] = _Fit(trend=trend, last_h=float(pulses.hour_h[present][-1]))
    return fits


def _draw(
    material: item.Material,
    style: _FeatureStyle,
    found_by: Callable[[Mapping[str, _Fit | str]], dict[str, item.Found]],
) -> item.Product:
    """Draw a feature of all transducers with fits and the paper's values."""
    test, names = material.test, material.transducers
    fits = _fits(test, style)
    figure, axes = sheet(1, len(names), height_in=3.3, sharex=True, sharey=True)
    for axis, name in zip(axes, names, strict=True):
        _panel(axis, test.pulses[name], style, fits[name], colour_of(name, names))
    axes[0].set_ylabel(style.label)
    handles_by_label = {
        label: handle
        for axis in axes
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        list(handles_by_label.values()), list(handles_by_label), loc="outside lower center", ncols=3
    )
    name_panels(axes, [f"position {name}" for name in names])
    notes = tuple(f"No fit at {name}: {fit}." for name, fit in fits.items() if isinstance(fit, str))
    return item.Product(
        drawing=figure,
        tables={"": _table(test, style, fits), "fits": _fit_table(fits)},
        found=found_by(fits),
        notes=notes,
    )


def _panel(axis: Axes, pulses: SolitaryWaves, style: _FeatureStyle, fit: _Fit | str, colour: str) -> None:
    """Draw a feature of one transducer."""
    axis.plot(
        pulses.hour_h,
        style.scale * pulses.values[style.column],
        ".",
        color=colour,
        alpha=0.45,
        ms=2.5,
        label="sets, mean of the valid strikes",
    )
    axis.set(xlabel="hour of the test (h)")
    if isinstance(fit, _Fit):
        hours = np.linspace(0.0, fit.last_h, 100)
        axis.plot(hours, fit.trend.at(hours), color=BLACK, lw=1.2, label="our fit, second order")
    for number, (end_name, value) in enumerate(style.paper_marks(pulses.position)):
        hour = (
            0.0 if end_name == "start" else float(pulses.hour_h[-1] if isinstance(fit, str) else fit.last_h)
        )
        axis.plot([hour], [value], **PAPER_MARK, label="paper, beginning and end" if number == 0 else None)


def _table(test: Evidence, style: _FeatureStyle, fits: Mapping[str, _Fit | str]) -> item.Table:
    """Return a feature and its fit as a table."""

    def columns(pulses: SolitaryWaves) -> dict[str, FloatArray]:
        fit, hours = fits[pulses.position], pulses.hour_h
        fitted = fit.trend.at(hours) / style.scale if isinstance(fit, _Fit) else np.full(hours.size, np.nan)
        return {style.column: pulses.values[style.column], f"fit_of_{style.column}": fitted}

    return item.stacked(test, columns)


def _fit_table(fits: Mapping[str, _Fit | str]) -> item.Table:
    """Return the coefficients in the axis's unit: constant + linear t + quadratic t^2, t in h."""
    rows = [(name, fit) for name, fit in fits.items() if isinstance(fit, _Fit)]
    return item.Table(
        columns={
            "position": [name for name, _ in rows],
            "constant": [fit.trend.constant for _, fit in rows],
            "linear_per_h": [fit.trend.linear for _, fit in rows],
            "quadratic_per_h2": [fit.trend.quadratic for _, fit in rows],
            "r_squared": [fit.trend.r_squared for _, fit in rows],
            "residual_sd": [fit.trend.residual_sd for _, fit in rows],
            "points": [fit.trend.n_points for _, fit in rows],
            "last_h": [fit.last_h for _, fit in rows],
        }
    )


def _of(fits: Mapping[str, _Fit | str], position: str, value: Callable[[_Fit], float]) -> item.Found:
    """Return a value of a position's fit, or why it is missing."""
    fit = fits.get(position)
    if fit is None:
        return item.missing(f"the test has no solitary-wave position {position}")
    if isinstance(fit, str):
        return item.missing(fit)
    return item.found(value(fit), f"to hour {fit.last_h:g}")


def draw_fig8(material: item.Material) -> item.Product:
    """Draw the time of flight by peaks."""

    def marks(position: str) -> Sequence[tuple[str, float]]:
        if position not in ("B", "C", "D"):
            return ()
        start = printed("fig8", f"tof_start_{position}")
        rise = printed("fig8", f"tof_rise_{position}")
        return (("start", start), ("end", start * (1.0 + 0.01 * rise)))

    def values(fits: Mapping[str, _Fit | str]) -> dict[str, item.Found]:
        start = {f"tof_start_{p}": _of(fits, p, lambda fit: fit.trend.constant) for p in "BCD"}
        return {**start, **{f"tof_rise_{p}": _of(fits, p, lambda fit: fit.change_percent) for p in "BCD"}}

    style = _FeatureStyle(
        column="tof_pp_s", scale=1e6, label="time of flight, peak to peak (µs)", paper_marks=marks
    )
    return _draw(material, style, values)


def draw_fig9(material: item.Material) -> item.Product:
    """Draw the amplitude ratio."""

    def marks(position: str) -> Sequence[tuple[str, float]]:
        if position not in ("B", "C", "D"):
            return ()
        start = printed("fig9", f"ar_start_{position}")
        end = start if position == "D" else printed("fig9", f"ar_end_{position}")
        return (("start", start), ("end", end))

    def values(fits: Mapping[str, _Fit | str]) -> dict[str, item.Found]:
        start = {f"ar_start_{p}": _of(fits, p, lambda fit: fit.trend.constant) for p in "BCD"}
        end = {f"ar_end_{p}": _of(fits, p, lambda fit: float(fit.trend.at(fit.last_h))) for p in "BC"}
        fall = {f"ar_fall_{p}": _of(fits, p, lambda fit: fit.change_percent) for p in "BCD"}
        return {**start, **end, **fall}

    style = _FeatureStyle(
        column="amplitude_ratio", scale=1.0, label="amplitude ratio PSW / ISW (1)", paper_marks=marks
    )
    return _draw(material, style, values)


def draw_fig11(material: item.Material) -> item.Product:
    """Draw the ISW amplitude; the paper prints no number, only that there is no trend."""

    def values(fits: Mapping[str, _Fit | str]) -> dict[str, item.Found]:
        return {f"isw_trend_{p}": _of(fits, p, lambda fit: fit.change_percent) for p in "BCD"}

    style = _FeatureStyle(
        column="isw_amplitude_v", scale=1.0, label="amplitude of the ISW (V)", paper_marks=lambda _: ()
    )
    return _draw(material, style, values)


_PARABOLA = "Each point is a set's feature, the line a second-order fit through all of them"

FIG8 = item.Item(
    name="fig8",
    title="Figure 8. Time of flight over the test",
    shows=f"{_PARABOLA}; diamonds: where the paper's fits begin (about 325 us) and about 10 % above that.",
    make=draw_fig8,
    needs_test=True,
)
FIG9 = item.Item(
    name="fig9",
    title="Figure 9. Amplitude ratio over the test",
    shows=f"{_PARABOLA}; diamonds: the paper's values at the beginning and the end.",
    make=draw_fig9,
    needs_test=True,
)
FIG11 = item.Item(
    name="fig11",
    title="Figure 11. Amplitude of the incident wave over the test",
    shows=f"{_PARABOLA}; the paper finds no trend.",
    make=draw_fig11,
    needs_test=True,
)
