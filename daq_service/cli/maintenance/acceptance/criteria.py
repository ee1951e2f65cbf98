"""Acceptance criteria with their limits, and the result."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from daq_service.cli.maintenance.acceptance.quantity import Quantity
from daq_service.cli.maintenance.acceptance.texts import TEXTS, Criterion
from daq_service.errors import UsageError

State = Literal["pass", "fail", "undecided", "does not apply", "left out"]
Outcome = Literal["pass", "fail", "incomplete"]

LEFT_OUT = "off"


DEFAULTS = tuple(TEXTS.criteria)


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Result of a criterion; ``reason`` is that of its state."""

    criterion: Criterion
    quantity: Quantity
    state: State
    reason: str


def parse_limits(given: Sequence[str]) -> tuple[Criterion, ...]:
    """Return the default criteria with the limits given as ``NAME=VALUE``; ``NAME=off`` removes a limit.

    Raises
    ------
    UsageError
        There is no such criterion, or the value is not a finite number.
    """
    limits: dict[str, float | None] = {item.quantity: item.limit for item in DEFAULTS}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals or name not in limits:
            raise UsageError(
                f"--limit {text}: write NAME=VALUE or NAME={LEFT_OUT}; names are {', '.join(limits)}"
            )
        try:
            limits[name] = None if value == LEFT_OUT else float(value)
        except ValueError as error:
            raise UsageError(f"--limit {text}: {value!r} is no number and not {LEFT_OUT!r}") from error
        if limits[name] is not None and not math.isfinite(float(value)):
            raise UsageError(f"--limit {text}: {value!r} is no limit; {name}={LEFT_OUT} leaves it out")
    return tuple(replace(item, limit=limits[item.quantity]) for item in DEFAULTS)


def compare_criteria(criteria: Iterable[Criterion], quantities: Mapping[str, Quantity]) -> list[Comparison]:
    """Compare each criterion with its quantity and return the results in the order of the criteria.

    A quantity with an interval passes if the complete interval meets the limit, and fails if none of it does.
    Raises KeyError for a criterion without a quantity.
    """
    return [
        Comparison(criterion=item, quantity=quantities[item.quantity], state=state, reason=reason)
        for item in criteria
        for state, reason in [_assess_criterion(item, quantities[item.quantity])]
    ]


def _assess_criterion(criterion: Criterion, quantity: Quantity) -> tuple[State, str]:
    """Return the state of a criterion and its reason, which is empty for "pass" and "fail".

    "left out" without a limit, "does not apply" as the quantity, "undecided" if the quantity has no value or
    its interval contains the limit.
    """
    if criterion.limit is None:
        return "left out", "no limit is set"
    if not quantity.applies:
        return "does not apply", quantity.missing
    if quantity.value is None:
        return "undecided", quantity.missing
    ends = [quantity.value if end is None else end for end in (quantity.low, quantity.high)]
    meets = [
        end <= criterion.limit if criterion.sense == "at most" else end >= criterion.limit for end in ends
    ]
    if all(meets):
        return "pass", ""
    return ("undecided", "the interval contains the limit") if any(meets) else ("fail", "")


def determine_outcome(comparisons: Sequence[Comparison]) -> Outcome:
    """Return "fail" if a criterion fails, "incomplete" if one is undecided, otherwise "pass"."""
    states = {item.state for item in comparisons}
    return "fail" if "fail" in states else "incomplete" if "undecided" in states else "pass"
