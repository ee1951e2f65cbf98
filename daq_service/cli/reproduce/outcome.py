"""Results of a reproduction: facts, report, JSON file, and the table for a terminal."""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypedDict

import click

from daq_service.cli.reproduce.comparison import AGREEMENTS, NOT_AVAILABLE, Row
from daq_service.cli.reproduce.diagnosis import fill_numbers
from daq_service.cli.reproduce.evidence import Evidence
from daq_service.cli.reproduce.item import Item, Table
from daq_service.cli.reproduce.output import RECORD, REPORT
from daq_service.cli.reproduce.summary import assess_claims, count_values
from daq_service.recording.provenance import PACKAGES
from daq_service.shared_file import write_output
from daq_service.web.templates import render_template

TITLE = "The paper's evaluation, reproduced"


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """One item in the report.

    Attributes
    ----------
    files
        Names of its files in the same folder.
    png
        The figure; empty where there is none.
    table
        Shown in full.
    numbers
        Ours by name, those of `rows` among them.
    trouble
        Why it could not be made; empty where it was.
    """

    item: Item
    files: Sequence[str] = ()
    png: bytes = b""
    table: Table | None = None
    rows: Sequence[Row] = ()
    notes: Sequence[str] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)
    trouble: str = ""


class Facts(TypedDict):
    """Facts of a run; None before it has a test."""

    seed: int | None
    configuration_hash: str | None
    test: str | None
    origin: str | None
    data_dir: str | None
    versions: dict[str, str]
    machine: str


@dataclass(slots=True)
class Outcome:
    """Results of a reproduction so far."""

    out: Path
    started_s: float
    facts: Facts
    sections: list[Section] = field(default_factory=list)
    slips: list[dict[str, object]] = field(default_factory=list)

    @property
    def rows(self) -> list[Row]:
        """Return the comparison rows of all finished items, in order."""
        return [row for section in self.sections for row in section.rows]


def collect_run_facts() -> Facts:
    """Return the facts of a reproduction before it has a test: package versions and machine."""
    return {
        "seed": None,
        "configuration_hash": None,
        "test": None,
        "origin": None,
        "data_dir": None,
        "versions": {
            **{name: version(name) for name in (*PACKAGES, "numba", "matplotlib")},
            "python": platform.python_version(),
        },
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
    }


def add_test_facts(facts: Facts, test: Evidence, origin: str) -> None:
    """Add name, counts, seed, configuration, folder and origin of the test to the facts, in place."""
    facts |= {
        "seed": test.seed,
        "configuration_hash": test.configuration_hash,
        "test": f"{test.name}: {test.counts['sets']} sets to hour {test.last_h:g}, {test.counts['shots']} "
        f"strikes, {test.counts['pulse_echo_records']} echoes, {test.counts['missed_sets']} sets missed "
        f"({'twin' if test.from_twin else 'real specimen'}, recorded by solimon {test.solimon_version})",
        "origin": origin,
        "data_dir": str(test.folder),
    }


def write_outcome(run: Outcome, names: Sequence[str], *, interrupted: bool) -> dict[str, object]:
    """Write the report and the JSON file, and return the contents of the latter.

    Raises StorageUnavailableError if the disk refuses.

    Parameters
    ----------
    names
        Of the items that were wanted; those that are not made are named as missing.
    """
    finished = {section.item.name for section in run.sections}
    missing = [name for name in names if name not in finished]
    elapsed_s = time.monotonic() - run.started_s
    numbers = {section.item.name: section.numbers for section in run.sections}
    run.sections = [
        replace(section, rows=[replace(row, cause=fill_numbers(row.cause, numbers)) for row in section.rows])
        for section in run.sections
    ]
    counts, claims = count_values(run.rows), assess_claims(run.rows)
    result: dict[str, object] = {
        **run.facts,
        "elapsed_s": round(elapsed_s, 3),
        "interrupted": interrupted,
        "out": str(run.out),
        "report": str(run.out / REPORT),
        "items": {
            section.item.name: {"files": list(section.files), "not_available": section.trouble or None}
            for section in run.sections
        },
        "missing": missing,
        "tally": counts,
        "claims": [asdict(claim) for claim in claims],
        "comparison": [{**asdict(row), "deviation_shown": row.deviation_shown} for row in run.rows],
        "slips": run.slips,
    }
    seed = "none: no twin behind it" if run.facts["seed"] is None else str(run.facts["seed"])
    facts = {
        "seed": seed,
        "configuration": run.facts["configuration_hash"]
        or "no test was needed; the models have the paper's parameters",
        "test": run.facts["test"] or "-",
        "data": run.facts["data_dir"] or "-",
        "versions": ", ".join(f"{name} {number}" for name, number in run.facts["versions"].items()),
        "machine": run.facts["machine"],
        "made": f"{datetime.now().astimezone():%Y-%m-%d %H:%M %Z}, in {elapsed_s:.0f} s",
    }
    write_output(
        run.out / REPORT,
        render_template(
            "reproduction.html.j2",
            title=TITLE,
            run_facts=facts,
            origin=run.facts["origin"],
            missing=missing,
            counts=counts,
            claims=claims,
            sections=run.sections,
            agreements=AGREEMENTS,
            not_available=NOT_AVAILABLE,
        ),
    )
    write_output(run.out / RECORD, (json.dumps(result, indent=1) + "\n").encode())
    return result


def print_result(result: Mapping[str, Any]) -> None:
    """Print the summary of `write_outcome` on standard output: claims, counts, seed, versions."""
    for claim in result["claims"]:
        agreeing = f"{claim['n_agreeing']} of {claim['n_compared']} predictions agree"
        # A terminal of any code page shows it.
        click.echo(f"{claim['result']:<19} {agreeing:<28} {claim['claim'].replace('µ', 'u')}")
    for name, texts in (("kinds", {}), ("predictions", AGREEMENTS)):
        counts = result["tally"][name].items()
        click.echo(f"{name}: {', '.join(f'{n} {texts.get(key, key)}' for key, n in counts)}")
    versions = ", ".join(f"{name} {number}" for name, number in result["versions"].items())
    click.echo(f"seed {result['seed']}, configuration {result['configuration_hash']}")
    click.echo(f"{versions}; {result['machine']}")
    if result["missing"]:
        click.echo(f"not made: {', '.join(result['missing'])}")
    click.echo(f"{result['report']} in {result['elapsed_s']:.1f} s")
