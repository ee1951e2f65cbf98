"""Compare the paper's values with ours: deviation, agreement and cause, row by row."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from daq_service.cli.reproduce.diagnosis import find_deviation_cause
from daq_service.cli.reproduce.item import Found, no_value
from daq_service.cli.reproduce.paper_values import Kind, PaperValue, list_paper_values

NOT_AVAILABLE = "not available"
TOLERANCES_PERCENT = (1, 3, 10)
"""Of the paper's number, also where that is a percentage itself."""
AGREEMENTS = {
    **{f"within_{tolerance}_percent": f"within {tolerance} %" for tolerance in TOLERANCES_PERCENT},
    "within_scatter": "within the paper's scatter",
    "outside": "no agreement",
    "words": "words only in the paper",
    "not_available": NOT_AVAILABLE,
}
"""How a prediction agrees with the paper, as text by its name in JSON, the narrowest first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One quantity of the paper and of this reproduction.

    Attributes
    ----------
    deviation
        Ours less the paper's, in `unit`; None where one of them is no number.
    deviation_percent
        The same relative to the paper's; None also where that is 0.
    agreement
        Of a prediction: the first of `AGREEMENTS` that applies; empty for other kinds.
    cause
        Why they differ, or who gave the twin the value; empty where that is not known.
    """

    item: str
    quantity: str
    text: str
    where: str
    kind: Kind
    unit: str
    paper: float | None
    paper_shown: str
    ours: float | None
    ours_shown: str
    ours_words: str
    deviation: float | None
    deviation_percent: float | None
    agreement: str
    cause: str

    @property
    def deviation_shown(self) -> str:
        """Return the deviation as text: in %, or in the unit; "none" if rounding only, "-" if missing."""
        if self.deviation is None:
            return "-"
        if abs(self.deviation) < 1e-9 * max(1.0, abs(self.paper or 0.0)):  # of rounding
            return "none"
        if self.deviation_percent is not None and self.unit != "%":
            return f"{self.deviation_percent:+.1f} %"
        return f"{self.deviation:+.3g} {'points' if self.unit == '%' else self.unit}"


def compare_item(
    item: str,
    found: Mapping[str, Found],
    *,
    origin: str,
    missing_reason: str = "this figure does not give it",
) -> list[Row]:
    """Compare the paper's quantities of one item with ours, with a reason for missing ones.

    Returns one row per quantity, in the order of the paper's list.

    Parameters
    ----------
    origin
        Of the measurements: ``shipped``, ``twin`` or ``specimen`` (see `diagnosis`).
    missing_reason
        Why quantities are not in `found`.
    """
    return [
        _compare_value(value, found.get(value.quantity, no_value(missing_reason)), origin=origin)
        for value in list_paper_values(item)
    ]


def _compare_value(value: PaperValue, ours: Found, *, origin: str) -> Row:
    """Compare one value of the paper with ours: deviation in its unit and in %, agreement, and the cause.

    ``origin`` as in `compare_item`.
    """
    deviation = None if ours.value is None or value.value is None else ours.value - value.value
    return Row(
        item=value.item,
        quantity=value.quantity,
        text=value.text,
        where=value.where,
        kind=value.kind,
        unit=value.unit,
        paper=value.value,
        paper_shown=_format_paper_value(value),
        ours=ours.value,
        ours_shown=NOT_AVAILABLE if ours.value is None else _format_our_value(ours.value, value),
        ours_words=ours.words if ours.value is not None else ours.reason,
        deviation=deviation,
        deviation_percent=100.0 * deviation / value.value if deviation is not None and value.value else None,
        agreement=_assess_agreement(value, ours.value) if value.kind == "predicted" else "",
        cause="" if ours.value is None else find_deviation_cause(value, origin=origin),
    )


def _assess_agreement(value: PaperValue, ours: float | None) -> str:
    """Return the first of `AGREEMENTS` that applies to our prediction of a value of the paper."""
    if ours is None:
        return "not_available"
    if value.value is None:
        return "words"
    for tolerance in TOLERANCES_PERCENT:
        limit = 0.01 * tolerance * abs(value.value)
        if abs(ours - value.value) <= limit * (1.0 + 1e-9):  # rounding at the limit itself
            return f"within_{tolerance}_percent"
    low, high = value.scatter or (math.inf, -math.inf)
    return "within_scatter" if low <= ours <= high else "outside"


def _format_paper_value(value: PaperValue) -> str:
    """Format a value of the paper as printed, with its qualification in parentheses."""
    number = "" if value.value is None else f"{value.value:.{value.decimals}f}"
    sign = "±" if value.wording.startswith("+-") else ""
    qualification = value.wording.removeprefix("+-").strip("; ")
    return (
        f"{sign}{number} ({qualification})"
        if number and qualification
        else f"{sign}{number}" or qualification
    )


def _format_our_value(number: float, value: PaperValue) -> str:
    """Format our value with one digit more than the paper's; an integer if both values are integers."""
    decimals = value.decimals + 1 if value.value is not None else 2
    if value.value is not None and value.decimals == 0 and float(number).is_integer():
        decimals = 0
    return f"{round(number, decimals) + 0.0:.{decimals}f}"  # no minus before a zero
