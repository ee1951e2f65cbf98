"""Comparison of two data folders: all rows and datasets of the same test must be equal.

    python benchmarks/same_data.py FOLDER OTHER [--renamed TABLE.json] [--json]
    python benchmarks/same_data.py CHECKOUT OTHER --hours H [--renamed TABLE.json] [--json]

With ``--hours`` the arguments are two checkouts, and each runs ``solimon demo`` for so many hours first. Left
out: wall times, versions, the machine and its readings, and what a run cost. ``--renamed`` names a JSON file
with the new name of each old table, column or dataset: ``{"verdicts": "assessments"}``. Exit code 1 where
anything differs.
"""

from __future__ import annotations

import argparse
import json
import os
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

TIMELESS = {"wall_utc_ns", "finished_wall_utc_ns", "created_utc_ns", "solimon_version", "configuration_hash"}
SUMS = {"row_crc32", "file_sha256"}
"""Checksums: they cover omitted values too, and their content is compared itself."""
OF_THE_RUN = {"cost", "versions", "created_utc_ns"}
"""Parts of an event's payload that describe the run, not the test."""


def rows(folder: Path) -> dict[str, list[dict[str, Any]]]:
    """Return rows of every table, without differences between two runs of one test."""
    with sqlite3.connect(f"file:{folder / 'catalogue.sqlite'}?mode=ro", uri=True) as connection:
        connection.row_factory = sqlite3.Row
        names = [
            name
            for (name,) in connection.execute("select name from sqlite_master where type = 'table'")
            if not name.startswith(("sqlite_", "alembic_"))
        ]
        tables = {
            name: [
                {key: row[key] for key in row.keys() if key not in TIMELESS | SUMS}  # noqa: SIM118 sqlite3.Row iterates values
                for row in connection.execute(f"select * from {name} order by 1")
            ]
            for name in sorted(names)
        }
    tables["events"] = [event for event in tables["events"] if event["topic"] != "machine"]
    for event in tables["events"]:
        payload = json.loads(event["payload"])
        event["payload"] = {key: value for key, value in payload.items() if key not in OF_THE_RUN}
    return tables


def datasets(folder: Path) -> Iterator[tuple[str, bytes, str]]:
    """Yield name, bytes and attributes of every dataset of every file, except the provenance."""
    for path in sorted((folder / "sets").glob("*.h5")):
        found: list[tuple[str, bytes, str]] = []

        def visit(name: str, item: Any, of_file: str = path.name, into: list[Any] = found) -> None:
            if isinstance(item, h5py.Dataset) and not name.startswith("entry/provenance"):
                attributes = {key: np.asarray(value).tolist() for key, value in sorted(item.attrs.items())}
                content = np.asarray(item[()])
                # Strings of any length are held as pointers, which no two runs share.
                data = repr(content.tolist()).encode() if content.dtype.hasobject else content.tobytes()
                into.append((f"{of_file}/{name}", data, str(attributes)))

        with h5py.File(path, "r") as file:
            file.visititems(visit)
        yield from found


def renamed(value: Any, names: Mapping[str, str]) -> Any:
    """Replace keys, and texts that are complete names, by their new names."""
    if isinstance(value, dict):
        return {names.get(key, key): renamed(part, names) for key, part in value.items()}
    if isinstance(value, list):
        return [renamed(part, names) for part in value]
    return names.get(value, value) if isinstance(value, str) else value


def run_demo(checkout: Path, hours: float, folder: Path) -> Path:
    """Run the demonstration of a checkout with this Python; return its data folder."""
    command = [sys.executable, "-m", "daq_service.cli", "demo", "--exit", "--no-web", "--json"]
    subprocess.run(
        [*command, "--hours", str(hours), "--data-dir", str(folder)],
        cwd=checkout,
        env=os.environ | {"PYTHONPATH": str(checkout.absolute())},
        check=True,
        capture_output=True,
    )
    return folder


def differences(ours: Path, theirs: Path, names: Mapping[str, str]) -> tuple[dict[str, int], list[str]]:
    """Return the numbers of compared items and a list of differences."""
    differing = []
    tables, other = renamed(rows(ours), names), renamed(rows(theirs), names)
    for name in sorted(tables.keys() | other.keys()):
        if tables.get(name) != other.get(name):
            pairs = zip(tables.get(name, []), other.get(name, []), strict=False)
            first = next(((a, b) for a, b in pairs if a != b), "the number of rows")
            differing.append(f"table {name}: {first}")
    our_data, their_data = (
        {
            "/".join(names.get(part, part) for part in name.split("/")): rest
            for name, *rest in datasets(folder)
        }
        for folder in (ours, theirs)
    )
    differing += [
        f"dataset {name}"
        for name in sorted(our_data.keys() | their_data.keys())
        if our_data.get(name) != their_data.get(name)
    ]
    counted = {"tables": len(tables), "rows": sum(map(len, tables.values())), "datasets": len(our_data)}
    return counted, differing


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folders", nargs=2, type=Path)
    parser.add_argument("--hours", type=float, help="run two checkouts for so many hours first")
    parser.add_argument("--renamed", type=Path, help="JSON file: old name to new name")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    names = {} if options.renamed is None else json.loads(options.renamed.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as scratch:
        folders = options.folders
        if options.hours is not None:
            folders = [run_demo(one, options.hours, Path(scratch) / f"{k}") for k, one in enumerate(folders)]
        counted, differing = differences(*folders, names)
    if options.json:
        print(json.dumps({**counted, "differing": differing}, default=str))
    else:
        counts = f"{counted['tables']} tables with {counted['rows']} rows, {counted['datasets']} datasets"
        print(f"{counts}: {f'{len(differing)} differ' if differing else 'OK'}")
        print("\n".join(str(line)[:1000] for line in differing[:20]))
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
