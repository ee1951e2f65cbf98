"""Build the rows of a sweep: every combination, checked before the computation."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import version
from typing import Any, Literal

from daq_service.cli.sweep.keys import SECTIONS, check_sweep_key, read_value_at, replace_section_values
from daq_service.cli.sweep.specification import Axis
from daq_service.errors import UsageError
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters

Model = Literal["coupled", "zener"]
Specimen = tuple[ChainParameters, PlateParameters, CorrosionParameters]

LARGEST_PLAN = 200_000
LARGEST_PLAN_WITH_WAVEFORMS = 10_000
"""Rows; all waveforms are held in memory when the file is written, some 22 kB each."""

VERSIONS_THAT_COUNT = ("numpy", "scipy", "numba")


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One shot of a sweep.

    Attributes
    ----------
    index
        Place in the table, from 0; people count from 1.
    values
        Of the swept keys, in their order.
    specimen
        All parameters; None where they are refused.
    key
        SHA-256 of all parameters and of the code that computes them; empty where they are refused.
    reason
        Why they are refused; empty otherwise.
    """

    index: int
    values: tuple[object, ...]
    specimen: Specimen | None
    key: str = ""
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """All rows of a sweep in the order of its table."""

    model: Model
    keys: tuple[str, ...]
    rows: tuple[Row, ...]
    waveforms: bool = False

    @property
    def identity(self) -> str:
        """Return the SHA-256, in hexadecimal, of the sweep and of the code that computes it."""
        rows = [[row.key or row.reason, [_to_json_value(value) for value in row.values]] for row in self.rows]
        return _hash_json([self.model, self.keys, self.waveforms, rows, compute_code_version()])


def build_plan(
    model: Model,
    base: Specimen,
    axes: Sequence[Axis],
    *,
    element_wise: bool = False,
    skip_invalid: bool = False,
    waveforms: bool = False,
) -> Plan:
    """Combine the axes, the last one changing fastest, check every combination, and return the plan.

    ``waveforms`` lowers the maximum number of rows.

    Parameters
    ----------
    base
        Parameters that no axis changes.
    element_wise
        First values together, then second ones, instead of the full product.
    skip_invalid
        Keep refused combinations as rows with their reason.

    Raises
    ------
    UsageError
        An unknown or repeated key, too many rows, axes of different lengths, or a refused combination.
    """
    keys = tuple(axis.key for axis in axes)
    for key in keys:
        check_sweep_key(key, model)
        if keys.count(key) > 1:
            raise UsageError(f"{key} is swept twice; name it once")
        if other := [name for name in keys if name.startswith(f"{key}.")]:
            raise UsageError(f"{key} is swept and {other[0]} in it; leave one out")
    _check_plan_size(axes, element_wise, waveforms)
    values = [axis.values for axis in axes]
    combined = zip(*values, strict=True) if element_wise else itertools.product(*values)
    rows = tuple(_yield_rows(model, base, keys, combined))
    refused = [row for row in rows if row.specimen is None]
    if refused and not skip_invalid:
        raise UsageError(
            f"{describe_row(keys, refused[0])} is refused: {refused[0].reason} ({len(refused)} of "
            f"{len(rows)} rows are); correct it, or keep such rows with their reason by --skip-invalid"
        )
    return Plan(model=model, keys=keys, rows=rows, waveforms=waveforms)


def describe_row(keys: Sequence[str], row: Row) -> str:
    """Describe a row by its number, from 1, and its swept values, for messages."""
    values = ", ".join(f"{key} = {value}" for key, value in zip(keys, row.values, strict=True))
    return f"row {row.index + 1} ({values})"


def _check_plan_size(axes: Sequence[Axis], element_wise: bool, waveforms: bool) -> None:
    """Raise UsageError for element-wise axes of different lengths or too many rows."""
    lengths = [len(axis.values) for axis in axes]
    if element_wise and len(set(lengths)) > 1:
        counts = ", ".join(f"{axis.key} {len(axis.values)}" for axis in axes)
        raise UsageError(f"--zip needs as many values of each key, not {counts}")
    rows = lengths[0] if element_wise else math.prod(lengths)
    largest = LARGEST_PLAN_WITH_WAVEFORMS if waveforms else LARGEST_PLAN
    if rows > largest:
        kind = "a sweep with --waveforms" if waveforms else "a sweep"
        raise UsageError(
            f"{rows} rows; {kind} has at most {largest}: make it coarser, or split it into several files"
        )


def _yield_rows(
    model: Model, base: Specimen, keys: tuple[str, ...], combined: Iterable[tuple[object, ...]]
) -> Iterator[Row]:
    """Yield the rows in order, refused ones with their reason; a shared section is built and hashed once.

    ``combined`` has the values of each row in the order of ``keys``; those of a row are as validated.
    """
    paths = [tuple(key.split(".")) for key in keys]
    places = {name: [k for k, path in enumerate(paths) if path[0] == name] for name in SECTIONS}
    bases = dict(zip(SECTIONS, base, strict=True))

    @cache
    def make_section(name: str, given: str) -> tuple[Any, str, str]:
        """Build a section from values as JSON; return it, its hash, and why it is invalid or ""."""
        values = json.loads(given)
        changes = {paths[k][1:]: value for k, value in zip(places[name], values, strict=True)}
        try:
            section_made = replace_section_values(bases[name], changes)
        except ValueError as error:
            return None, "", f"{name}: {error}"
        return section_made, _hash_json(asdict(section_made)), ""

    for index, values in enumerate(combined):
        parts = {name: make_section(name, json.dumps([values[k] for k in places[name]])) for name in SECTIONS}
        reason = "; ".join(reason for _, _, reason in parts.values() if reason)
        if reason:
            yield Row(index=index, values=tuple(values), specimen=None, reason=reason)
            continue
        yield Row(
            index=index,
            values=tuple(read_value_at(parts[path[0]][0], path[1:]) for path in paths),
            specimen=tuple(section_made for section_made, _, _ in parts.values()),
            key=_hash_json([model, compute_code_version(), *(text for _, text, _ in parts.values())]),
        )


@cache
def compute_code_version() -> str:
    """Compute the SHA-256, in hexadecimal, of the twin's source and of its libraries' versions; cached."""
    from simulator.numerics.source import hash_source

    return _hash_json(
        {
            "sources": hash_source(),
            "versions": {name: version(name) for name in VERSIONS_THAT_COUNT},
        }
    )


def _to_json_value(value: object) -> object:
    """Convert a swept value to JSON data: a table of parameters becomes a dict or list."""
    return (
        value if isinstance(value, (bool, int, float, str, type(None))) else json.loads(to_json_text(value))
    )


def to_json_text(value: object) -> str:
    """Encode a value of the configuration as compact JSON with sorted keys, dataclasses included."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), default=asdict)


def _hash_json(content: object) -> str:
    """Compute the SHA-256, in hexadecimal, of an object's compact JSON."""
    return hashlib.sha256(to_json_text(content).encode()).hexdigest()
