"""Draw figure 7: the recorded solitary waves of each transducer over the test."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from daq_service.cli.reproduce import item
from daq_service.cli.reproduce.evidence import Evidence, Series, Trace
from daq_service.cli.reproduce.style import (
    BLACK,
    ORANGE,
    PURPLE,
    add_legend,
    choose_colour,
    create_sheet,
    title_panels,
)

WINDOW_US = (-60.0, 900.0)
STEP_S = 1e-6
"""Spacing of the samples drawn and written; the archive has all of them."""
ROOM = 1.8
"""Height of an incident wave in units of the distance between two traces."""


def draw_waveform_figure(material: item.Material) -> item.Product:
    """Draw averaged waveforms of each transducer, later ones higher, with the times of the features.

    Raises NotAvailableError if no waveform can be read.
    """
    test = material.test
    names = [name for name in test.pulses if test.traces.get(name)]
    if not names:
        raise item.NotAvailableError("the folder has no readable waveform of a solitary-wave transducer")
    figure, axes = create_sheet(1, len(names), height_in=6.0, sharey=True)
    last_h = max(trace.hour_h for name in names for trace in test.traces[name])
    for axis, name in zip(axes, names, strict=True):
        _draw_waterfall(axis, test.traces[name], test.pulses[name], last_h, choose_colour(name, names))
        axis.set(xlabel="time after the trigger (µs)", xlim=WINDOW_US)
    axes[0].set_ylabel("hour of the test (h)")
    add_legend(figure, ncols=3)
    title_panels(axes, [f"position {name}" for name in names])
    return item.Product(
        drawing=figure,
        tables={name: _make_trace_table(test.traces[name]) for name in names},
        found={
            **_compute_time_from_contact(test, names),
            **{f"change_hour_{p}": _find_first_alarm_hour(test, p) for p in "BC"},
        },
        notes=(
            (
                f"Each trace is the mean of a set's accepted records; {len(test.traces[names[0]])} of "
                f"{test.counts['sets']} sets are drawn, lifted to their hour."
            ),
            *test.trouble,
        ),
    )


def _draw_waterfall(axis: Axes, traces: Sequence[Trace], pulses: Series, last_h: float, colour: str) -> None:
    """Draw the averaged records of a position over time, lifted to their hour, and the feature times.

    The times are those of ISW, PSW and SSW. ``last_h``, the last hour of all positions, sets the distance of
    the records.
    """
    spacing_h = last_h / max(len(traces), 2)
    height_v = max(float(np.ptp(trace.volts)) for trace in traces) or 1.0
    hours = np.array([trace.hour_h for trace in traces])
    for trace in traces:
        every = _compute_sample_step(trace)
        time_us = 1e6 * trace.time_s
        shown = np.flatnonzero((time_us >= WINDOW_US[0]) & (time_us <= WINDOW_US[1]))[::every]
        quiet_v = float(np.median(trace.volts[: max(1, int(np.searchsorted(time_us, -20.0)))]))
        lifted_h = trace.hour_h + ROOM * spacing_h * (trace.volts - quiet_v) / height_v
        axis.plot(time_us[shown], lifted_h[shown], color=colour, lw=0.7)
    for column, mark, name in (
        ("isw_time_s", BLACK, "ISW"),
        ("psw_time_s", PURPLE, "PSW"),
        ("ssw_time_s", ORANGE, "SSW"),
    ):
        is_drawn = np.isin(pulses.hour_h, hours)
        axis.plot(
            1e6 * pulses.values[column][is_drawn],
            pulses.hour_h[is_drawn],
            linestyle="none",
            marker="|",
            markersize=5,
            markeredgewidth=1.2,
            color=mark,
            label=f"time of the {name}",
        )


def _compute_sample_step(trace: Trace) -> int:
    """Compute the distance of drawn samples, in samples: about `STEP_S`, at least 1."""
    return max(1, round(STEP_S / float(trace.time_s[1] - trace.time_s[0])))


def _make_trace_table(traces: Sequence[Trace]) -> item.Table:
    """Build a table of all traces of a position in V at the times of the first one, `STEP_S` apart.

    Shorter traces are padded with None, longer ones cut.
    """
    first = traces[0].time_s
    every = _compute_sample_step(traces[0])
    times_s = [round(float(t), 9) for t in first[::every]]
    columns: dict[str, Sequence[object]] = {"time_s": times_s}
    for trace in traces:
        volts = [round(float(v), 6) for v in trace.volts[::every][: len(times_s)]]
        padding = [None] * (len(times_s) - len(volts))
        columns[f"set_{trace.set_index}_hour_{trace.hour_h:g}_v"] = [*volts, *padding]
    return item.Table(columns=columns)


def _compute_time_from_contact(test: Evidence, names: Sequence[str]) -> dict[str, item.Found]:
    """Return the median time in us from the striker's contact to the ISW, which only the twin knows.

    A record's zero is its trigger instead: without the twin a reason is returned.
    """
    times = [
        trace.truth["isw_time_s"]
        for name in names
        for trace in test.traces[name]
        if "isw_time_s" in trace.truth
    ]
    if not times:
        return {
            "isw_time": item.no_value(
                "a record begins at its trigger; only the twin knows when the striker touched"
            )
        }
    return {"isw_time": item.make_value(1e6 * float(np.median(times)), "after the striker's touch")}


def _find_first_alarm_hour(test: Evidence, position: str) -> item.Found:
    """Return the hour of the first wall alarm at a position, or the reason why there is none."""
    if position not in test.pulses:
        return item.no_value(f"the test has no solitary-wave position {position}")
    hour = test.pulses[position].first_alarm_h
    if hour is None:
        return item.no_value(f"no alarm about the wall at {position} up to hour {test.last_h:g}")
    rule = test.settings.alarms
    by_chart = rule.decides_by == "chart"
    rule_text = "control chart" if by_chart else f"{rule.k} of {rule.n} sets above the limit"
    return item.make_value(hour, f"first alarm ({rule_text}), {test.describe_true_loss(position)}")


FIG7 = item.Item(name="fig7", make=draw_waveform_figure, needs_test=True)
