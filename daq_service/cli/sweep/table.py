"""Build the table of a sweep: columns, provenance, and a hash of the content."""

from __future__ import annotations

import hashlib
import json
import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from daq_service.cli.sweep.plan import VERSIONS_THAT_COUNT, Plan, compute_code_version, to_json_text
from daq_service.cli.sweep.shot import OK, RESULTS, Outcome
from hardware_drivers.units import find_unit

Column = NDArray[np.generic] | list[str]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SweepTable:
    """All rows, as columns.

    Attributes
    ----------
    swept
        Value of each swept key in each row: int64, float64, bool, or text (JSON for lists and tables).
    results
        float64, shape (n_rows,) each, NaN where a row has no such number.
    status
        ``ok``, or why a row has no numbers.
    forces
        Force at the sensor of each row in N, with its sample interval in s; None without waveforms.
    facts
        Where the table comes from, `content_hash` among it; ready for JSON.
    """

    swept: Mapping[str, Column]
    results: Mapping[str, NDArray[np.float64]]
    status: list[str]
    forces: list[tuple[NDArray[np.float64], float]] | None
    facts: Mapping[str, object]

    @property
    def columns(self) -> dict[str, Column]:
        """Return all columns in the order of the file: swept keys, results, status."""
        return {**self.swept, **self.results, "status": self.status}

    def rows(self) -> list[dict[str, object]]:
        """Return the rows as dicts by column for JSON; NaN becomes None."""
        columns = {name: _to_plain_list(values) for name, values in self.columns.items()}
        return [dict(zip(columns, cells, strict=True)) for cells in zip(*columns.values(), strict=True)]


def build_sweep_table(plan: Plan, outcomes: Sequence[Outcome], origin: Mapping[str, object]) -> SweepTable:
    """Arrange the outcomes of a plan, given in the order of its rows, as a table with its provenance.

    Parameters
    ----------
    origin
        What the caller knows of the configuration and the specification; goes to `facts`.
    """
    names = RESULTS[plan.model]
    numbers = np.array([outcome.numbers for outcome in outcomes], dtype=np.float64).reshape(-1, len(names))
    swept = {key: _unify_column([row.values[k] for row in plan.rows]) for k, key in enumerate(plan.keys)}
    results = {name: np.ascontiguousarray(numbers[:, k]) for k, name in enumerate(names)}
    status = [outcome.status for outcome in outcomes]
    facts = {
        **origin,
        "model": plan.model,
        "rows": len(status),
        "rows_ok": status.count(OK),
        "columns": {name: find_unit(name.rpartition(".")[2]) for name in (*swept, *results)},
        "solimon_version": version("solimon"),
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in VERSIONS_THAT_COUNT},
        },
        "code_sha256": compute_code_version(),
        "content_hash": compute_table_hash(plan, outcomes),
    }
    forces = None
    if plan.waveforms:
        nothing: NDArray[np.float64] = np.empty(0)
        forces = [
            (nothing if outcome.force_n is None else outcome.force_n, outcome.sample_interval_s)
            for outcome in outcomes
        ]
    return SweepTable(swept=swept, results=results, status=status, forces=forces, facts=facts)


def compute_table_hash(plan: Plan, outcomes: Sequence[Outcome]) -> str:
    """Compute the SHA-256, in hexadecimal, of a line of JSON for the column names, then one per row.

    Numbers are written with the digits that give them back exactly, so the hash is that of their bits.
    """
    digest = hashlib.sha256(_encode_row([*plan.keys, *RESULTS[plan.model], "status"]))
    for row, outcome in zip(plan.rows, outcomes, strict=True):
        digest.update(_encode_row([*row.values, *outcome.numbers, outcome.status]))
    return digest.hexdigest()


def _encode_row(cells: list[object]) -> bytes:
    """Encode a row as a line of compact JSON with a line feed, for hashing."""
    return f"{to_json_text(cells)}\n".encode()


def _unify_column(values: list[object]) -> Column:
    """Convert a column to int64, float64 (also int and float mixed) or bool, otherwise to texts.

    In a list of texts, other values are encoded as JSON.
    """
    kinds = {type(value) for value in values}
    if kinds <= {int, float} and kinds != {int}:
        return np.array(values, dtype=np.float64)
    if kinds == {int}:
        return np.array(values, dtype=np.int64)
    if kinds == {bool}:
        return np.array(values, dtype=np.bool_)
    return [value if isinstance(value, str) else to_json_text(value) for value in values]


def _to_plain_list(values: Column) -> Sequence[object]:
    """Convert a column to a list of Python values; NaN becomes None."""
    if isinstance(values, list):
        return values
    cells = values.tolist()
    return [None if isinstance(cell, float) and math.isnan(cell) else cell for cell in cells]


def format_facts(table: SweepTable) -> str:
    """Encode the facts of a table as indented JSON with sorted keys; equal facts give equal text."""
    return json.dumps(table.facts, sort_keys=True, indent=1, default=list) + "\n"
