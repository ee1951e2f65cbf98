"""HTML page of a report."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple, get_args

from analysis.statistics.chart import ENOUGH_SETS
from daq_service.alarms.evidence import build_evidence_sentences
from daq_service.alarms.states import PRIORITIES, describe_alarm, format_number, format_probability
from daq_service.alarms.transitions import build_transition
from daq_service.assessment.position_status import PositionStatus
from daq_service.settings.stored import remove_private_keys
from daq_service.settings.tree import AlarmSettings
from daq_service.web.report.contents import MOST_LINES, OF_FORECAST, Columns, Contents, PositionReport
from daq_service.web.templates import NOT_KNOWN, format_quantity, render_template

MOST_POSITIONS, MOST_ALARMS = 6, 6
"""Limits of the summary, which fits two pages; the most urgent are shown."""
Row = Sequence[str]


class Measured(NamedTuple):
    """Newest value of a quantity in the range with its limit, as texts, and the hour of its set."""

    quantity: str
    value: str
    limit: str
    hour: float
    quality: str


def render_report_page(
    contents: Contents, figures: Mapping[str, str], summary_figures: Mapping[str, str]
) -> bytes:
    """Render the HTML page in UTF-8; figures are SVG elements by position, empty without values.

    Raises jinja2.UndefinedError if the template uses an unknown name.
    """
    alarms, active = contents.settings.alarms, [row for row in contents.alarms if row.state != "normal"]
    urgency = get_args(PositionStatus).index
    most_urgent = sorted(contents.positions, key=lambda position: -urgency(position.state))[:MOST_POSITIONS]
    return render_template(
        "report.html.j2",
        title=f"Test report: {contents.experiment.name}",
        contents=contents,
        summarized=[position for position in contents.positions if position in most_urgent],
        active=sorted(active, key=lambda row: (-PRIORITIES.index(row.priority), row.raised_h)),
        figures=figures,
        summary_figures=summary_figures,
        methods=render_methods(contents),
        enough_sets=ENOUGH_SETS,
        most_lines=MOST_LINES,
        most_alarms=MOST_ALARMS,
        configuration=json.dumps(
            remove_private_keys(contents.experiment.configuration), indent=1, sort_keys=True
        ),
        newest=lambda position: list(_list_newest(position, alarms)),
        baselines={row.position: row for row in contents.baselines.values() if row.state == "approved"},
        diagnosis=_find_newest_diagnosis,
        series=_build_series_rows,
        sentences=partial(build_evidence_sentences, baselines=contents.baselines),
        headline=lambda alarm: describe_alarm(alarm).headline,
        action=lambda alarm: describe_alarm(alarm).action,
        transition=build_transition,
    )


def render_methods(contents: Contents) -> str:
    """Render a paragraph of settings, versions and uncertainties for the methods section of a paper."""
    return " ".join(render_template("methods.txt.j2", contents=contents).decode().split())


def _find_newest(values: Sequence[object]) -> int | None:
    """Find the index of the last value that is not None."""
    return next((at for at in reversed(range(len(values))) if values[at] is not None), None)


def _find_newest_diagnosis(position: PositionReport) -> tuple[float, Mapping[str, float]] | None:
    """Find the newest diagnosis of a transducer: its hour and the probability of each cause."""
    assessments = position.assessments or {}
    if (at := _find_newest(assessments.get("diagnosis_details", ()))) is None:
        return None
    return assessments["due_h"][at], assessments["diagnosis_details"][at]["probabilities"]


def _list_newest(position: PositionReport, alarms: AlarmSettings) -> Iterator[Measured]:
    """Yield the newest values of a position: thickness, or control chart (if it decides) and distance."""
    columns, wanted = position.values, {"thickness_m": "Wall thickness"}
    qualities = dict(zip(columns["due_h"], columns["quality"], strict=True))
    if position.assessments is not None:
        by_chart = {"mewma_statistic": "Control chart"} if alarms.decides_by == "chart" else {}
        columns, wanted = position.assessments, by_chart | {"distance_squared": "Squared distance D²"}
    for column, quantity in wanted.items():
        if (at := _find_newest(columns[column])) is None:
            continue
        value, hour = columns[column][at], columns["due_h"][at]
        limit = columns["mewma_limit"][at] if column == "mewma_statistic" else position.limit
        texts = format_number(value), NOT_KNOWN if limit is None else format_number(limit)
        if column == "thickness_m":
            ends = (format_quantity(columns[f"interval_{end}_m"][at], 1e3) for end in ("low", "high"))
            wall, limit_mm = (format_quantity(one, 1e3, 2, "mm") for one in (value, limit))
            texts = f"{wall} (95 % interval {' to '.join(ends)} mm)", limit_mm
        yield Measured(quantity, *texts, hour, qualities.get(hour, NOT_KNOWN))
    yield from _list_newest_wall(position.wall or {})


def _list_newest_wall(wall: Columns) -> Iterator[Measured]:
    """Yield the newest wall thickness from waves, if any, with its probability to be below the minimum."""
    if (at := _find_newest(wall.get("thickness_m", ()))) is None:
        return
    value, minimum = (format_quantity(wall[name][at], 1e3, 2, "mm") for name in ("thickness_m", "minimum_m"))
    ends = (format_quantity(wall[f"interval_{end}_m"][at], 1e3) for end in ("low", "high"))
    text = f"{value} (90 % interval {' to '.join(ends)} mm)"
    if (ahead_h := wall["forecast_h"][at]) is not None:
        low, middle, high = (format_quantity(wall[name][at], 1e3) for name in OF_FORECAST)
        text += f"; forecast for hour {ahead_h:.1f}: {middle} mm ({low} to {high} mm)"
    if (below := wall["below_minimum_probability"][at]) is not None:
        minimum += f", below with {format_probability(below)}"
    if (left_s := wall["time_to_minimum_s"][at]) is not None:
        minimum += f", at this rate in {left_s / 86400.0:.0f} d"
    yield Measured("Wall thickness (waves)", text, minimum, wall["due_h"][at], wall["quality"][at])


def _build_series_rows(position: PositionReport) -> Iterator[Row]:
    """Yield for each measured quantity of a position a table row with its statistics over the range."""
    if position.assessments is None:
        yield _build_series_row("Wall thickness", position.values, "thickness_m", 1e3, 2, "mm")
        yield _build_series_row("Wall loss", position.values, "thickness_loss_m", 1e3, 2, "mm")
    else:
        yield _build_series_row("Time of flight", position.values, "tof_pp_s", 1e6, 1, "µs")
        yield _build_series_row("Amplitude ratio", position.values, "amplitude_ratio", 1.0, 3, "")
        yield _build_series_row("Squared distance", position.assessments, "distance_squared", 1.0, 1, "")
        yield _build_series_row("Wall thickness", position.wall or {}, "thickness_m", 1e3, 2, "mm")


def _build_series_row(
    quantity_name: str, columns: Columns, name: str, factor: float, digits: int, unit: str
) -> Row:
    """Return count, first, last, minimum, maximum, mean, number of poor sets, last standard error.

    ``factor`` converts to ``unit``. Missing values are left out; without values the cells are `NOT_KNOWN`.
    """
    values = [value for value in columns[name] if value is not None]
    if not values:
        return (quantity_name, "0", *[NOT_KNOWN] * 5, "", "")
    errors = [error for error in columns.get(f"standard_error_{name}", ()) if error is not None]
    shown = (values[0], values[-1], min(values), max(values), math.fsum(values) / len(values))
    n_poor = "" if "quality" not in columns else str(sum(quality != "good" for quality in columns["quality"]))
    return (
        quantity_name,
        str(len(values)),
        *(format_quantity(value, factor, digits, unit) for value in shown),
        n_poor,
        format_quantity(errors[-1], factor, digits + 1, unit) if errors else "",
    )
