"""HTML page of a report."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.metadata import version
from typing import Any

from daq_service.alarms.evidence import evidence_sentences
from daq_service.alarms.states import NOT_ASSESSED
from daq_service.alarms.transitions import transition
from daq_service.assessment.stored_limits import deciding_chart
from daq_service.catalogue.rows import AlarmRow, EventRow
from daq_service.clock import format_utc
from daq_service.settings.tree import Settings
from daq_service.web.report.contents import MOST_LINES, Columns, Contents, PositionReport
from hardware_drivers.methods import PULSE_ECHO
from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S

STYLE = """
@page { size: A4; margin: 16mm 14mm }
:root { --ink: #14181c; --soft: #55606a; --line: #d8dde2 }
* { box-sizing: border-box }
body { font: 14px/1.45 system-ui, sans-serif; color: var(--ink); background: #fff; max-width: 60rem;
       margin: 2rem auto; padding: 0 1.2rem }
header { border-bottom: 3px solid var(--ink); padding-bottom: .6rem }
h1 { font-size: 1.5rem; margin: 0 } h2 { font-size: 1.15rem; margin: 2rem 0 .4rem }
h3 { font-size: 1rem; margin: 1.2rem 0 .3rem }
.note { color: var(--soft); font-size: .88rem }
nav a { margin-right: .9rem }
table { border-collapse: collapse; width: 100%; font-size: .85rem; margin: .4rem 0 }
caption { text-align: left; color: var(--soft); padding-bottom: .2rem }
th, td { text-align: left; vertical-align: top; padding: .2rem .6rem .2rem 0; overflow-wrap: anywhere;
         border-bottom: 1px solid var(--line) }
thead th { border-bottom: 2px solid var(--ink) } tbody th { font-weight: 600; min-width: 10rem }
figure { margin: .6rem 0 } svg { width: 100%; height: auto }
pre { font-size: .75rem; white-space: pre-wrap; overflow-wrap: anywhere }
@media print { body { margin: 0; padding: 0; max-width: none; font-size: 11px } nav { display: none }
  h2, h3 { break-after: avoid } tr, figure, article { break-inside: avoid } }
"""
NOT_KNOWN = "not known"

Row = Sequence[str]


def page(contents: Contents, figures: Mapping[str, str]) -> bytes:
    """Return the HTML page; ``figures`` are SVG elements by position, empty without values."""
    title = f"Report of the test {contents.experiment.name}"
    sections = {
        "what": ("What was tested", _identity_tables(contents)),
        "now": ("How it stands", _state_table(contents)),
        "positions": (
            "Positions",
            [
                _position_article(contents, position, figures[position.name])
                for position in contents.positions
            ],
        ),
        "gaps": ("Gaps", _gap_table(contents)),
        "alarms": ("Alarms", _alarm_articles(contents)),
        "annotations": ("Annotations", _annotation_table(contents)),
        "orders": ("Orders", _command_table(contents)),
        **({} if contents.audit is None else {"audit": ("Audit", _audit_table(contents))}),
        "configuration": ("Configuration", _configuration(contents)),
    }
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        "<meta name='viewport' content='width=device-width, initial-scale=1'>",
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>",
        f"<header><h1>{escape(title)}</h1><p class='note'>{escape(_made_note(contents))}</p></header><nav>",
        *(f"<a href='#{name}'>{escape(heading)}</a>" for name, (heading, _) in sections.items()),
        "</nav><main>",
    ]
    for name, (heading, content) in sections.items():
        parts += [f"<section id='{name}'><h2>{escape(heading)}</h2>", *content, "</section>"]
    return "\n".join([*parts, "</main></body></html>\n"]).encode()


def quantity(value: float | None, factor: float, digits: int, unit: str) -> str:
    """Return a value as text with its unit."""
    if value is None:
        return NOT_KNOWN
    return f"{value * factor:.{digits}f} {unit}".rstrip()


def significant(value: float | None) -> str:
    """Return a number as text with four significant digits."""
    return NOT_KNOWN if value is None else f"{value:.4g}"


def _made_note(contents: Contents) -> str:
    return (
        f"Hours {contents.from_h:.2f} to {min(contents.to_h, contents.now_h):.2f} of the test; made "
        f"{format_utc(contents.wall_utc_ns, 0)} at hour {contents.now_h:.2f} "
        f"({format_utc(contents.now_utc_ns, 0)} on the {contents.experiment.clock} clock). "
        f"{contents.recorder}."
    )


def _identity_tables(contents: Contents) -> list[str]:
    experiment, settings = contents.experiment, contents.settings
    rows = [
        ("Test", experiment.name),
        ("Hour 0", f"{format_utc(experiment.epoch_utc_ns, 0)} ({experiment.clock} clock)"),
        ("Rig", settings.rig.kind),
        *((f"Rig, {name}", str(value)) for name, value in contents.rig_identity.items()),
        ("Configuration", f"SHA-256 {experiment.configuration_hash}"),
        ("Begun by", f"solimon {experiment.solimon_version}"),
        ("Reported by", f"solimon {version('solimon')}"),
        ("Extractor", ", ".join(contents.extractors) or NOT_KNOWN),
        ("Files of sets", f"{contents.n_files} in the range"),
        ("Digest of their names and SHA-256", contents.files_sha256),
        *_alarm_rule_rows(settings),
    ]
    position_rows = [
        (
            position.name,
            position.label,
            position.method.replace("_", " "),
            position.serial_number or NOT_KNOWN,
        )
        for position in contents.positions
    ]
    return [
        table("Identity", (), rows),
        table("Transducers", ("Position", "What it is", "Method", "Serial number"), position_rows),
    ]


def _alarm_rule_rows(settings: Settings) -> list[Row]:
    outlier = f"{settings.novelty.limit}, {settings.novelty.false_alarm_rate:g} false alarms a set"
    of_sets = f"at {settings.alarms.k} of {settings.alarms.n} sets"
    if settings.alarms.decides_by != "chart":
        return [("Limit that decides", outlier), ("Alarm", of_sets)]
    budget = settings.false_alarms_per_sensor_year()
    by_chart = (
        f"by the chart beyond its limit, made for {budget:g} false alarms a sensor and year, or by a "
        f"cause named WALL; {of_sets} where a baseline of an earlier version has no chart"
    )
    return [
        ("Alarm", by_chart),
        ("Limit of an outlier", f"{outlier}; an outlier alone raises no alarm"),
    ]


def _state_table(contents: Contents) -> list[str]:
    pause_note = (
        [] if contents.held is None else [f"<p><strong>Paused: {escape(contents.held)}.</strong></p>"]
    )
    written = (
        "nothing is stored" if contents.wall_age_s is None else f"{contents.wall_age_s:.0f} s before this"
    )
    rows = []
    for position in contents.positions:
        last = position.last
        assessment, measured = last.last_assessment, last.last_feature or last.last_thickness
        quality = NOT_KNOWN if measured is None else measured.quality
        if last.last_thickness is not None:
            value = quantity(last.last_thickness.thickness_m, 1e3, 3, "mm")
            limit = quantity(position.limit, 1e3, 3, "mm")
        else:
            value = f"D² {significant(assessment.distance_squared if assessment else None)}"
            if position.state == NOT_ASSESSED and assessment is not None and assessment.reason:
                value = f"not judged: {assessment.reason}"
            limit = significant(position.limit)
            if chart := deciding_chart(assessment, contents.settings):
                value, limit = (
                    f"{text}; chart {significant(chart_value)}"
                    for text, chart_value in zip((value, limit), chart, strict=True)
                )
        age = (
            NOT_KNOWN
            if position.age_h is None
            else f"{position.age_h:.2f} h{', stale' if position.stale else ''}"
        )
        data_h = NOT_KNOWN if position.data_h is None else f"{position.data_h:.2f}"
        rows.append(
            (
                position.name,
                position.state.replace("_", " "),
                value,
                limit,
                quality,
                data_h,
                age,
                str(len(last.active_alarms)),
            )
        )
    head = ("Position", "State", "Newest value", "Limit", "Quality", "Of hour", "Age", "Alarms that stand")
    return [*pause_note, f"<p class='note'>Last written {written}.</p>", table("Newest values", head, rows)]


def _position_article(contents: Contents, position: PositionReport, figure: str) -> str:
    states = ", ".join(f"{number} {state}" for state, number in position.states.items()) or "none"
    parts = [
        f"<article><h3>Position {escape(position.name)}</h3>",
        f"<p class='note'>Sets in the range: {states}.</p>",
    ]
    shaded = "Gaps are shaded, dashed lines are alarms, dotted ones annotations."
    if figure:
        quantities = (
            "wall thickness"
            if position.method == PULSE_ECHO
            else "time of flight, amplitude ratio and squared distance"
        )
        label = (
            f"Position {position.name}: {quantities} over the hours of the test; "
            "the numbers are in the table below."
        )
        parts.append(
            f"<figure role='img' aria-label='{escape(label)}'>{figure}</figure><p class='note'>{shaded}</p>"
        )
    else:
        parts.append("<p>There is no value in this range.</p>")
    if position.method == PULSE_ECHO:
        rows = [_series_row("Wall thickness", position.values, "thickness_m", 1e3, 4, "mm")]
        rows += [_series_row("Lost thickness", position.values, "thickness_loss_m", 1e6, 2, "µm")]
        last, label = position.last.last_thickness, NOT_KNOWN
        if last is not None and last.interval_low_m is not None and last.interval_high_m is not None:
            label = f"{1e3 * last.interval_low_m:.4f} to {1e3 * last.interval_high_m:.4f} mm"
        parts.append(table("Thickness", SERIES, rows))
        parts.append(f"<p>95 % interval of the newest reading: {label}.</p>")
    else:
        assert position.assessments is not None, "these have them"
        assessed = [outlier for outlier in position.assessments["outlier"] if outlier is not None]
        rows = [
            _series_row("Time of flight", position.values, "tof_pp_s", 1e6, 3, "µs"),
            _series_row("Amplitude ratio", position.values, "amplitude_ratio", 1.0, 4, ""),
            _series_row("Squared distance", position.assessments, "distance_squared", 1.0, 3, ""),
        ]
        parts.append(table("Features and distance", SERIES, rows))
        parts.append(f"<p>{sum(assessed)} outliers of {len(assessed)} judged sets; "
                     f"{sum(position.assessments['in_baseline'])} sets of the baseline.</p>")  # fmt: skip
    return "\n".join([*parts, "</article>"])


SERIES = ("Quantity", "Sets", "First", "Last", "Least", "Greatest", "Mean", "Not of good quality")


def _series_row(
    quantity_name: str, columns: Columns, name: str, factor: float, digits: int, unit: str
) -> Row:
    values = [value for value in columns[name] if value is not None]
    if not values:
        return (quantity_name, "0", *[NOT_KNOWN] * 5, "")
    shown = (values[0], values[-1], min(values), max(values), math.fsum(values) / len(values))
    n_poor = "" if "quality" not in columns else str(sum(quality != "good" for quality in columns["quality"]))
    return (
        quantity_name,
        str(len(values)),
        *(quantity(value, factor, digits, unit) for value in shown),
        n_poor,
    )


def _gap_table(contents: Contents) -> list[str]:
    rows = [
        (
            gap.position,
            gap.state,
            gap.cause or NOT_KNOWN,
            f"{gap.from_h:.2f}",
            f"{gap.to_h:.2f}",
            str(gap.n_sets),
        )
        for gap in contents.gaps
    ]
    head = ("Position", "State", "Cause", "First hour", "Last hour", "Sets")
    return [
        table("Sets that were missed or lack something", head, rows, "No set of the range lacks anything.")
    ]


def _alarm_articles(contents: Contents) -> list[str]:
    if not contents.alarms:
        return ["<p>No alarm was raised or stood in this range.</p>"]
    return [_alarm_article(contents, row) for row in contents.alarms]


def _alarm_article(contents: Contents, row: AlarmRow) -> str:
    subject = "The test as a whole" if row.position is None else f"Position {row.position}"
    acknowledged_by = row.acknowledged_by or "nobody"
    note = f", {row.note}" if row.note else ""
    description = (
        f"Raised at hour {row.raised_h:.2f}, now {row.state.replace('_', ' ')}; "
        f"acknowledged by {acknowledged_by}{note}"
    )
    if row.suppressed:
        description += f"; {row.suppressed.replace('_', ' ')} by {row.suppressed_by}, {row.suppressed_reason}"
    history = [_history_row(contents, event) for event in contents.history.get(row.id or 0, ())]
    evidence = [(name, plain_text(value)) for name, value in row.evidence.items()]
    return "\n".join(
        [
            f"<article><h3>{escape(subject)}: {escape(row.kind.replace('_', ' '))}, {row.priority}</h3>",
            f"<p>{escape(row.message)}</p>",
            f"<p class='note'>{escape(description)}.</p>",
            "<ul>",
            *(f"<li>{escape(sentence)}</li>" for sentence in evidence_sentences(row, contents.baselines)),
            "</ul>",
            table("Evidence, as stored", (), evidence),
            table("History", ("Hour", "What", "State", "By", "Why"), history, "No event tells of it."),
            "</article>",
        ]
    )


def _history_row(contents: Contents, event: EventRow) -> Row:
    change = transition(event)
    states = ", ".join(filter(None, (change["state"], change["suppressed"])))
    return (
        _hour_text(contents, event.utc_ns),
        event.kind.replace("_", " "),
        states.replace("_", " "),
        change["who"] or "",
        (change["why"] or "") if change["who"] else "",  # otherwise the message of the alarm, shown above
    )


def _hour_text(contents: Contents, utc_ns: int) -> str:
    return f"{(utc_ns - contents.experiment.epoch_utc_ns) / NS_PER_H:.2f}"


def _annotation_table(contents: Contents) -> list[str]:
    rows = [
        (
            f"{row.from_h:.2f}",
            f"{row.to_h:.2f}",
            row.position or "the whole test",
            row.text,
            f"{row.author}, at hour {_hour_text(contents, row.written_utc_ns)}",
            f"{row.withdrawn_by}, at hour {_hour_text(contents, row.withdrawn_utc_ns)}"
            if row.withdrawn_utc_ns is not None
            else "",
        )
        for row in contents.annotations
    ]
    head = ("From hour", "To hour", "Position", "Text", "Written by", "Withdrawn by")
    caption = f"Of any hour of the range, the newest {MOST_LINES} at most"
    return [table(caption, head, rows, "Nobody noted anything of this range.")]


def _command_table(contents: Contents) -> list[str]:
    rows = [
        (
            format_utc(row.wall_utc_ns, 0),
            row.author,
            row.kind.replace("_", " "),
            plain_text(row.arguments),
            row.state,
            row.result or "",
        )
        for row in contents.orders
    ]
    head = ("Given (computer's clock)", "By", "Order", "With", "State", "What came of it")
    return [table(f"The newest {MOST_LINES} at most", head, rows, "No order was given.")]


def _audit_table(contents: Contents) -> list[str]:
    rows = [
        (
            *(
                format_utc(entry.utc_ns // NS_PER_S * NS_PER_S, 0),
                entry.who or "nobody",
                entry.role,
                entry.source,
            ),
            *(entry.what.replace("_", " "), entry.result, entry.why),
        )
        for entry in contents.audit or ()
    ]
    head = ("When", "Who", "Role", "From", "What", "Result", "Why")
    return [table(f"The newest {MOST_LINES} at most, newest first", head, rows, "Nothing was asked for yet.")]


def _configuration(contents: Contents) -> list[str]:
    text = json.dumps(contents.experiment.configuration, indent=1, sort_keys=True)
    return ["<p class='note'>As the test was begun.</p>", f"<pre>{escape(text)}</pre>"]


def plain_text(value: Any) -> str:
    """Return any value of a row as text."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {plain_text(item)}" for name, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(plain_text, value))
    return significant(value) if isinstance(value, float) or value is None else str(value)


def table(caption: str, head: Row, rows: Iterable[Row], empty: str = "") -> str:
    """Return an HTML table with row headings; without a head it is a list of names and values."""
    lines = [
        f"<tr><th scope='row'>{escape(first)}</th>"
        + "".join(f"<td>{escape(cell)}</td>" for cell in cells)
        + "</tr>"
        for first, *cells in rows
    ]
    if not lines:
        return f"<p>{escape(empty)}</p>" if empty else ""
    columns = "".join(f"<th scope='col'>{escape(name)}</th>" for name in head)
    top = f"<thead><tr>{columns}</tr></thead>" if head else ""
    return f"<table><caption>{escape(caption)}</caption>{top}<tbody>{''.join(lines)}</tbody></table>"
