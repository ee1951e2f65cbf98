"""Commands that show a test."""

from __future__ import annotations

from pathlib import Path

import click

from daq_service.cli.groups.options import (
    DATA_DIR_ALONE,
    FILE,
    FOLDER,
    JSON,
    ONE_TEST,
    OVERWRITE,
    IntRange,
    argument,
    command,
    option,
    repeated,
)

status = command(
    "status",
    "status.command:run_status",
    *ONE_TEST,
    option("--watch", is_flag=True, help="Update every second until Ctrl-C; needs a terminal."),
    JSON,
)
explain = command(
    "explain",
    "offline.evidence.explain:run_explain",
    argument("alarm_id", metavar="ALARM", type=IntRange(min=1)),
    DATA_DIR_ALONE,
    option("--out", type=FOLDER, help="Folder for page and JSON; default: a new one here."),
    OVERWRITE,
    JSON,
)
report = command(
    "report",
    "maintenance.report:write_report",
    argument("where", metavar="CONFIG_OR_DATA", type=click.Path(exists=True, path_type=Path)),
    option("--from-h", type=float, help="From this hour on."),
    option("--to-h", type=float, help="Before this hour."),
    option("--out", type=FILE, help="Its file; default: report_FOLDER.html here."),
    OVERWRITE,
    JSON,
)
acceptance_report = command(
    "acceptance-report",
    "maintenance.command:run_acceptance_report",
    DATA_DIR_ALONE,
    option("--html", type=FILE, help="Write it as one printable page with figures."),
    option(
        "--json",
        "to_json",
        is_flag=False,
        flag_value="-",
        metavar="[FILE]",
        help="Write it as JSON to FILE; without one, to standard output.",
    ),
    repeated(
        "--limit",
        "limits",
        "NAME=VALUE",
        "Another limit of a criterion; NAME=off leaves it out.",
    ),
    option("--verify", is_flag=True, help="Also check all stored data, as `solimon verify` does."),
    OVERWRITE,
    details="The test may still run. Exit code 6: a criterion is not met.",
)
