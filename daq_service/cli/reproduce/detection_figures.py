"""Figures 14 and 15: the outlier analysis, and the ultrasonic thickness."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from scipy.stats import linregress

from daq_service.cli.reproduce import item, style
from daq_service.cli.reproduce.evidence import Evidence, FloatArray, Series
from daq_service.cli.reproduce.paper_values import printed_number

SPLIT_H = 100.0
"""The paper counts outliers after this hour."""
LATE_H = 230.0
"""After this one all of C's are outliers in the paper."""
READ_H = 300.0
"""Hour at which the paper reads 4.2 mm."""
READ_WITHIN_H = 5.0
"""Readings this near are averaged (median): one reading has some hundredths of a millimetre of noise."""


# Figure 14 --------------------------------------------------------------------------------------


def draw_outlier_figure(material: item.Material) -> item.Product:
    """Draw the Mahalanobis squared distance of each transducer over the test, with its limits.

    Raises NotAvailableError if no baseline was frozen, or without a transducer.
    """
    test, names = material.test, material.transducers
    baseline_h = test.settings.baseline.hours
    if all(test.pulses[name].baseline is None for name in names):
        raise item.NotAvailableError(
            f"no baseline was frozen up to hour {test.last_h:g}; it takes the first {baseline_h:g} h"
        )
    figure, axes = style.create_panels(names, "Mahalanobis squared distance (1)", height_in=3.6)
    for axis, name in zip(axes, names, strict=True):
        _draw_distances(axis, test, test.pulses[name], style.choose_colour(name, names))
    style.add_legend(figure, ncols=4)
    columns = (
        *("distance_squared", "limit_f_predictive", "limit_mean_3sd"),
        *("in_baseline", "outlier", "outlier_mean_3sd"),
    )
    return item.Product(
        drawing=figure,
        tables={
            "": item.stack_columns(test, lambda pulses: {name: pulses.values[name] for name in columns}),
            "detections": _make_detection_table(test),
        },
        found=_compute_outlier_values(test),
        notes=tuple(
            f"{name}: baseline of {pulses.baseline.n_sets} sets, {_describe_outliers(pulses)}."
            for name, pulses in test.pulses.items()
            if pulses.baseline is not None
        ),
    )


def _draw_distances(axis: Axes, test: Evidence, pulses: Series, colour: str) -> None:
    """Draw the distances of a position with our limits, the first alarm and, for B to D, the paper's limits.

    The axis is logarithmic; the twin's true wall loss is written at the alarm.
    """
    baseline_h = test.settings.baseline.hours
    axis.axvspan(0.0, baseline_h, color=style.GREEN, alpha=0.12, lw=0, label="baseline")
    last_h = float(pulses.hour_h[-1]) if pulses.hour_h.size else 0.0
    if last_h > SPLIT_H:
        axis.axvspan(SPLIT_H, last_h, color=style.VERMILLION, alpha=0.08, lw=0, label="counted: after 100 h")
    axis.plot(pulses.hour_h, pulses.values["distance_squared"], ".", color=colour, ms=2.5, label="our sets")
    baseline = pulses.baseline
    limits = () if baseline is None else (baseline.limit_mean_3sd, baseline.limit_f_predictive)
    for limit, dash, label in zip(limits, ("--", "-"), ("our mean + 3 SD", "exact limit (F)"), strict=False):
        if limit is not None:
            axis.axhline(limit, color=style.BLACK, lw=1.0, ls=dash, label=label)
    if pulses.position in ("B", "C", "D"):
        for source, dash in (("text", ":"), ("caption", "-.")):
            value = printed_number("fig14", f"limit_{source}_{pulses.position}")
            axis.axhline(value, color=style.GREY, lw=1.2, ls=dash, label=f"paper's limit, {source}")
    if pulses.first_alarm_h is not None:
        axis.axvline(pulses.first_alarm_h, color=style.PURPLE, lw=1.2, label="first alarm")
        truth, to_axis = test.describe_true_loss(pulses.position), axis.get_xaxis_transform()
        axis.text(pulses.first_alarm_h, 0.02, truth, transform=to_axis, rotation=90, va="bottom", fontsize=6)
    axis.set_yscale("log")


def _make_detection_table(test: Evidence) -> item.Table:
    """Build a table of the first alarm of each kind at each position, with the true wall loss."""
    found = [
        (name, hour_h, kind.replace("_", " "), test.find_true_loss_mm(name, hour_h))
        for name, series in {**test.pulses, **test.echoes}.items()
        for kind, hour_h in series.alarms_h.items()
    ]
    rows = sorted(found, key=lambda row: row[:2])
    names = ("position", "detected_h", "alarm", "true_wall_loss_mm")
    return item.Table(columns={name: [row[k] for row in rows] for k, name in enumerate(names)})


def _outlier_percentage(pulses: Series, outlier: str, from_h: float) -> tuple[float | None, int]:
    """Compute the percentage of outliers among the sets assessed after an hour, and the number of these sets.

    The percentage is None without such sets; baseline sets do not count. ``outlier`` is the column of the
    result: ``outlier`` or ``outlier_mean_3sd``.
    """
    outliers = pulses.values[outlier]
    is_assessed = (pulses.hour_h > from_h) & np.isfinite(outliers) & (pulses.values["in_baseline"] == 0.0)
    n = int(is_assessed.sum())
    return (100.0 * float(outliers[is_assessed].mean()) if n else None), n


