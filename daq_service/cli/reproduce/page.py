"""Write the report as one HTML page with embedded figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from daq_service.cli.reproduce.comparison import NOT_AVAILABLE, Row
from daq_service.cli.reproduce.item import Table
from daq_service.web.templates import render


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
    return render(
        "reproduction.html.j2",
        title=report.title,
        run_facts=report.facts,
        remarks=report.remarks,
        sections=report.sections,
        not_available=NOT_AVAILABLE,
    )
