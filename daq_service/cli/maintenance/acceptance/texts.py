"""Texts of quantities, tables and series, and the criteria, read from `texts.toml`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from pydantic import TypeAdapter

from daq_service.shared_file import load_module_toml

Sense = Literal["at least", "at most"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Criterion:
    """A limit of one of the quantities; ``limit`` None: not required."""

    quantity: str
    sense: Sense
    limit: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class QuantityText:
    """Section, description, unit and method of a quantity."""

    section: str
    text: str
    unit: str
    how: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TableText:
    """Title, columns, and the text of an empty table."""

    title: str
    columns: tuple[str, ...]
    empty: str = "none"


@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesText:
    """Title, unit and source of a series."""

    title: str
    unit: str
    how: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Texts:
    """Contents of the file, by name."""

    quantities: Mapping[str, QuantityText]
    tables: Mapping[str, TableText]
    series: Mapping[str, SeriesText]
    criteria: Sequence[Criterion]


TEXTS = TypeAdapter(Texts).validate_python(load_module_toml(__file__))
