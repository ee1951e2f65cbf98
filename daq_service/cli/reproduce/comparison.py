"""Compare the paper's values with ours: deviation and cause, row by row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from daq_service.cli.reproduce.diagnosis import GIVEN, find_deviation_cause
from daq_service.cli.reproduce.item import Found, no_value
from daq_service.cli.reproduce.paper_values import PaperValue, list_paper_values

NOT_AVAILABLE = "not available"


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One quantity of the paper and of this reproduction.

    Attributes
    ----------
    deviation
        Ours less the paper's, in `unit`; None where one of them is no number.
    deviation_percent
        The same relative to the paper's; None also where that is 0 or the unit is %.
    cause
        Why they differ; empty where they agree to rounding, unless the twin was given the value.
    """

    item: str
    quantity: str
    text: str
    where: str
    unit: str
    paper: float | None
    paper_shown: str
    ours: float | None
    ours_shown: str
    ours_words: str
    deviation: float | None
    deviation_percent: float | None
    cause: str

    @property
    def deviation_shown(self) -> str:
        """Return the deviation as text: in %, or in the unit; "none" if rounding only, "-" if missing."""
        if self.deviation is None:
            return "-"
        if _is_rounding_only(self.deviation, self.paper):
            return "none"
        if self.deviation_percent is not None:
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


def count_by_result(rows: Sequence[Row]) -> dict[str, int]:
    """Count the paper's values by result: agree (to rounding), deviate, words only, not available.

    "values" is their total.
    """
    counts = {"values": len(rows), "agree": 0, "deviate": 0, "words": 0, "not_available": 0}
    for row in rows:
        if row.ours is None:
            counts["not_available"] += 1
        elif row.deviation is None:
            counts["words"] += 1
        else:
            counts["agree" if _is_rounding_only(row.deviation, row.paper) else "deviate"] += 1
    return counts


def _compare_value(value: PaperValue, ours: Found, *, origin: str) -> Row:
    """Compare one value of the paper with ours: deviation in its unit and in %, and the cause.

    The relative deviation is None if the paper's value is 0, missing, or in %. ``origin`` as in
    `compare_item`.
    """
    deviation = None if ours.value is None or value.value is None else ours.value - value.value
    relative = None
    if deviation is not None and value.value and value.unit != "%":
        relative = 100.0 * deviation / value.value
    agrees = deviation is not None and _is_rounding_only(deviation, value.value)
    return Row(
        item=value.item,
        quantity=value.quantity,
        text=value.text,
        where=value.where,
        unit=value.unit,
        paper=value.value,
        paper_shown=_format_paper_value(value),
        ours=ours.value,
        ours_shown=NOT_AVAILABLE if ours.value is None else _format_our_value(ours.value, value),
        ours_words=ours.words if ours.value is not None else ours.reason,
        deviation=deviation,
        deviation_percent=relative,
        cause=_choose_shown_cause(value, ours, agrees=agrees, origin=origin),
    )


def _is_rounding_only(deviation: float, paper: float | None) -> bool:
    """Return whether a deviation is below 1e-9, relative to the paper's value if that exceeds 1."""
    return abs(deviation) < 1e-9 * max(1.0, abs(paper or 0.0))


def _choose_shown_cause(value: PaperValue, ours: Found, *, agrees: bool, origin: str) -> str:
    """Return the cause of a deviation to show; empty if there is no value of ours or both agree.

    That the twin was given the value is returned in any case. ``origin`` as in `compare_item`.
    """
    cause = "" if ours.value is None else find_deviation_cause(value, origin=origin)
    return "" if agrees and not cause.startswith(GIVEN) else cause


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
