"""Write the report as one HTML page with embedded figures."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape

from daq_service.cli.reproduce.comparison import NOT_AVAILABLE, Row
from daq_service.cli.reproduce.item import Table

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #111; max-width: 62rem; margin: 1.5rem auto;
       padding: 0 1rem }
h1 { font-size: 1.5rem }
h2 { font-size: 1.15rem; margin-top: 2.2rem; border-top: 1px solid #ccc; padding-top: .8rem }
table { border-collapse: collapse; width: 100%; font-size: .85rem; margin: .6rem 0 }
th, td { text-align: left; vertical-align: top; padding: .25rem .5rem; border-bottom: 1px solid #ddd }
td.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap }
img { max-width: 100%; height: auto } .note { color: #444; font-size: .9rem }
.missing { color: #8a3d00 } nav a { margin-right: .8rem; white-space: nowrap }
@media print { h2 { break-after: avoid } figure, tr { break-inside: avoid } }
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """One item in the report.

    Attributes
    ----------
    files
        Names of its files in the same folder.
    png
        The picture; empty where there is none.
    table
        Shown in full where there is no picture.
    trouble
        Why it could not be made; empty where it was.
    """

    name: str
    title: str
    shows: str
    files: Sequence[str] = ()
    png: bytes = b""
    table: Table | None = None
    rows: Sequence[Row] = ()
    notes: Sequence[str] = ()
    trouble: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """Contents of the page."""

    title: str
    facts: Mapping[str, str]
    sections: Sequence[Section]
    remarks: Sequence[str] = field(default_factory=tuple)


def report_page(report: Report) -> bytes:
    """Return the HTML of the report."""
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        "<meta name='viewport' content='width=device-width, initial-scale=1'>",
        f"<title>{escape(report.title)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{escape(report.title)}</h1>",
        *(f"<p class='note'>{escape(remark)}</p>" for remark in report.remarks),
        "<table>",
        *(
            f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>"
            for name, value in report.facts.items()
        ),
        "</table><nav>",
        *(f"<a href='#{escape(s.name)}'>{escape(s.name)}</a>" for s in report.sections),
        "</nav>",
        *(_section(section) for section in report.sections),
        "</body></html>\n",
    ]
    return "\n".join(parts).encode()


def _section(section: Section) -> str:
    parts = [f"<section id='{escape(section.name)}'><h2>{escape(section.title)}</h2>"]
    parts.append(f"<p>{escape(section.shows)}</p>")
    if section.trouble:
        parts.append(f"<p class='missing'>{NOT_AVAILABLE}: {escape(section.trouble)}</p>")
    if section.png:
        picture = base64.b64encode(section.png).decode()
        parts.append(
            f"<figure><img alt='{escape(section.title)}' src='data:image/png;base64,{picture}'></figure>"
        )
    elif section.table is not None:
        parts.append(_plain_table(section.table))
    parts += [f"<p class='note'>{escape(note)}</p>" for note in section.notes]
    if section.rows:
        parts.append(_comparison(section.rows))
    if section.files:
        links = ", ".join(f"<a href='{escape(name)}'>{escape(name)}</a>" for name in section.files)
        parts.append(f"<p class='note'>Files beside this page: {links}</p>")
    parts.append("</section>")
    return "\n".join(parts)


def _comparison(rows: Sequence[Row]) -> str:
    parts = [
        (
            "<table><thead><tr><th>quantity</th><th>where</th><th>paper</th><th>ours</th><th>unit</th>"
            "<th>deviation</th><th>cause</th></tr></thead><tbody>"
        )
    ]
    for row in rows:
        ours = escape(row.ours_shown)
        if row.ours is None:
            ours = f"<span class='missing'>{ours}</span>"
        remark = f" <span class='note'>({escape(row.ours_words)})</span>" if row.ours_words else ""
        unit = {"1": "", "us": "µs"}.get(row.unit, row.unit)
        parts.append(
            f"<tr><td>{escape(row.text)}{remark}</td><td>{escape(row.where)}</td>"
            f"<td class='number'>{escape(row.paper_shown)}</td><td class='number'>{ours}</td>"
            f"<td>{escape(unit)}</td><td class='number'>{escape(row.deviation_shown)}</td>"
            f"<td>{escape(row.cause)}</td></tr>"
        )
    return "\n".join([*parts, "</tbody></table>"])


def _plain_table(table: Table) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in table.columns)
    body = [
        "<tr>" + "".join(f"<td>{escape(_cell(value))}</td>" for value in row) + "</tr>"
        for row in zip(*table.columns.values(), strict=True)
    ]
    return "\n".join([f"<table><thead><tr>{head}</tr></thead><tbody>", *body, "</tbody></table>"])


def _cell(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