def _describe_outliers(pulses: Series) -> str:
    """Describe a position's percentages of outliers after `SPLIT_H` by both limits; equal ones once."""
    parts = []
    for limit, outlier in (("mean + 3 SD", "outlier_mean_3sd"), ("the exact limit", "outlier")):
        share, n = _outlier_percentage(pulses, outlier, SPLIT_H)
        parts.append(
            f"no set assessed after {SPLIT_H:g} h" if share is None else f"{share:.1f} % of {n} by {limit}"
        )
    return " and ".join(dict.fromkeys(parts))


def _compute_outlier_values(test: Evidence) -> dict[str, item.Found]:
    """Return our values of figure 14 by quantity, each missing one with its reason.

    For B, C and D: the limit, and the percentages of outliers by both limits; also the loss in mm at the
    first alarm.
    """
    values = {"smallest_loss": _find_loss_at_first_alarm(test)}
    for name in "BCD":
        pulses = test.pulses.get(name)
        baseline = None if pulses is None else pulses.baseline
        if pulses is None or baseline is None:
            why = (
                f"the test has no solitary-wave position {name}"
                if pulses is None
                else f"no baseline was frozen at {name} up to hour {test.last_h:g}"
            )
            keys = ("limit_text", "limit_caption", "outliers_paper", "outliers_f", "outliers_late")
            values |= {f"{key}_{name}": item.no_value(why) for key in keys}
            continue
        values[f"limit_f_{name}"] = item.make_value(baseline.limit_f_predictive)
        for source in ("text", "caption"):
            values[f"limit_{source}_{name}"] = item.make_value(
                baseline.limit_mean_3sd, f"{baseline.n_sets} sets", reason=str(baseline.limit_reason)
            )
        for key, outlier, from_h in (
            ("outliers_paper", "outlier_mean_3sd", SPLIT_H),
            ("outliers_f", "outlier", SPLIT_H),
            ("outliers_late", "outlier_mean_3sd", LATE_H),
        ):
            share, n = _outlier_percentage(pulses, outlier, from_h)
            reason = f"no set was assessed after hour {from_h:g} (last: {test.last_h:g})"
            values[f"{key}_{name}"] = item.make_value(share, f"of {n} sets", reason=reason)
    return values


def _find_loss_at_first_alarm(test: Evidence) -> item.Found:
    """Return the thickness loss in mm that the first probe read near the first wall alarm of any transducer.

    A value with a reason instead if there is no alarm, probe or reading.
    """
    alarms = [(p.first_alarm_h, name) for name, p in test.pulses.items() if p.first_alarm_h is not None]
    if not alarms:
        return item.no_value(f"no alarm about the wall up to hour {test.last_h:g}")
    if not test.echoes:
        return item.no_value("the test has no ultrasonic probe")
    hour, name = min(alarms)
    probe = next(iter(test.echoes.values()))
    loss_m = _median_near(probe, "thickness_loss_m", hour)
    if loss_m is None:
        return item.no_value(f"no ultrasonic reading near hour {hour:g}")
    words = f"read at {probe.position} at hour {hour:g}, first alarm at {name}; "
    return item.make_value(1e3 * loss_m, words + test.describe_true_loss(name))


def _median_near(probe: Series, column: str, hour: float) -> float | None:
    """Return the median of a column within `READ_WITHIN_H` (h) of an hour; None if there are none."""
    near = probe.values[column][np.abs(probe.hour_h - hour) <= READ_WITHIN_H]
    return float(np.nanmedian(near)) if np.isfinite(near).any() else None


# Figure 15 --------------------------------------------------------------------------------------


