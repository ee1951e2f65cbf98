"""Texts of the reproduction, read from `texts.toml`: captions, claims, causes of deviations, slips."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pydantic import TypeAdapter

from daq_service.shared_file import load_module_toml


@dataclass(frozen=True, slots=True)
class Caption:
    """Title of an item and what it shows."""

    title: str
    shows: str


@dataclass(frozen=True, slots=True)
class Remark:
    """Text on the quantities ``of``, or on all whose names start so: a cause, or a claim of the paper."""

    of: Sequence[str]
    text: str


@dataclass(frozen=True, slots=True)
class Slip:
    """One slip: the printed text, the correct one, our finding and the function of its numbers."""

    where: str
    prints: str
    right: str
    finding: str = ""
    sentence: str = "nothing to compute"


@dataclass(frozen=True, slots=True, kw_only=True)
class Trended:
    """A feature over the test and the figure that shows it.

    Attributes
    ----------
    scale
        Factor to the axis's unit.
    quantities
        Names of the paper's values of the fit's start, end and change, without the position.
    """

    item: str
    column: str
    scale: float
    label: str
    quantities: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Texts:
    """Contents of the file; captions by item."""

    captions: Mapping[str, Caption]
    claims: Sequence[Remark]
    causes: Sequence[Remark]
    slips: Sequence[Slip]
    trends: Sequence[Trended]


def find_remark(remarks: Sequence[Remark], quantity: str) -> str:
    """Return the text on ``item.quantity`` with the longest name that it starts with; empty if none does."""
    known = {name: remark.text for remark in remarks for name in remark.of if quantity.startswith(name)}
    return known[max(known, key=len)] if known else ""


TEXTS = TypeAdapter(Texts).validate_python(load_module_toml(__file__))
