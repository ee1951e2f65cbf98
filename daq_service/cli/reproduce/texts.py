"""Texts of the reproduction, read from `texts.toml`: captions, causes of deviations, slips of the paper."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter


@dataclass(frozen=True, slots=True)
class Caption:
    """Title of an item and what it shows."""

    title: str
    shows: str


@dataclass(frozen=True, slots=True)
class Cause:
    """Cause of the deviations ``of`` quantities, or of all whose names begin so."""

    of: Sequence[str]
    text: str


@dataclass(frozen=True, slots=True)
class Slip:
    """One slip: the printed text, the correct one, and the name of the function of our finding."""

    where: str
    prints: str
    right: str
    finding: str = "nothing"


@dataclass(frozen=True, slots=True)
class Texts:
    """Contents of the file; captions by item."""

    captions: Mapping[str, Caption]
    causes: Sequence[Cause]
    slips: Sequence[Slip]


TEXTS = TypeAdapter(Texts).validate_python(
    tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
)