def draw_thickness_figure(material: item.Material) -> item.Product:
    """Draw travel time, thickness and loss of the first ultrasonic probe, with the twin's true wall.

    Also draws the least-squares line of the loss and, at position A, the paper's values. Raises
    NotAvailableError without a pulse-echo position.
    """
    test = material.test
    if not test.echoes:
        raise item.NotAvailableError("the test has no position with method pulse_echo")
    probe = next(iter(test.echoes.values()))
    figure, axes = style.create_sheet(1, 2, height_in=3.4)
    travel, loss = axes
    hours, values = probe.hour_h, probe.values
    colour = style.choose_colour(probe.position, list(test.echoes))
    travel.plot(hours, 1e6 * values["travel_time_s"], ".", color=style.GREY, ms=6.0, label="travel time")
    travel.set(xlabel="hour of the test (h)", ylabel="ultrasonic travel time (µs)")
    wall = travel.twinx()
    wall.grid(visible=False)
    wall.spines["right"].set_visible(True)
    wall.plot(hours, 1e3 * values["thickness_m"], ".", color=colour, ms=2.5, label="thickness, eq. 17")
    wall.set_ylabel("remaining thickness (mm)")
    loss.plot(hours, 1e3 * values["thickness_loss_m"], ".", color=colour, ms=2.5, label="loss, eq. 17")
    truth = _read_true_thickness(test, probe.position)
    initial_m = test.settings.ultrasound.initial_thickness_m
    if truth is not None:
        true_h, true_m = truth
        wall.plot(true_h, 1e3 * true_m, color=style.BLUE, lw=1.0, label="the twin's true wall")
        loss.plot(true_h, 1e3 * (initial_m - true_m), color=style.BLUE, lw=1.0, label="true")
    line = _fit_loss_line(probe)
    if line is not None:
        ends_h = np.array([0.0, hours[-1]])
        loss.plot(ends_h, 1e3 * (line[0] + line[1] * ends_h), color=style.BLACK, lw=1.0, label="our line")
    if probe.position == "A":
        _draw_paper_reading(wall, loss)
    loss.set(xlabel="hour of the test (h)", ylabel="loss of thickness (mm)")
    handles, labels = travel.get_legend_handles_labels()
    more_handles, more_labels = wall.get_legend_handles_labels()
    wall.legend([*handles, *more_handles], [*labels, *more_labels], loc="lower left")
    loss.legend(loc="upper left")
    style.title_panels(axes, (f"position {probe.position}: travel time and thickness", "loss of thickness"))
    return item.Product(
        drawing=figure,
        tables={"": item.Table(columns={"set_index": probe.set_index, "due_h": hours, **values})},
        found=_find_thickness(test, probe, line),
    )


def _draw_paper_reading(wall: Axes, loss: Axes) -> None:
    """Draw the paper's thickness reading at `READ_H` and its core thickness, and both as losses (mm)."""
    initial_mm = printed_number("fig15", "initial")
    for hour, quantity, marker, label in (
        (READ_H, "thickness_300", "D", "paper, read at 300 h"),
        (printed_number("table1", "end"), "core", "s", "paper, cored at the end"),
    ):
        mark, value_mm = {**style.PAPER_MARK, "marker": marker}, printed_number("fig15", quantity)
        wall.plot([hour], [value_mm], **mark, label=label)
        loss.plot([hour], [initial_mm - value_mm], **mark)


def _read_true_thickness(test: Evidence, position: str) -> tuple[FloatArray, FloatArray] | None:
    """Return the hours and the twin's true thickness in m of the averaged sets; None if none has it."""
    known = [
        (trace.hour_h, trace.truth["thickness_m"])
        for trace in test.traces.get(position, ())
        if "thickness_m" in trace.truth
    ]
    if not known:
        return None
    hours, thickness = np.transpose(known)
    return hours, thickness


def _fit_loss_line(probe: Series) -> tuple[float, float, float] | None:
    """Fit the loss by least squares: at hour 0 in m, slope in m/h, R^2; None for fewer than two hours."""
    loss_m = probe.values["thickness_loss_m"]
    present = np.isfinite(loss_m)
    if np.unique(probe.hour_h[present]).size < 2:
        return None
    line = linregress(probe.hour_h[present], loss_m[present])
    return float(line.intercept), float(line.slope), float(line.rvalue**2)


def _find_thickness(
    test: Evidence, probe: Series, line: tuple[float, float, float] | None
) -> dict[str, item.Found]:
    """Return our values of figure 15 for position A by quantity, each missing one with its reason.

    Initial thickness, reading at `READ_H` and core in mm, loss in %, and R^2 of the loss's ``line``.
    """
    names = ("thickness_300", "loss_300", "core", "linearity", "initial")
    if probe.position != "A":
        return dict.fromkeys(names, item.no_value("the test has no pulse-echo position A"))
    initial_m = test.settings.ultrasound.initial_thickness_m
    values = {"initial": item.make_value(1e3 * initial_m, "configured")}
    truth, thickness_m = _read_true_thickness(test, probe.position), probe.values["thickness_m"]
    read_m = _median_near(probe, "thickness_m", READ_H)
    if read_m is not None:
        if truth is not None:
            values["true_300"] = item.make_value(1e3 * float(np.interp(READ_H, *truth)))
        values["thickness_300"] = item.make_value(1e3 * read_m)
        values["loss_300"] = item.make_value(100.0 * (1.0 - read_m / initial_m))
    else:
        absent = item.no_value(f"no reading near hour {READ_H:g} (last: {test.last_h:g})")
        values |= dict.fromkeys(names[:2], absent)
    last = thickness_m[np.isfinite(thickness_m)][-1:]
    read = f"; the probe then reads {1e3 * float(last[0]):.2f} mm" if last.size else ""
    values["core"] = (
        item.no_value(f"the plate of this test was not cored{read}")
        if truth is None
        else item.make_value(1e3 * float(truth[1][-1]), f"the twin's truth at hour {truth[0][-1]:g}{read}")
    )
    values["linearity"] = (
        item.no_value("fewer than two readings") if line is None else item.make_value(line[2])
    )
    return values


FIG14 = item.Item(name="fig14", make=draw_outlier_figure, needs_test=True)
FIG15 = item.Item(name="fig15", make=draw_thickness_figure, needs_test=True)
