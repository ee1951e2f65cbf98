"""HTML page of a report."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence

from daq_service.alarms.evidence import build_evidence_sentences
from daq_service.alarms.states import NOT_ASSESSED
from daq_service.alarms.transitions import build_transition
from daq_service.assessment.stored_limits import find_chart_statistic
from daq_service.catalogue.rows import AlarmRow, EventRow
from daq_service.settings.tree import AlarmSettings, NoveltySettings
from daq_service.web.report.contents import MOST_LINES, Columns, Contents, PositionReport
from daq_service.web.templates import NOT_KNOWN, format_quantity, format_significant, render_template
from hardware_drivers.nanoseconds import NS_PER_H

Row = Sequence[str]


def render_report_page(contents: Contents, figures: Mapping[str, str]) -> bytes:
    """Render the HTML page in UTF-8; ``figures`` are SVG elements by position, empty without values.

    Raises jinja2.UndefinedError if the template uses an unknown name.
    """

    def explain_alarm(alarm: AlarmRow) -> list[str]:
        """Return the evidence of an alarm as sentences."""
        return build_evidence_sentences(alarm, contents.baselines)

    def format_hour(utc_ns: int) -> str:
        """Format a UTC time in ns as hour of the test with two decimals."""
        return format_quantity((utc_ns - contents.experiment.epoch_utc_ns) / NS_PER_H)

    return render_template(
        "report.html.j2",
        title=f"Report of the test {contents.experiment.name}",
        contents=contents,
        figures=figures,
        alarm_rule=_list_alarm_rules(
            contents.settings.alarms,
            contents.settings.novelty,
            contents.settings.false_alarms_per_sensor_year(),
        ),
        most_lines=MOST_LINES,
        configuration=json.dumps(contents.experiment.configuration, indent=1, sort_keys=True),
        newest=lambda position: _build_newest_row(position, contents.settings.alarms),
        series=_build_series_rows,
        sentences=explain_alarm,
        history_cells=build_history_cells,
        hour=format_hour,
    )


def build_history_cells(event: EventRow) -> Row:
    """Return kind, states, person and reason of an event of an alarm as table cells.

    Without a person the reason is empty.
    """
    change = build_transition(event)
    states = ", ".join(filter(None, (change["state"], change["suppressed"])))
    # Without a person the reason is the message of the alarm, which the page has anyway.
    reason = change["reason"] or "" if change["author"] else ""
    return (event.kind.replace("_", " "), states.replace("_", " "), change["author"] or "", reason)


def _list_alarm_rules(
    alarms: AlarmSettings, novelty: NoveltySettings, budget: float
) -> list[tuple[str, str]]:
    """Describe the alarm rule and the outlier limit as rows (label, text) of a table.

    ``budget`` is the design false-alarm rate per sensor and year.
    """
    outlier = f"{novelty.limit}, {novelty.false_alarm_rate:g} false alarms a set"
    of_sets = f"at {alarms.k} of {alarms.n} sets"
    if alarms.decides_by != "chart":
        return [("Limit that decides", outlier), ("Alarm", of_sets)]
    by_chart = (
        f"by the chart beyond its limit, made for {budget:g} false alarms a sensor and year, or by a "
        f"cause named WALL; {of_sets} where a baseline of an earlier version has no chart"
    )
    return [
        ("Alarm", by_chart),
        ("Limit of an outlier", f"{outlier}; an outlier alone raises no alarm"),
    ]


def _build_newest_row(position: PositionReport, alarms: AlarmSettings) -> Row:
    """Return the newest value of a position and its limit as table cells.

    A thickness is in mm; else the squared distance D², or the reason why it is missing, and the chart's
    statistic.
    """
    assessment, thickness = position.last.last_assessment, position.last.last_thickness
    if thickness is not None:
        return format_quantity(thickness.thickness_m, 1e3, 3, "mm"), format_quantity(
            position.limit, 1e3, 3, "mm"
        )
    value = f"D² {format_significant(assessment.distance_squared if assessment else None)}"
    if position.state == NOT_ASSESSED and assessment is not None and assessment.reason:
        value = f"not judged: {assessment.reason}"
    limit = format_significant(position.limit)
    if (chart := find_chart_statistic(assessment, alarms)) is None:
        return value, limit
    return f"{value}; chart {format_significant(chart[0])}", f"{limit}; chart {format_significant(chart[1])}"


def _build_series_rows(position: PositionReport) -> Iterator[Row]:
    """Yield for each measured quantity of a position a table row with its statistics over the range."""
    if position.assessments is None:
        yield _build_series_row("Wall thickness", position.values, "thickness_m", 1e3, 4, "mm")
        yield _build_series_row("Lost thickness", position.values, "thickness_loss_m", 1e6, 2, "µm")
    else:
        yield _build_series_row("Time of flight", position.values, "tof_pp_s", 1e6, 3, "µs")
        yield _build_series_row("Amplitude ratio", position.values, "amplitude_ratio", 1.0, 4, "")
        yield _build_series_row("Squared distance", position.assessments, "distance_squared", 1.0, 3, "")


def _build_series_row(
    quantity_name: str, columns: Columns, name: str, factor: float, digits: int, unit: str
) -> Row:
    """Return count, first, last, minimum, maximum, mean and number of poor sets of a quantity as table cells.

    ``factor`` converts to ``unit``. Missing values are left out; without values the cells are `NOT_KNOWN`.
    """
    values = [value for value in columns[name] if value is not None]
    if not values:
        return (quantity_name, "0", *[NOT_KNOWN] * 5, "")
    shown = (values[0], values[-1], min(values), max(values), math.fsum(values) / len(values))
    n_poor = "" if "quality" not in columns else str(sum(quality != "good" for quality in columns["quality"]))
    return (
        quantity_name,
        str(len(values)),
        *(format_quantity(value, factor, digits, unit) for value in shown),
        n_poor,
    )
