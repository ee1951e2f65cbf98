"""Results of a set in its own file: a copy of the catalogue's rows, and what tells the two apart."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from daq_service.archive import Results
from daq_service.archive.layout import RESULTS
from daq_service.catalogue import Catalogue
from daq_service.catalogue.rows import FeatureRow, SetRow, ShotRow, ThicknessRow, measured

MADE_BY = "extractor_version"


def results_in(catalogue: Catalogue, set_index: int) -> Results:
    """Copy what a catalogue says of a set."""
    places = [row.position for row in catalogue.rows(SetRow, set_index=set_index)]
    return results_of(
        catalogue.rows(FeatureRow, set_index=set_index),
        catalogue.rows(ThicknessRow, set_index=set_index),
        [row for place in places for row in catalogue.rows(ShotRow, position=place, set_index=set_index)],
    )


def results_of(
    features: Sequence[FeatureRow], thickness: Sequence[ThicknessRow], shots: Sequence[ShotRow]
) -> Results:
    """Copy rows of one set."""
    shot_of: dict[int | None, ShotRow] = {row.sequence: row for row in shots}
    tables: dict[str, list[dict[str, Any]]] = {"features": [], "set_features": [], "thickness": []}
    rows: list[FeatureRow | ThicknessRow] = [*features, *thickness]
    for row in rows:
        shot = shot_of.get(row.sequence)
        if shot is None and (isinstance(row, ThicknessRow) or row.sequence is not None):
            continue  # its record is lost
        told: dict[str, Any] = {name: _number(getattr(row, name)) for name in measured(type(row))}
        told |= {"position": row.position, "quality": row.quality, MADE_BY: row.extractor_version}
        if shot is not None:
            told |= {"shot_id": shot.sequence, "valid": 1 if shot.valid else 0, "flags": " ".join(shot.flags)}
        if isinstance(row, ThicknessRow):
            tables["thickness"].append(told)
        else:
            table = "set_features" if shot is None else "features"
            tables[table].append({**told, "n_valid": row.n_valid})
    return {table: _by_column(found) for table, found in tables.items() if found}


def _by_column(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    return {name: [row[name] for row in rows] for name in rows[0]}


def differing(copy: Results, rows: Results) -> Iterator[str]:
    """Say where a copy is not what the rows say; what another version of an extractor made is passed over."""
    for table, key in RESULTS.items():
        copied, expected = _by(key, copy.get(table, {})), _by(key, rows.get(table, {}))
        for name in sorted({*copied, *expected}, key=str):
            left, right = copied.get(name), expected.get(name)
            if left is None or right is None:
                yield f"{table}, {key} {name}: {'not in the file' if left is None else 'there is no row'}"
            elif left[MADE_BY] == right[MADE_BY]:
                for column in sorted(left.keys() & right.keys()):
                    if not _same(left[column], right[column]):
                        told = f"{column} is {right[column]!r}, in the file {left[column]!r}"
                        yield f"{table}, {key} {name}: {told}"


def _by(key: str, columns: Mapping[str, Sequence[Any]]) -> dict[Any, dict[str, Any]]:
    rows = (dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))
    return {row[key]: row for row in rows}


def _same(left: Any, right: Any) -> bool:
    return bool(left == right or (left != left and right != right))


def _number(value: float | None) -> float:
    return math.nan if value is None else value
