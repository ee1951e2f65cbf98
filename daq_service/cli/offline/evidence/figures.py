"""Draw the figures of an explained alarm as SVG; the JSON file has their numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.statistics.named_limits import DISTANCE, LIMITS, MEWMA
from daq_service.alarms.evidence import FEATURES
from daq_service.assessment.stored_limits import collect_limits_by_name, find_limit_statistic
from daq_service.recording.reassessment.explanation import Explained, Recomputed
from daq_service.recording.reassessment.pulses_of_sets import Pulses
from daq_service.web.report.figures import (
    ABOVE,
    BLUE,
    GREY,
    PANEL_IN,
    PURPLE,
    RULES,
    VERMILLION,
    WIDTH_IN,
    render_svg,
)

LOG_FROM = 100.0
"""Ratio of maximum to limit above which the axis is logarithmic."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """An SVG element and its description."""

    description: str
    svg: str


def draw_alarm_figures(found: Explained) -> list[Picture]:
    """Draw an alarm's mean records, quantities of the sets and contributions, those that have data.

    Returns an empty list if the alarm was not recomputed from stored records (``found.again`` is None).
    """
    if found.again is None:
        return []
    pictures = [
        _draw_mean_records(found, found.again.pulses) if found.again.pulses else None,
        _draw_set_quantities(found, found.again),
    ]
    pictures.append(_draw_contributions(found.alarm.evidence.get("contributions") or {}))
    return [picture for picture in pictures if picture is not None]


def _draw_mean_records(found: Explained, pulses: Pulses) -> Picture:
    """Draw the mean record (V) of the alarm's set and that of the baseline with its SD over time."""
    time_us = 1e6 * pulses.time_s
    with mpl.rc_context(RULES):
        figure, axis = _create_figure(1.6)
        low, high = (pulses.baseline_v + sign * pulses.baseline_sd_v for sign in (-1.0, 1.0))
        axis.fill_between(time_us, low, high, color=GREY, alpha=0.3, linewidth=0.0, label="its sets, 1 SD")
        axis.plot(time_us, pulses.baseline_v, color=GREY, label="mean of the baseline")
        axis.plot(time_us, pulses.set_v, color=VERMILLION, label=f"set {found.alarm.raised_set_index}")
        axis.set(xlabel="time since the peak of the incident wave (µs)", ylabel="sensor (V)")
        axis.legend(**ABOVE)
        svg = render_svg(figure, "waves")
    description = (
        f"The mean record of set {found.alarm.raised_set_index} over the mean of the baseline, laid on each "
        "other at the peak of the incident wave; the reflected wave comes later."
    )
    return Picture(description=description, svg=svg)


class _Panel:
    """A quantity of the sets by hour, and limits by their words, without missing values."""

    def __init__(
        self,
        label: str,
        points: Iterable[tuple[float, float | None]],
        limits: Mapping[str, float | None],
        factor: float = 1.0,
    ) -> None:
        """Store points (hour, value) and limits by name, without missing ones.

        Values and limits are multiplied by ``factor``.
        """
        present = [(hour, factor * value) for hour, value in points if value is not None]
        self.label = label
        self.hours = [hour for hour, _ in present]
        self.values = [value for _, value in present]
        self.limits = {name: factor * limit for name, limit in limits.items() if limit is not None}


def _draw_set_quantities(found: Explained, recomputed: Recomputed) -> Picture | None:
    """Draw a panel for each quantity of the sets up to the alarm, with limits; None if no set has a value."""
    panels = [panel for panel in _yield_panels(found, recomputed) if panel.values]
    if not panels:
        return None
    baseline_ends_h = max((row.due_h for row in recomputed.assessments if row.in_baseline), default=None)
    raised_h = next(row.due_h for row in recomputed.sets if row.set_index == found.alarm.raised_set_index)
    with mpl.rc_context(RULES):
        figure = Figure(figsize=(WIDTH_IN, 0.35 + PANEL_IN * len(panels)), layout="constrained")
        axes = [axis for (axis,) in figure.subplots(len(panels), 1, squeeze=False, sharex=True)]
        for axis, panel in zip(axes, panels, strict=True):
            _draw_panel(axis, panel)
            if baseline_ends_h is not None:
                axis.axvspan(0.0, baseline_ends_h, color=GREY, alpha=0.15, linewidth=0.0, label="baseline")
            axis.axvline(raised_h, color=VERMILLION, linewidth=0.9, linestyle=(0, (5, 2)), label="alarm")
            axis.legend(**ABOVE)
        axes[-1].set_xlabel("hour of the test at which the set was due")
        svg = render_svg(figure, "sets")
    labels = " and ".join(panel.label for panel in panels)
    shaded = "" if baseline_ends_h is None else "the baseline is shaded, "
    description = f"{labels} of each set up to the alarm; {shaded}the dashed line is the alarm's set."
    return Picture(description=description[0].upper() + description[1:], svg=svg)


