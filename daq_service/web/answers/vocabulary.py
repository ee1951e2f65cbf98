"""Texts and units of the names in answers and requests, read from ``vocabulary.toml``.

Keys are names, or ``Schema.name`` and ``operation.name`` where a name has a special meaning there.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from pydantic import BaseModel

from daq_service.catalogue.rows import list_columns
from daq_service.catalogue.tables import TABLES
from daq_service.shared_file import load_module_toml

T = TypeVar("T")
RATIOS = ("_ratio", "_coefficient", "_fraction", "_probability", "_squared")
"""Suffixes of numbers without a unit; an integer has none: it is a count or an index."""


class Vocabulary(BaseModel, frozen=True):
    """Tables of the file; ``problems`` has the description of an error answer by status."""

    meanings: Mapping[str, str]
    examples: Mapping[str, str | int]
    tags: Mapping[str, str]
    problems: Mapping[int, str]
    units: Mapping[str, str]
    topics: tuple[str, ...]
    listings: Mapping[str, str]
    schemes: dict[str, dict[str, str]]


VOCABULARY = Vocabulary.model_validate(load_module_toml(__file__))


MEANINGS: Mapping[str, str] = {
    **{
        column.published_name: column.description
        for kind in reversed(TABLES)
        for column in list_columns(kind)
        if column.description is not None
    },
    **VOCABULARY.meanings,
}
"""Texts of the file, and those of the columns of catalogue rows; of equal names that of the first row."""


def look_up_scoped_value(values: Mapping[str, T], scope: str, name: str) -> T | None:
    """Return the value of ``scope.name``, or else of ``name``; None if neither is a key."""
    return values.get(f"{scope}.{name}", values.get(name))
