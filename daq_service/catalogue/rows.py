"""Rows on their way into a table: complete, of SQL's types, and safe for JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from sqlalchemy import JSON, Table

from daq_service.catalogue.errors import CatalogueWriteError


def storable(table: Table, rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Rows as they are stored: every column named, NaN and infinities as NULL.

    Raises
    ------
    CatalogueWriteError
        A key is no column of the table.
    """
    given = list(rows)
    keys = set().union(*given) if given else set()
    columns = {column.name: isinstance(column.type, JSON) for column in table.columns if column.name in keys}
    if unknown := keys - columns.keys():
        raise CatalogueWriteError(
            f"{sorted(unknown)} are no columns of {table.name!r}; it has {sorted(table.columns.keys())}"
        )
    # Statements for many rows need the same keys in each.
    return [
        {name: row.get(name) if is_json else plain(row.get(name)) for name, is_json in columns.items()}
        for row in given
    ]


def plain(value: Any) -> Any:
    """Return a scalar as Python's own type; what is not a finite number becomes None."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
