"""Values that the paper prints, read from `paper_values.csv`: drawing code and causes take them from here.

Source: the paper's text, captions and tables; its curves are not digitised. "About" and other words of
the paper are in `wording`; a number has the printed digits.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

Kind = Literal["input", "arithmetic", "given", "predicted"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperValue:
    """One quantity of one figure or table.

    Attributes
    ----------
    item
        Name of the figure or table here.
    value
        As printed; None if the paper has only words.
    decimals
        Printed digits behind the point: ours is shown with one more.
    wording
        The paper's own qualification: "about", "+-", "no trend".
    kind
        ``input``: the models and the test take it; ``arithmetic``: the paper's own formula, evaluated;
        ``given``: the twin was built to give it; ``predicted``: nothing of it was put in.
    repeats
        Name of the quantity where the paper prints it more than once; otherwise empty.
    where
        Section, figure, table or equation of the paper.
    """

    item: str
    quantity: str
    text: str
    value: float | None
    unit: str
    decimals: int
    where: str
    wording: str
    kind: Kind
    repeats: str

    @property
    def scatter(self) -> tuple[float, float] | None:
        """Return the smallest and the largest number that the paper prints for it; None if it prints one."""
        numbers = [one.value for one in PAPER_VALUES if one.repeats == self.repeats and one.value is not None]
        return (min(numbers), max(numbers)) if self.repeats else None


def _parse_paper_value(value: str, kind: str, **texts: str) -> PaperValue:
    """Parse a row of the file of the paper's values; the digits after the point give ``decimals``."""
    decimals = len(value.partition(".")[2])
    return PaperValue(
        value=float(value) if value else None, decimals=decimals, kind=cast("Kind", kind), **texts
    )


with Path(__file__).with_suffix(".csv").open(encoding="utf-8", newline="") as _file:
    PAPER_VALUES = tuple(_parse_paper_value(**row) for row in csv.DictReader(_file))

_BY_NAME = {(value.item, value.quantity): value for value in PAPER_VALUES}


def find_paper_value(item: str, quantity: str) -> PaperValue:
    """Return a value of the paper by item and quantity; raise KeyError for an unknown name."""
    return _BY_NAME[item, quantity]


def printed_number(item: str, quantity: str) -> float:
    """Return a number as printed in the paper, in its unit.

    Raises ValueError if the paper prints no number, KeyError for an unknown name.
    """
    value = find_paper_value(item, quantity).value
    if value is None:
        raise ValueError(f"the paper prints no number for {quantity} of {item}")
    return value


def list_paper_values(item: str) -> tuple[PaperValue, ...]:
    """Return all values of the paper for an item, in the order of the file; empty for an unknown item."""
    return tuple(value for value in PAPER_VALUES if value.item == item)
