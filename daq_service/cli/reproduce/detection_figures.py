"""Figures 14 and 15: the outlier analysis, and the ultrasonic thickness."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from daq_service.cli.reproduce import item, style
from daq_service.cli.reproduce.evidence import Evidence, FloatArray, PulseEchoes, SolitaryWaves
from daq_service.cli.reproduce.paper_values import printed

SPLIT_H = 100.0
"""The paper counts outliers after this hour."""
LATE_H = 230.0
"""After this one all of C's are outliers in the paper."""
READ_H = 300.0
"""Hour at which the paper reads 4.2 mm."""
READ_WITHIN_H = 5.0
"""Readings this near are averaged (median): one reading has some hundredths of a millimetre of noise."""


def draw_fig14(material: item.Material) -> item.Product:
    """Draw the Mahalanobis squared distance over the test."""
    test, names = material.test, material.transducers
    if all(test.pulses[name].baseline is None for name in names):
        raise item.NotAvailableError(
            f"no baseline was frozen up to hour {test.last_h:g}; it takes the first {test.baseline_h:g} h"
            if test.baseline_h is not None
            else f"no baseline was frozen up to hour {test.last_h:g}"
        )
    figure, axes = style.sheet(1, len(names), height_in=3.6, sharex=True, sharey=True)
    for axis, name in zip(axes, names, strict=True):
        _distances(axis, test.pulses[name], test.baseline_h, style.colour_of(name, names))
    axes[0].set_ylabel("Mahalanobis squared distance (1)")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    style.name_panels(axes, [f"position {name}" for name in names])

    def columns(pulses: SolitaryWaves) -> dict[str, FloatArray]:
        assessed = {
            key: pulses.values[key] for key in ("distance_squared", "limit_f_predictive", "limit_mean_3sd")
        }
        return assessed | {
            key: getattr(pulses, key) for key in ("in_baseline", "outlier", "outlier_mean_3sd")
        }

    return item.Product(
        drawing=figure,
        tables={"": item.stacked(test, columns)},
        found=_outliers(test),
        notes=tuple(
            f"{name}: baseline of {p.baseline.n_sets} sets, {_share_text(p)}."
            for name, p in test.pulses.items()
            if p.baseline is not None
        ),
    )


def _distances(axis: Axes, pulses: SolitaryWaves, baseline_h: float | None, colour: str) -> None:
    """Draw the distances of a position with its limits."""
    distance = pulses.values["distance_squared"]
    if baseline_h is not None:
        axis.axvspan(0.0, baseline_h, color=style.GREEN, alpha=0.12, lw=0, label="baseline")
    last_h = float(pulses.hour_h[-1]) if pulses.hour_h.size else 0.0
    if last_h > SPLIT_H:
        axis.axvspan(SPLIT_H, last_h, color=style.VERMILLION, alpha=0.08, lw=0, label="counted: after 100 h")
    axis.plot(pulses.hour_h, distance, ".", color=colour, ms=2.5, label="our sets")
    for column, dash, label in (
        ("limit_mean_3sd", "--", "our mean + 3 SD"),
        ("limit_f_predictive", "-", "exact limit (F)"),
    ):
        limit = _limit(pulses, column)
        if limit is not None:
            axis.axhline(limit, color=style.BLACK, lw=1.0, ls=dash, label=label)
    if pulses.position in ("B", "C", "D"):
        for source, dash in (("text", ":"), ("caption", "-.")):
            value = printed("fig14", f"limit_{source}_{pulses.position}")
            axis.axhline(value, color=style.GREY, lw=1.2, ls=dash, label=f"paper's limit, {source}")
    axis.set(xlabel="hour of the test (h)", yscale="log")


def _limit(pulses: SolitaryWaves, column: str) -> float | None:
    limit: float | None = None if pulses.baseline is None else getattr(pulses.baseline, column)
    return limit


def _share(pulses: SolitaryWaves, outlier: FloatArray, from_h: float) -> tuple[float | None, int]:
    """Return the percentage of outliers of the sets assessed after an hour, and their number."""
    is_assessed = (pulses.hour_h > from_h) & np.isfinite(outlier) & (pulses.in_baseline == 0.0)
    n = int(is_assessed.sum())
    return (100.0 * float(outlier[is_assessed].mean()) if n else None), n


def _share_text(pulses: SolitaryWaves) -> str:
    """Describe the percentages of outliers."""
    parts = []
    for limit, outlier in (("mean + 3 SD", pulses.outlier_mean_3sd), ("the exact limit", pulses.outlier)):
        share, n = _share(pulses, outlier, SPLIT_H)
        parts.append(
            f"no set judged after {SPLIT_H:g} h" if share is None else f"{share:.1f} % of {n} by {limit}"
        )
    return " and ".join(dict.fromkeys(parts))


