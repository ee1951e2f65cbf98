"""Comparison of two data folders: all rows and datasets of the same test must be equal.

    python benchmarks/same_data.py FOLDER OTHER [--json]

Names of earlier versions count as current ones (`daq_service.catalogue.earlier_names`). Left out: wall times,
versions, the machine and its readings, what a run cost, values that came later. Exit code 1 where anything
differs.
"""

from __future__ import annotations

import argparse
import json
import sqlite3
import sys
from collections.abc import Iterator, Set
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from daq_service.archive.reader import read_set_file
from daq_service.catalogue.earlier_names import COLUMNS, TOPICS, to_current_row
from daq_service.catalogue.reported_rows import ROW_OF_EVENT

RENAMED_TABLES = TOPICS
RENAMED_COLUMNS = COLUMNS
"""Current names of the columns of each table by their earlier ones; nested keys and values follow."""
ADDED = {"uuid", "site", "interval_low_m", "interval_high_m", "experiment_identifier"}
"""Columns and datasets that came later."""
DERIVED = {"trend_blocks"}
"""Tables that are computed from the others, with a column more or less."""
NUMBER = {"unscheduled_index"}
BY_KEY = {"set_index", "title", "entry_identifier_uuid"}
"""Datasets of an unscheduled set that show its key, which was one number; its rows have the same key."""
TIMELESS = ADDED | {
    "row_crc32",
    "file_sha256",
    "wall_utc_ns",
    "finished_wall_utc_ns",
    "created_utc_ns",
    "solimon_version",
    "configuration_hash",
}
NESTED = {
    "events": ("payload",),
    "alarms": ("proof", "evidence"),
    "baselines": ("readiness", "baseline_quality"),
}
"""Columns with nested keys, by either name."""
OF_THE_RUN = {"cost", "versions", "created_utc_ns"}
"""Parts of an event's payload that describe the run, not the test."""


def rows(folder: Path) -> dict[str, list[dict[str, Any]]]:
    """Return rows of every table, without differences between two runs of one test."""
    with sqlite3.connect(f"file:{folder / 'catalogue.sqlite'}?mode=ro", uri=True) as connection:
        connection.row_factory = sqlite3.Row
        names = [
            name
            for (name,) in connection.execute("select name from sqlite_master where type = 'table'")
            if not name.startswith(("sqlite_", "alembic_")) and name not in DERIVED
        ]
        tables = {
            RENAMED_TABLES.get(name, name): [
                current_values(RENAMED_TABLES.get(name, name), dict(row))
                for row in connection.execute(f"select * from {name} order by 1")
            ]
            for name in sorted(names)
        }
    tables["events"] = [event for event in tables["events"] if event["topic"] != "machine"]
    for event in tables["events"]:
        # An earlier version stored the row again that an event reports; here the row itself is compared.
        payload = {} if event["kind"] in ROW_OF_EVENT else event["payload"]
        event["payload"] = {key: value for key, value in payload.items() if key not in OF_THE_RUN | ADDED}
    return tables


def current_values(table: str, row: dict[str, Any]) -> dict[str, Any]:
    """Return the values of a row by current names, those of JSON columns as objects."""
    for name in NESTED.get(table, ()):
        if row.get(name) is not None:
            row[name] = json.loads(row[name])
    return without_zeros(to_current_row(table, row), TIMELESS)


def without_zeros(row: dict[str, Any], left_out: Set[str] = frozenset()) -> dict[str, Any]:
    """Return a row without the zero of a scheduled set, which earlier versions lack."""
    return {
        name: without_zeros(value) if isinstance(value, dict) else value
        for name, value in row.items()
        if name not in left_out and (not name.endswith("unscheduled_index") or value)
    }


def datasets(folder: Path) -> Iterator[tuple[str, bytes, str]]:
    """Yield name, bytes and attributes of every dataset of every file, except the provenance.

    Truth and settings are compared by record: up to format 1.6 each position has groups of its own for them.
    """
    for path in sorted((folder / "sets").glob("*.h5")):
        found: list[tuple[str, bytes, str]] = []

        def visit(name: str, item: Any, of_file: str = path.name, into: list[Any] = found) -> None:
            if (
                isinstance(item, h5py.Dataset)
                and not name.startswith("entry/provenance")
                and not name.split("/")[1].endswith(("truth", "settings"))
                and name.rpartition("/")[2]
                not in (ADDED | NUMBER | (BY_KEY if of_file.count("_") > 2 else set()))
            ):
                attributes = {key: np.asarray(value).tolist() for key, value in sorted(item.attrs.items())}
                content = np.asarray(item[()])
                # Strings of any length are held as pointers, fixed ones end with zeros up to some length.
                is_text = content.dtype.hasobject or content.dtype.kind == "S"
                data = repr(content.tolist()).encode() if is_text else content.tobytes()
                into.append((f"{of_file}/{name}", data, str(attributes)))

        with h5py.File(path, "r") as file:
            file.visititems(visit)
        facts = [
            (item.sequence, dict(item.truth), dict(item.settings)) for item in read_set_file(path).records
        ]
        yield from [*found, (f"{path.name}/facts", repr(facts).encode(), "")]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folders", nargs=2, type=Path)
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    ours, theirs = options.folders
    differing = []
    tables, other = rows(ours), rows(theirs)
    for name in sorted(tables.keys() | other.keys()):
        if tables.get(name) != other.get(name):
            pairs = zip(tables.get(name, []), other.get(name, []), strict=False)
            first = next(((a, b) for a, b in pairs if a != b), "the number of rows")
            differing.append(f"table {name}: {first}")
    our_data, their_data = list(datasets(ours)), list(datasets(theirs))
    if [name for name, _, _ in our_data] != [name for name, _, _ in their_data]:
        differing.append("the datasets have other names")
    differing += [
        f"dataset {name}"
        for (name, data, attributes), (_, other_data, other_attributes) in zip(
            our_data, their_data, strict=False
        )
        if (data, attributes) != (other_data, other_attributes)
    ]
    n_rows = sum(map(len, tables.values()))
    facts = {"tables": len(tables), "rows": n_rows, "datasets": len(our_data), "differing": differing}
    if options.json:
        print(json.dumps(facts, default=str))
    else:
        print(f"{len(tables)} tables with {n_rows} rows, {len(our_data)} datasets: {len(differing)} differ")
        print("\n".join(str(line)[:1000] for line in differing[:20]))
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
