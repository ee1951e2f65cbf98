"""Standard errors of the features of sets, computed from the stored features of their shots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Unpack

import numpy as np

from daq_service.catalogue.reader import Catalogue, Filters
from daq_service.catalogue.rows import MEASURED, FeatureRow, ShotRow
from hardware_drivers.measurement import SetKey

StandardErrors = Mapping[tuple[str, SetKey], Mapping[str, float | None]]
"""Standard errors by feature, of each position and set."""
_COLUMNS = ("position", "set_index", "unscheduled_index", "shot_index", "sequence", "n_valid")


def read_standard_errors(
    catalogue: Catalogue, names: Sequence[str], **filters: Unpack[Filters]
) -> StandardErrors:
    """Read the features of shots and compute the standard errors of the means of their sets.

    It is the standard deviation (n - 1) of the valid accepted shots, divided by the root of their number n.
    A set without a mean or with fewer than two values has None. Raises StorageError if the catalogue cannot
    be read.
    """
    filters["scope"] = None
    columns = catalogue.columns(FeatureRow, [*_COLUMNS, *names], **filters)
    rows = zip(*(columns[name] for name in (*_COLUMNS, *names)), strict=True)
    errors = {}
    for (position, set_index, unscheduled_index), group in groupby(rows, key=lambda row: row[:3]):
        members = list(group)
        means = next((row[6:] for row in members if row[3] is None), [None] * len(names))
        shots = [row for row in members if row[3] is not None and row[5]]
        if len({row[3] for row in shots}) < len(shots):  # repeated: one record of the shot counts
            stored = catalogue.rows(
                ShotRow, position=position, set_index=set_index, unscheduled_index=unscheduled_index
            )
            accepted = {shot.sequence for shot in stored if shot.outcome == "accepted"}
            shots = [row for row in shots if row[4] in accepted]
        values = np.array([row[6:] for row in shots], dtype=float).reshape(-1, len(names))
        measured = np.ma.masked_invalid(values)
        found = measured.std(axis=0, ddof=1) / np.sqrt(measured.count(axis=0))  # masked for fewer than two
        errors[position, SetKey(set_index, unscheduled_index)] = {
            name: None if mean is None else error
            for name, mean, error in zip(names, means, found.tolist(), strict=True)
        }
    return errors


def read_error_columns(
    catalogue: Catalogue, names: Sequence[str], set_indices: Sequence[int], **filters: Unpack[Filters]
) -> dict[str, list[float | None]]:
    """Read ``standard_error_NAME`` of features of one position (a filter), one entry per scheduled set.

    Raises StorageError if the catalogue cannot be read.
    """
    errors = read_standard_errors(catalogue, names, **filters)
    of_sets = [errors.get((filters["position"] or "", SetKey(index)), {}) for index in set_indices]
    return {f"standard_error_{name}": [found.get(name) for found in of_sets] for name in names}


def find_standard_errors(
    catalogue: Catalogue, rows: Sequence[FeatureRow]
) -> list[Mapping[str, float | None] | None]:
    """Return the standard errors of each feature row, in their order; None for a row of a single shot.

    Raises StorageError if the catalogue cannot be read.
    """
    of_sets = [row for row in rows if row.shot_index is None]
    if not of_sets:
        return [None] * len(rows)
    positions = {row.position for row in of_sets}
    errors = read_standard_errors(
        catalogue,
        MEASURED[FeatureRow],
        position=None if len(positions) > 1 else of_sets[0].position,
        first_h=min(row.due_h for row in of_sets),
        last_h=max(row.due_h for row in of_sets),
        purpose="any" if any(row.unscheduled_index for row in of_sets) else None,
    )
    return [errors[row.position, row.set_key] if row.shot_index is None else None for row in rows]