def _outliers(test: Evidence) -> dict[str, item.Found]:
    """Return our values of figure 14."""
    values: dict[str, item.Found] = {}
    for name in "BCD":
        pulses = test.pulses.get(name)
        for key in ("limit_text", "limit_caption", "outliers_paper", "outliers_f"):
            values[f"{key}_{name}"] = _one_outlier_value(test, pulses, name, key)
    values["outliers_late_C"] = _one_outlier_value(test, test.pulses.get("C"), "C", "outliers_late")
    values["smallest_loss"] = _smallest_loss(test)
    return values


def _one_outlier_value(test: Evidence, pulses: SolitaryWaves | None, name: str, key: str) -> item.Found:
    """Return one of our values of figure 14, or why it is missing."""
    if pulses is None:
        return item.missing(f"the test has no solitary-wave position {name}")
    if pulses.baseline is None:
        return item.missing(f"no baseline was frozen at {name} up to hour {test.last_h:g}")
    if key.startswith("limit"):
        limit = _limit(pulses, "limit_mean_3sd")
        return item.found(limit, f"{pulses.baseline.n_sets} sets", reason=str(pulses.baseline.limit_reason))
    from_h = LATE_H if key == "outliers_late" else SPLIT_H
    share, n = _share(pulses, pulses.outlier if key == "outliers_f" else pulses.outlier_mean_3sd, from_h)
    return item.found(
        share, f"of {n} sets", reason=f"no set was judged after hour {from_h:g} (last: {test.last_h:g})"
    )


def _smallest_loss(test: Evidence) -> item.Found:
    """Return the loss that the ultrasonic probe read when the first transducer raised its alarm."""
    alarms = [(p.first_alarm_h, name) for name, p in test.pulses.items() if p.first_alarm_h is not None]
    if not alarms:
        return item.missing(f"no alarm about the wall up to hour {test.last_h:g}")
    if not test.echoes:
        return item.missing("the test has no ultrasonic probe")
    hour, name = min(alarms)
    probe = next(iter(test.echoes.values()))
    near = np.abs(probe.hour_h - hour) <= READ_WITHIN_H
    if not np.isfinite(probe.thickness_loss_m[near]).any():
        return item.missing(f"no ultrasonic reading near hour {hour:g}")
    loss_mm = 1e3 * float(np.nanmedian(probe.thickness_loss_m[near]))
    return item.found(loss_mm, f"read at {probe.position} when {name} alarmed first, hour {hour:g}")


# Figure 15 --------------------------------------------------------------------------------------


def draw_fig15(material: item.Material) -> item.Product:
    """Draw travel time, thickness and loss of the ultrasonic probe."""
    test = material.test
    if not test.echoes:
        raise item.NotAvailableError("the test has no position with method pulse_echo")
    probe = next(iter(test.echoes.values()))
    figure, axes = style.sheet(1, 2, height_in=3.4)
    travel, loss = axes
    colour = style.colour_of(probe.position, list(test.echoes))
    travel.plot(probe.hour_h, 1e6 * probe.travel_time_s, ".", color=style.GREY, ms=6.0, label="travel time")
    travel.set(xlabel="hour of the test (h)", ylabel="ultrasonic travel time (µs)")
    wall = travel.twinx()
    wall.grid(visible=False)
    wall.spines["right"].set_visible(True)
    wall.plot(probe.hour_h, 1e3 * probe.thickness_m, ".", color=colour, ms=2.5, label="thickness, eq. 17")
    wall.set_ylabel("remaining thickness (mm)")
    loss.plot(probe.hour_h, 1e3 * probe.thickness_loss_m, ".", color=colour, ms=2.5, label="loss, eq. 17")
    truth = _true_thickness(test, probe.position)
    if truth is not None:
        wall.plot(truth[0], 1e3 * truth[1], color=style.BLUE, lw=1.0, label="the twin's true wall")
        if probe.initial_thickness_m is not None:
            loss.plot(
                truth[0], 1e3 * (probe.initial_thickness_m - truth[1]), color=style.BLUE, lw=1.0, label="true"
            )
    line = _line(probe)
    if line is not None:
        hours = np.array([0.0, probe.hour_h[-1]])
        loss.plot(hours, 1e3 * (line[0] + line[1] * hours), color=style.BLACK, lw=1.0, label="our line")
    if probe.position == "A":
        read_mm, core_mm = printed("fig15", "thickness_300"), printed("fig15", "core")
        wall.plot([READ_H], [read_mm], **style.PAPER_MARK, label="paper, read at 300 h")
        end_h, initial_mm = printed("table1", "end"), printed("fig15", "initial")
        core_mark = {**style.PAPER_MARK, "marker": "s"}
        wall.plot([end_h], [core_mm], **core_mark, label="paper, cored at the end")
        loss.plot([READ_H], [initial_mm - read_mm], **style.PAPER_MARK)
        loss.plot([end_h], [initial_mm - core_mm], **core_mark)
    loss.set(xlabel="hour of the test (h)", ylabel="loss of thickness (mm)")
    handles, labels = travel.get_legend_handles_labels()
    more_handles, more_labels = wall.get_legend_handles_labels()
    wall.legend([*handles, *more_handles], [*labels, *more_labels], loc="lower left")
    loss.legend(loc="upper left")
    style.name_panels(axes, (f"position {probe.position}: travel time and thickness", "loss of thickness"))
    columns: dict[str, Any] = {
        "set_index": probe.set_index,
        "due_h": probe.hour_h,
        "travel_time_s": probe.travel_time_s,
        "thickness_m": probe.thickness_m,
        "thickness_loss_m": probe.thickness_loss_m,
    }
    return item.Product(
        drawing=figure, tables={"": item.Table(columns=columns)}, found=_wall(test, probe, line)
    )


