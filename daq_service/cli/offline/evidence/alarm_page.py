"""Write an explained alarm as one self-contained HTML page without scripts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from html import escape
from importlib.metadata import version
from typing import Any

from daq_service.alarms.evidence import evidence_sentences
from daq_service.alarms.guidance import GUIDANCE
from daq_service.alarms.transitions import transition
from daq_service.catalogue.rows import values
from daq_service.cli.offline.evidence.figures import Picture
from daq_service.clock import format_utc
from daq_service.recording.reassessment.changes import NOT_COMPARED
from daq_service.recording.reassessment.explanation import Explained, Recomputed
from daq_service.web.report.page import STYLE, plain_text, table

STATE = "averages"
"""Internal state of chart and diagnosis: only in the JSON."""


def title_of(found: Explained) -> str:
    """Return the title of the alarm."""
    where = f" at position {found.alarm.position}" if found.alarm.position else ""
    return f"Alarm {found.alarm.id}: {found.alarm.kind.replace('_', ' ')}{where}"


def recomputation_text(found: Explained) -> str:
    """Describe the result of the recomputation."""
    recomputed = found.again
    if recomputed is None:
        return f"This alarm is not recomputed: {found.why_not}. It is told as it is stored."
    read = f"{recomputed.n_records} records of {recomputed.n_sets} sets were judged again"
    if found.agrees:
        return (
            f"{read}, and the same set raises the same alarm: features, baseline, limits and assessments are "
            "what is stored, to the last digit."
        )
    same = any(one.set_index == found.alarm.raised_set_index for one in recomputed.raised)
    others = ", ".join(f"set {one.set_index}" for one in recomputed.raised)
    elsewhere = f"it is raised with {others}" if others else "no set raises it"
    then = "the same set raises it" if same else elsewhere
    return (
        f"{read}, and {then}; but what is stored differs in the {len(recomputed.differences)} points below."
    )


def page_of(found: Explained, pictures: Sequence[Picture]) -> bytes:
    """Return the HTML page."""
    alarm, title = found.alarm, title_of(found)
    sections = {
        "What was found": _finding_section(found),
        "The picture": [_figure(picture) for picture in pictures],
        "Does it come out again?": _recomputation_section(found),
        "What to do first": _guidance(alarm.kind),
        "Its history": [_history(found)],
        "Evidence, as stored": [table("", (), _rows(alarm.evidence))],
    }
    introduction = (
        f"Raised at hour {alarm.raised_h:.2f} ({format_utc(alarm.raised_utc_ns, 0)}) of the test "
        f"{found.experiment.name}; priority {alarm.priority}, now {alarm.state.replace('_', ' ')}. "
        f"Explained by solimon {version('solimon')}."
    )
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        "<meta name='viewport' content='width=device-width, initial-scale=1'>",
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>",
        f"<header><h1>{escape(title)}</h1><p class='note'>{escape(introduction)}</p></header><main>",
    ]
    for heading, content in sections.items():
        if content:
            parts += [f"<section><h2>{escape(heading)}</h2>", *content, "</section>"]
    return "\n".join([*parts, "</main></body></html>\n"]).encode()


def facts_of(found: Explained) -> dict[str, Any]:
    """Return all contents of the page, and the rows behind it, as plain_text values."""
    recomputed, guidance = found.again, GUIDANCE.get(found.alarm.kind)
    return {
        "test": found.experiment.name,
        "configuration_hash": found.experiment.configuration_hash,
        "begun_by": found.experiment.solimon_version,
        "explained_by": version("solimon"),
        "alarm": values(found.alarm),
        "sentences": _sentences(found),
        "guidance": None if guidance is None else asdict(guidance),
        "history": [transition(event) for event in found.history],
        "agrees": found.agrees,
        "why_not_recomputed": found.why_not or None,
        "description": recomputation_text(found),
        "recomputed": None if recomputed is None else _facts_of(recomputed),
    }


def _facts_of(recomputed: Recomputed) -> dict[str, Any]:
    """Return the recomputed values."""
    pulses = recomputed.pulses
    return {
        "n_sets": recomputed.n_sets,
        "n_records": recomputed.n_records,
        "raised": [asdict(one) for one in recomputed.raised],
        "differences": [asdict(one) for one in recomputed.differences],
        "baseline": None if recomputed.baseline is None else values(recomputed.baseline),
        "assessments": [values(row) for row in recomputed.assessments],
        "measured": [values(row) for row in recomputed.measured],
        "shots_without_psw": [{"set_index": index, "n": n} for index, n in recomputed.silent.items()],
        "pulses": None if pulses is None else asdict(pulses),
    }


def _sentences(found: Explained) -> list[str]:
    """Return the evidence in sentences."""
    baseline = None if found.again is None else found.again.baseline
    return evidence_sentences(found.alarm, {} if baseline is None else {baseline.id or 0: baseline})


def _finding_section(found: Explained) -> list[str]:
    """Return the HTML of the alarm's message and evidence."""
    message = found.alarm.message
    return [
        f"<p><strong>{escape(message[:1].upper() + message[1:])}</strong></p>",
        *(f"<p>{escape(sentence)}</p>" for sentence in _sentences(found)),
    ]


def _figure(picture: Picture) -> str:
    """Return the HTML of a figure."""
    label = escape(picture.description, quote=True)
    return (
        f"<figure role='img' aria-label='{label}'>{picture.svg}</figure>"
        f"<p class='note'>{escape(picture.description)}</p>"
    )


def _recomputation_section(found: Explained) -> list[str]:
    """Return the HTML of the recomputation's result."""
    parts = [f"<p>{escape(recomputation_text(found))}</p>"]
    recomputed = found.again
    if recomputed is None:
        return parts
    rows = [
        (
            f"{one.table} {one.column}",
            str(one.n_rows),
            str(one.first_set_index),
            plain_text(one.stored),
            plain_text(one.again),
        )
        for one in recomputed.differences
    ]
    head = ("What", "Sets", "First set", "Stored", "Recomputed")
    parts.append(table("Values are those of the first set that differs", head, rows))
    if assessment := next(
        (r for r in recomputed.assessments if r.set_index == found.alarm.raised_set_index), None
    ):
        row = {
            name: value for name, value in values(assessment).items() if name not in (*NOT_COMPARED, STATE)
        }
        parts.append(table(f"Verdict of set {assessment.set_index}, recomputed", (), _rows(row)))
    return parts


def _rows(facts: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return name and value of all non-empty facts."""
    return [
        (
            name,
            plain_text(
                {k: v for k, v in value.items() if v is not None} if isinstance(value, Mapping) else value
            ),
        )
        for name, value in facts.items()
        if value is not None
    ]


def _guidance(kind: str) -> list[str]:
    """Return the HTML of the guidance for a kind of alarm."""
    if (guidance := GUIDANCE.get(kind)) is None:
        return []
    rows = [
        ("It says", guidance.meaning),
        ("It does not say", guidance.limitations),
        ("Whom to call", guidance.contact),
    ]
    return [
        f"<ol>{''.join(f'<li>{escape(step)}</li>' for step in guidance.checks)}</ol>",
        table("", (), rows),
    ]


def _history(found: Explained) -> str:
    """Return the HTML of the alarm's events."""
    rows = []
    for event in found.history:
        change = transition(event)
        rows.append(
            (
                format_utc(event.utc_ns, 0),
                event.kind.replace("_", " "),
                (change["state"] or "").replace("_", " "),
                change["who"] or "",
                (change["why"] or "") if change["who"] else "",
            )
        )
    return table("", ("When", "What", "State", "By", "Why"), rows, "No event tells of it.")
