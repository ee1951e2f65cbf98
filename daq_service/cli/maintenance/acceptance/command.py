"""Run ``acceptance-report``: write the acceptance report for a terminal, as a page, as JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import click
from pydantic import ValidationError

from daq_service.cli.maintenance.acceptance.contents import AcceptanceReport, build_report, report_to_json
from daq_service.cli.maintenance.acceptance.criteria import parse_limits
from daq_service.cli.maintenance.acceptance.evidence import read_evidence
from daq_service.cli.maintenance.acceptance.page import format_limit, format_quantity, render_report
from daq_service.cli.maintenance.export import refuse_unsafe_target
from daq_service.cli.maintenance.verify import verify_folder
from daq_service.errors import EXIT_NOT_MET, EXIT_OK, StorageError
from daq_service.processes.data_folder import require_data_folder
from daq_service.processes.installation import require_extras
from daq_service.shared_file import write_output

STANDARD_OUTPUT = "-"


def write_acceptance_report(
    *,
    data_dir: Path,
    html: Path | None,
    to_json: str | None,
    limits: Sequence[str],
    verify: bool,
    overwrite: bool,
    progress: Callable[[int, int], None],
) -> int:
    """Write the acceptance report of a folder; return 6 if it does not pass, 0 if it does.

    Prints it as lines, or as JSON if ``to_json`` is ``-``; writes the HTML page and a JSON file where given.
    ``progress`` receives the numbers of checked and of all files during ``verify``.

    Raises
    ------
    UsageError
        There is no test in the folder, no such limit, or a file to be written exists or is among the test's;
        MissingExtraError: a page is asked for without the extra ``report``.
    StorageError
        The catalogue or its configuration cannot be read, or a file cannot be written.
    """
    criteria = parse_limits(limits)
    if html is not None:
        require_extras("report")
    json_file = None if to_json in (None, STANDARD_OUTPUT) else Path(str(to_json))
    require_data_folder(data_dir)
    for target in filter(None, (html, json_file)):
        refuse_unsafe_target(data_dir, target, overwrite=overwrite)
    try:
        report = build_report(
            read_evidence(data_dir, verify_folder(data_dir, progress) if verify else None), criteria
        )
    except ValidationError as error:
        raise StorageError(
            f"{data_dir} keeps a configuration that this version does not know: {error}; use the one "
            "that recorded it"
        ) from error
    if html is not None:
        from daq_service.cli.maintenance.acceptance.figures import draw_series

        pictures = {item.name: draw_series(item, report.gaps) for item in report.series if item.hours}
        write_output(html, render_report(report, pictures))
    text = json.dumps(report_to_json(report), allow_nan=False)
    if json_file is not None:
        write_output(json_file, f"{text}\n".encode())
    click.echo(text if to_json == STANDARD_OUTPUT else "\n".join(_format_report(report)))
    return EXIT_OK if report.outcome == "pass" else EXIT_NOT_MET


def _format_report(report: AcceptanceReport) -> list[str]:
    """Format the comparisons of a report as aligned lines, followed by the notes and the outcome."""
    rows = [
        (item.state, item.quantity.text, format_limit(item), format_quantity(item.quantity), item.reason)
        for item in report.comparisons
    ]
    widths = [max(len(row[n]) for row in rows) for n in range(4)]
    lines = [
        "  ".join([*(cell.ljust(width) for cell, width in zip(row, widths, strict=False)), row[4]]).rstrip()
        for row in rows
    ]
    return [*lines, *(f"note: {note}" for note in report.notes), f"outcome: {report.outcome}"]