def _true_thickness(test: Evidence, position: str) -> tuple[FloatArray, FloatArray] | None:
    """Return hours and true thickness of the twin; None for a real specimen."""
    known = [trace for trace in test.traces.get(position, ()) if "thickness_m" in trace.truth]
    if not known:
        return None
    return (
        np.array([trace.hour_h for trace in known]),
        np.array([float(trace.truth["thickness_m"]) for trace in known]),
    )


def _line(probe: PulseEchoes) -> tuple[float, float] | None:
    """Fit the loss in m at hour 0 and its slope in m/h by least squares."""
    present = np.isfinite(probe.thickness_loss_m)
    if np.unique(probe.hour_h[present]).size < 2:
        return None
    slope, start = np.polyfit(probe.hour_h[present], probe.thickness_loss_m[present], 1)
    return float(start), float(slope)


def _wall(test: Evidence, probe: PulseEchoes, line: tuple[float, float] | None) -> dict[str, item.Found]:
    """Return our values of figure 15."""
    names = ("thickness_300", "loss_300", "core", "linearity", "initial")
    if probe.position != "A":
        return dict.fromkeys(names, item.missing("the test has no pulse-echo position A"))
    initial_m = probe.initial_thickness_m
    values = {
        "initial": item.missing("not configured")
        if initial_m is None
        else item.found(1e3 * initial_m, "configured")
    }
    near = np.abs(probe.hour_h - READ_H) <= READ_WITHIN_H
    if np.isfinite(probe.thickness_m[near]).any() and initial_m is not None:
        read_m = float(np.nanmedian(probe.thickness_m[near]))
        values["thickness_300"] = item.found(1e3 * read_m)
        values["loss_300"] = item.found(100.0 * (1.0 - read_m / initial_m))
    else:
        values |= dict.fromkeys(
            names[:2], item.missing(f"no reading near hour {READ_H:g} (last: {test.last_h:g})")
        )
    truth = _true_thickness(test, probe.position)
    last = probe.thickness_m[np.isfinite(probe.thickness_m)][-1:]
    read = f"; the probe then reads {1e3 * float(last[0]):.2f} mm" if last.size else ""
    if truth is None:
        values["core"] = item.missing(f"nobody cored this test's plate{read}")
    else:
        values["core"] = item.found(
            1e3 * float(truth[1][-1]), f"the twin's truth at hour {truth[0][-1]:g}{read}"
        )
    values["linearity"] = (
        item.missing("fewer than two readings") if line is None else item.found(_r_squared(probe, line))
    )
    return values


def _r_squared(probe: PulseEchoes, line: tuple[float, float]) -> float:
    """Compute R^2 of a line through the loss."""
    present = np.isfinite(probe.thickness_loss_m)
    hours, loss = probe.hour_h[present], probe.thickness_loss_m[present]
    residual = loss - (line[0] + line[1] * hours)
    return 1.0 - float(residual @ residual) / float(((loss - loss.mean()) ** 2).sum())


FIG14 = item.Item(
    name="fig14",
    title="Figure 14. Outlier analysis",
    shows="Mahalanobis squared distance (eq. 16) of each set from the baseline, on a logarithmic axis; the "
    "limits are computed from our baseline, the paper prints two different sets of its own.",
    make=draw_fig14,
    needs_test=True,
)
FIG15 = item.Item(
    name="fig15",
    title="Figure 15. Ultrasonic thickness",
    shows="Travel time of the first back-wall echo and the thickness by eq. 17.",
    make=draw_fig15,
    needs_test=True,
)