def _draw_panel(axis: Axes, panel: _Panel) -> None:
    """Draw values and limits on an axis; logarithmic if a value exceeds `LOG_FROM` times the lowest limit."""
    axis.plot(panel.hours, panel.values, linestyle="none", marker="o", color=BLUE)
    for (label, limit), style in zip(panel.limits.items(), _STYLES, strict=False):
        axis.axhline(limit, label=label, **style)
    smallest_limit = min(panel.limits.values(), default=0.0)
    if smallest_limit > 0.0 and max(panel.values) > LOG_FROM * smallest_limit:
        axis.set_yscale("log")
    axis.set_ylabel(panel.label)


_STYLES: Sequence[Mapping[str, Any]] = (
    {"color": VERMILLION},
    {"color": PURPLE, "linestyle": "--"},
    {"color": GREY, "linestyle": ":"},
)


def _yield_panels(found: Explained, recomputed: Recomputed) -> Iterable[_Panel]:
    """Yield the panels for the kind of alarm: thickness (mm), numbers of shots, or statistics with limits.

    Nothing for a statistical alarm without a baseline.
    """
    evidence, rule = found.alarm.evidence, found.alarm.evidence.get("rule") or {}
    if found.alarm.kind == "thickness_low":
        read = [(row.due_h, getattr(row, "thickness_m", None)) for row in recomputed.measured]
        yield _Panel("wall (mm)", read, {"limit": evidence.get("limit_m")}, 1e3)
    elif found.alarm.kind == "no_reflection":
        counted = [(row.due_h, float(recomputed.silent.get(row.set_index, 0))) for row in recomputed.sets]
        yield _Panel("shots without reflected wave", counted, {"alarm from here": rule.get("shots")})
    elif "minimum_valid_shots" in evidence:
        counted = [(row.due_h, float(row.n_valid)) for row in recomputed.sets if row.n_planned]
        yield _Panel("valid shots", counted, {"needed": evidence["minimum_valid_shots"]})
    elif recomputed.baseline is not None:
        limits = collect_limits_by_name(recomputed.baseline)
        limit_names = (str(evidence.get("limit_name")), found.settings.novelty.limit, MEWMA)
        names = [name for name in dict.fromkeys(limit_names) if name in LIMITS]
        for statistic in dict.fromkeys(LIMITS[name].of for name in names):
            of_it = {name: limits.get(name) for name in names if LIMITS[name].of == statistic}
            a_name = next(iter(of_it))
            values = [(row.due_h, find_limit_statistic(row, a_name)) for row in recomputed.assessments]
            label = {DISTANCE: "squared distance", MEWMA: "control chart"}.get(statistic, statistic)
            shown = {f"limit {name}" if name != MEWMA else "limit": limit for name, limit in of_it.items()}
            yield _Panel(label.replace("_", " "), values, shown)


def _draw_contributions(parts: Mapping[str, float | None]) -> Picture | None:
    """Draw the contributions of the features to the statistic in %, the largest on top; None without any.

    ``parts`` has them by feature.
    """
    known = {name: part for name, part in parts.items() if part is not None}
    if not known:
        return None
    total = sum(known.values()) or 1.0
    names = sorted(known, key=lambda name: known[name])
    with mpl.rc_context(RULES):
        figure, axis = _create_figure(1.0)
        axis.barh(np.arange(len(names)), [100.0 * known[name] / total for name in names], color=BLUE)
        axis.set_yticks(np.arange(len(names)), [FEATURES.get(name, name.replace("_", " ")) for name in names])
        axis.set_xlabel("share (%)")
        svg = render_svg(figure, "contributions")
    description = "Contribution of each feature to the value that was compared with the limit."
    return Picture(description=description, svg=svg)


def _create_figure(panels: float) -> tuple[Figure, Axes]:
    """Create a figure with one axis, ``panels`` times as high as a panel."""
    figure = Figure(figsize=(WIDTH_IN, 0.35 + PANEL_IN * panels), layout="constrained")
    return figure, figure.subplots()
