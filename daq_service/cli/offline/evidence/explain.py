"""``solimon explain``: recompute an alarm and write a page and a JSON file."""

from __future__ import annotations

from pathlib import Path

import click
import orjson

from daq_service.cli.offline.evidence.alarm_page import (
    collect_alarm_facts,
    describe_recomputation,
    render_alarm_page,
)
from daq_service.cli.terminal import print_set_progress
from daq_service.errors import UsageError
from daq_service.processes.data_folder import build_new_folder_path
from daq_service.recording.reassessment.explanation import explain_alarm
from daq_service.shared_file import write_output
from daq_service.web.report.pdf import print_page


def run_explain(
    *, alarm_id: int, data_dir: Path, out: Path | None, pdf: bool, overwrite: bool, as_json: bool
) -> None:
    """Run `solimon explain`: write page (HTML or PDF) and JSON file of an alarm, and print their paths.

    The test's folder is only read. The default ``out`` is a new folder in the working directory.

    Raises
    ------
    UsageError
        There is no such alarm, its features are of another extractor, ``out`` is within the test's folder,
        the files exist, or no browser prints the PDF.
    StorageError
        A set that counts cannot be read, or a file cannot be written.
    """
    folder = out or build_new_folder_path(f"alarm-{alarm_id}")
    if folder.absolute().resolve().is_relative_to(data_dir.absolute().resolve()):
        raise UsageError(f"{folder} lies in the test's own folder; choose another --out")
    endings = ("pdf" if pdf else "html", "json")
    page, facts_file = (folder / f"alarm-{alarm_id}.{ending}" for ending in endings)
    if existing := [path for path in (page, facts_file) if path.exists() and not overwrite]:
        raise UsageError(f"{existing[0]} exists; choose another --out, or replace it with --overwrite")
    found = explain_alarm(data_dir, alarm_id, print_set_progress)
    # Brings matplotlib along, which the rest does not need.
    from daq_service.cli.offline.evidence.figures import draw_alarm_figures

    facts = orjson.dumps(
        {**collect_alarm_facts(found), "files": [str(page), str(facts_file)]},
        option=orjson.OPT_SERIALIZE_NUMPY,
    )
    content = render_alarm_page(found, draw_alarm_figures(found))
    write_output(page, print_page(content, page) if pdf else content)
    write_output(facts_file, facts)
    if as_json:
        click.echo(facts.decode())
        return
    click.echo(f"Alarm {found.alarm.id}: {found.alarm.message}")
    click.echo(describe_recomputation(found))
    click.echo(f"{page}; the values are in {facts_file.name}")
