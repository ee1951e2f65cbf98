"""Rows of the API as DataFrames, with typed columns also where values are missing."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from daq_service.catalogue.published_columns import Form, PublishedColumn, add_nested, list_shown_columns
from daq_service.catalogue.rows import Row
from daq_service.client.connection import Json

DTYPES: dict[Form, str] = {"number": "float64", "integer": "Int64", "truth": "boolean", "text": "object"}


def build_data_frame(kind: type[Row], items: Sequence[Json], as_of: Json) -> pd.DataFrame:
    """Build a data frame from the rows of a listing of the API; a missing value is NaN, NaT or NA.

    An empty listing gives all columns with their types. Rows with an hour have a column ``age_h``, their age
    in h. Raise KeyError if a row lacks a column.

    Parameters
    ----------
    kind
        Class of the rows, which has the published columns.
    as_of
        Time of reading and status of the recorder.

    Returns
    -------
    DataFrame
        ``attrs["units"]`` has the unit of each number, ``attrs["as_of"]`` the argument.
    """
    columns = list(list_shown_columns(kind))
    if any(column.name in ("due_h", "raised_h") for column in columns):
        columns.append(PublishedColumn(name="age_h", form="number", unit="h", nullable=False))
    items = [add_nested(kind, item) for item in items]
    table = pd.DataFrame({column.name: _build_series(column, items) for column in columns})
    table.attrs["units"] = {column.name: column.unit for column in columns if column.unit}
    table.attrs["as_of"] = as_of
    return table


def _build_series(column: PublishedColumn, items: Sequence[dict[str, object]]) -> pd.Series[object]:
    """Build the pandas series of a column, with the type of its form; times are UTC with ns resolution.

    Raises
    ------
    KeyError
        A row lacks the column.
    ValueError, TypeError
        A value does not have the type.
    """
    values = [item[column.name] for item in items]
    if column.form == "time":
        return pd.to_datetime(pd.Series(values, dtype="object"), utc=True, format="ISO8601").astype(
            "datetime64[ns, UTC]"
        )
    dtype = DTYPES.get(column.form, "object")
    if column.form == "integer" and not column.nullable:
        dtype = "int64"
    if column.form == "truth" and not column.nullable:
        dtype = "bool"
    return pd.Series(values, dtype=dtype)
