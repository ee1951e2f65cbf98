"""Commands that show a test."""

from __future__ import annotations

from pathlib import Path

import click

from daq_service.cli.groups import options
from daq_service.cli.groups.options import argument, command, option, repeated

status = command(
    "status",
    "status.command:run_status",
    *options.ONE_TEST_JSON,
    option("--watch", is_flag=True, help="Update every second until Ctrl-C; needs a terminal."),
)
explain = command(
    "explain",
    "offline.evidence.explain:run_explain",
    argument("alarm_id", metavar="ALARM", type=options.IntRange(min=1)),
    options.DATA_DIR_ALONE,
    option("--out", type=options.FOLDER, help="Folder for page and options.JSON; default: a new one here."),
    *options.FILES_JSON,
)
report = command(
    "report",
    "maintenance.report:write_report",
    argument("where", metavar="CONFIG_OR_DATA", type=click.Path(exists=True, path_type=Path)),
    option("--from-h", type=float, help="From this hour on."),
    option("--to-h", type=float, help="Before this hour."),
    option("--out", type=options.FILE, help="Its file; default: report_FOLDER.html here."),
    *options.FILES_JSON,
)
acceptance_report = command(
    "acceptance-report",
    "maintenance.command:run_acceptance_report",
    options.DATA_DIR_ALONE,
    option("--html", type=options.FILE, help="Write it as one printable page with figures."),
    option(
        "--json",
        "to_json",
        is_flag=False,
        flag_value="-",
        metavar="[options.FILE]",
        help="Write it as options.JSON to options.FILE; without one, to standard output.",
    ),
    repeated("--limit", "limits", "NAME=VALUE", "Another limit of a criterion; NAME=off leaves it out."),
    option("--verify", is_flag=True, help="Also check all stored data, as `solimon verify` does."),
    options.OVERWRITE,
    details="The test may still run. Exit code 6: a criterion is not met.",
)
