"""Results of a set in its own file: a copy of the catalogue's rows, and a comparison of the two."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from daq_service.archive import Results
from daq_service.archive.layout import RESULTS
from daq_service.catalogue import Catalogue, RecorderCatalogue
from daq_service.catalogue.rows import MEASURED, FeatureRow, SetRow, ShotRow, ThicknessRow
from hardware_drivers.measurement import SetKey

MADE_BY = "extractor_version"


def read_set_results(catalogue: Catalogue, set_key: SetKey) -> Results:
    """Read the results of a set from the catalogue, as columns of each table (`build_result_tables`).

    Empty if it has no results. Raise StorageError if the catalogue cannot be read.
    """
    of_set = set_key._asdict()
    positions = [row.position for row in catalogue.rows(SetRow, **of_set)]
    return build_result_tables(
        catalogue.rows(FeatureRow, **of_set),
        catalogue.rows(ThicknessRow, **of_set),
        [row for position in positions for row in catalogue.rows(ShotRow, position=position, **of_set)],
    )


def read_newest_results(catalogue: RecorderCatalogue, set_key: SetKey) -> Results:
    """Return the results of a set as columns of each table (`build_result_tables`).

    Those of the set that this process stored last come from memory; others are read from the catalogue, which
    raises StorageError if it cannot be read.
    """
    newest = catalogue.newest
    if all(row.set_key != set_key for row in newest.sets):
        return read_set_results(catalogue, set_key)
    return build_result_tables(newest.features, newest.thickness, newest.shots)


def build_result_tables(
    features: Sequence[FeatureRow], thickness: Sequence[ThicknessRow], shots: Sequence[ShotRow]
) -> Results:
    """Convert the rows of one set to columns of the tables ``features``, ``set_features`` and ``thickness``.

    Each has the measured values, position, quality and extractor version; a row of a shot also its id,
    validity (1 or 0) and flags. A row whose shot is not among ``shots`` is left out, and so is a table
    without rows. A missing or infinite value is NaN.
    """
    shot_of: dict[int | None, ShotRow] = {row.sequence: row for row in shots}
    tables: dict[str, list[dict[str, Any]]] = {"features": [], "set_features": [], "thickness": []}
    rows: list[FeatureRow | ThicknessRow] = [*features, *thickness]
    for row in rows:
        shot = shot_of.get(row.sequence)
        if shot is None and (isinstance(row, ThicknessRow) or row.sequence is not None):
            continue  # its record is lost
        columns: dict[str, Any] = {name: _to_finite(getattr(row, name)) for name in MEASURED[type(row)]}
        columns |= {"position": row.position, "quality": row.quality, MADE_BY: row.extractor_version}
        if shot is not None:
            columns |= {
                "shot_id": shot.sequence,
                "valid": 1 if shot.valid else 0,
                "flags": " ".join(shot.flags),
            }
        if isinstance(row, ThicknessRow):
            tables["thickness"].append(columns)
        else:
            table = "set_features" if shot is None else "features"
            tables[table].append({**columns, "n_valid": row.n_valid})
    return {table: _to_columns(rows_of_table) for table, rows_of_table in tables.items() if rows_of_table}


def _to_columns(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Convert the rows of a table, at least one and with equal keys, to a list of values for each column."""
    return {name: [row[name] for row in rows] for name in rows[0]}


def find_differences(copy: Results, rows: Results) -> Iterator[str]:
    """Yield a text for each difference between a file's copy of the results and the rows of the catalogue.

    Rows that only one of them has differ; rows of another extractor version, and columns that only one has,
    are not compared. Two NaN are equal.
    """
    for table, key in RESULTS.items():
        copied, expected = _index_by_key(key, copy.get(table, {})), _index_by_key(key, rows.get(table, {}))
        for name in sorted({*copied, *expected}, key=str):
            in_file, in_catalogue = copied.get(name), expected.get(name)
            if in_file is None or in_catalogue is None:
                yield f"{table}, {key} {name}: {'not in the file' if in_file is None else 'there is no row'}"
            elif in_file[MADE_BY] == in_catalogue[MADE_BY]:
                for column in sorted(in_file.keys() & in_catalogue.keys()):
                    left, right = in_file[column], in_catalogue[column]
                    if not (left == right or (left != left and right != right)):  # two NaN are equal
                        difference = f"{column} is {right!r}, in the file {left!r}"
                        yield f"{table}, {key} {name}: {difference}"


def _index_by_key(key: str, columns: Mapping[str, Sequence[Any]]) -> dict[Any, dict[str, Any]]:
    """Convert the columns of a table to rows, by the value of their column ``key``; empty without columns.

    Raise ValueError for columns of different lengths, KeyError without the key column.
    """
    rows = (dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))
    return {row[key]: row for row in rows}


def _to_finite(value: float | None) -> float:
    """Return the value, or NaN if it is None or infinite."""
    return math.nan if value is None or math.isinf(value) else value
