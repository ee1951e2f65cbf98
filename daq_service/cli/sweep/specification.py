"""Parse the specification of a sweep: ``KEY=VALUES``, or a CSV file with one shot per row.

VALUES is a comma-separated list. Each of its items is a value (``0.003``, ``disk``, ``[0.1, 0.2]``), an
evenly spaced range ``first:last:count``, or ``log:first:last:count``, evenly spaced in the logarithm.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daq_service.errors import UsageError

GRAMMAR = "write KEY=value,value,... or KEY=first:last:count or KEY=log:first:last:count"

LARGEST_COUNT = 200_000
"""Values of one key; a plan of so many rows is the largest, too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """One key of the configuration and the values it takes."""

    key: str
    values: tuple[object, ...]


def parse_axis(text: str) -> Axis:
    """Parse one axis of the form ``KEY=VALUES``; the key is not checked.

    Raises
    ------
    UsageError
        The text does not follow the grammar, a range cannot be made, or there are more than `LARGEST_COUNT`
        values.
    """
    key, equals, listed = text.partition("=")
    if not equals or not key.strip() or not listed.strip():
        raise UsageError(f"--sweep is {text!r}; {GRAMMAR}")
    values: list[object] = []
    for item in _split_items(listed):
        if not item:
            raise UsageError(f"--sweep is {text!r}: an item of its list is empty; {GRAMMAR}")
        values += _parse_item_values(item, text)
        if len(values) > LARGEST_COUNT:
            raise UsageError(_format_too_many_values(text))
    return Axis(key=key.strip(), values=tuple(values))


def read_sweep_file(path: Path) -> tuple[Axis, ...]:
    """Read a CSV file whose header names keys and whose rows are shots, as one axis per column.

    Empty lines are skipped; cells are parsed as values of an axis.

    Raises
    ------
    UsageError
        The file cannot be read, has no shots, an empty cell, or a row with another number of cells than the
        header.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = [row for row in csv.reader(file, strict=True) if row]
    except OSError as error:
        raise UsageError(f"cannot read --sweep-file {path}: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f"--sweep-file {path} is not a CSV file in UTF-8: {error}") from error
    if len(rows) < 2:
        raise UsageError(f"--sweep-file {path} holds no shots; write a header of keys, then one row a shot")
    header, *shots = rows
    for number, cells in enumerate(shots, 1):
        if len(cells) != len(header):
            raise UsageError(
                f"--sweep-file {path}: shot {number} has {len(cells)} cells, the header {len(header)}"
            )
        if not all(cell.strip() for cell in cells):
            raise UsageError(f"--sweep-file {path}: shot {number} has an empty cell; write every value")
    return tuple(
        Axis(key=key.strip(), values=tuple(_parse_value(cells[column].strip()) for cells in shots))
        for column, key in enumerate(header)
    )


def _split_items(text: str) -> list[str]:
    """Split a text at the commas outside brackets and quotes; items without outer spaces, may be empty."""
    items, depth, quoted, start = [], 0, False, 0
    for place, letter in enumerate(text):
        if letter == '"':
            quoted = not quoted
        elif not quoted and letter in "[{":
            depth += 1
        elif not quoted and letter in "]}":
            depth -= 1
        elif letter == "," and not quoted and depth <= 0:
            items.append(text[start:place].strip())
            start = place + 1
    return [*items, text[start:].strip()]


def _parse_item_values(item: str, text: str) -> Sequence[object]:
    """Parse one item of an axis: a value, or a range FIRST:LAST:COUNT, evenly or ``log:`` spaced.

    Raises UsageError for an invalid range or more than `LARGEST_COUNT` values; ``text`` is for messages.
    """
    parts = item.split(":")
    if len(parts) == 1 or item[0] in '[{"':
        return [_parse_value(item)]
    logarithmic = parts[0].strip() == "log"
    try:
        first, last, count = (
            number(part) for number, part in zip((float, float, int), parts[logarithmic:], strict=True)
        )
    except ValueError as error:
        raise UsageError(f"--sweep is {text!r}: {item!r} is no range; {GRAMMAR}") from error
    if not (math.isfinite(first) and math.isfinite(last)):
        raise UsageError(f"--sweep is {text!r}: {item!r} has an end that is not finite")
    if not 1 <= count <= LARGEST_COUNT:
        raise UsageError(
            _format_too_many_values(text)
            if count > 1
            else f"--sweep is {text!r}: a range has at least 1 value"
        )
    if count == 1 and first != last:
        raise UsageError(f"--sweep is {text!r}: {item!r} asks for one value, but its ends differ")
    if logarithmic and not (first > 0.0 and last > 0.0):
        raise UsageError(f"--sweep is {text!r}: both ends of a log range must be greater than 0")
    values = space_evenly(first, last, count, logarithmic=logarithmic)
    if not all(map(math.isfinite, values)):
        raise UsageError(f"--sweep is {text!r}: {item!r} is wider than floating-point numbers reach")
    return values


def space_evenly(first: float, last: float, count: int, *, logarithmic: bool = False) -> list[float]:
    """Compute ``count`` equally spaced values, in the logarithm if ``logarithmic``, with both ends.

    Inner ones have 15 digits, so that a third of 0.9 is 0.3.
    """
    with np.errstate(all="ignore"):
        values = np.geomspace(first, last, count) if logarithmic else np.linspace(first, last, count)
    if count < 3:
        return [float(value) for value in values]
    return [float(values[0]), *(float(f"{value:.15g}") for value in values[1:-1]), float(values[-1])]


def _parse_value(text: str) -> object:
    """Parse a number, true, false, null or a bracketed list as JSON; return other text unchanged."""
    try:
        return json.loads(text)
    except ValueError:
        pass  # no JSON: a number such as .5, or a name
    try:
        return float(text)
    except ValueError:
        return text


def _format_too_many_values(text: str) -> str:
    """Format the error message for a sweep ``text`` with more than `LARGEST_COUNT` values."""
    return f"--sweep is {text!r}: more than {LARGEST_COUNT} values; make it coarser or split the sweep"
