"""Acceptance criteria with their limits, and the result."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from daq_service.cli.maintenance.acceptance.quantity import Quantity
from daq_service.errors import UsageError

Sense = Literal["at least", "at most"]
State = Literal["pass", "fail", "undecided", "does not apply", "left out"]
Outcome = Literal["pass", "fail", "incomplete"]

LEFT_OUT = "off"


@dataclass(frozen=True, slots=True, kw_only=True)
class Criterion:
    """A limit of one of the quantities; ``limit`` None: not required."""

    quantity: str
    sense: Sense
    limit: float | None


DEFAULTS: tuple[Criterion, ...] = (
    # Of the paper's 425 sets four may be lost, or one night's work of a colleague at the rig.
    Criterion(quantity="sets_taken_fraction", sense="at least", limit=0.99),
    Criterion(quantity="records_taken_fraction", sense="at least", limit=0.99),
    # The quality gate asks for 7 of 10: less than nine tenths over a test is a rig to be looked at.
    Criterion(quantity="records_valid_fraction", sense="at least", limit=0.9),
    # Two sets an hour apart may be lost in a row.
    Criterion(quantity="longest_gap_h", sense="at most", limit=3.0),
    # The corrosion of the paper changes by 0.3 % an hour: a minute is nothing, but a slow start has a cause.
    Criterion(quantity="start_delay_p99_s", sense="at most", limit=1.0),
    Criterion(quantity="start_delay_max_s", sense="at most", limit=60.0),
    Criterion(quantity="unplanned_ends", sense="at most", limit=0.0),
    # A test of a year and 8,760 sets would take 90 MB and 9 handles more.
    Criterion(quantity="resident_bytes_growth", sense="at most", limit=10e6),
    Criterion(quantity="open_handles_growth", sense="at most", limit=1.0),
    # The disk was chosen by the forecast of check-config.
    Criterion(quantity="growth_of_forecast", sense="at most", limit=1.25),
    Criterion(quantity="clock_step_max_s", sense="at most", limit=60.0),
    Criterion(quantity="clock_doubts", sense="at most", limit=0.0),
    Criterion(quantity="faults_standing", sense="at most", limit=0.0),
    Criterion(quantity="files_found_damaged", sense="at most", limit=0.0),
    Criterion(quantity="damage_found", sense="at most", limit=0.0),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Result of a criterion; ``why`` is the reason of its state."""

    criterion: Criterion
    quantity: Quantity
    state: State
    why: str


def with_limits(given: Sequence[str]) -> tuple[Criterion, ...]:
    """Return the criteria with given limits, as ``NAME=VALUE`` or ``NAME=off``.

    Raises
    ------
    UsageError
        No such criterion, or no number.
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
    return tuple(
        Criterion(quantity=item.quantity, sense=item.sense, limit=limits[item.quantity]) for item in DEFAULTS
    )


def compared(criteria: Iterable[Criterion], quantities: Mapping[str, Quantity]) -> list[Comparison]:
    """Compare each criterion with its quantity.

    A quantity with an interval passes if the complete interval meets the limit, and fails if none of it does.
    """
    return [
        Comparison(criterion=item, quantity=quantities[item.quantity], state=state, why=why)
        for item in criteria
        for state, why in [_state(item, quantities[item.quantity])]
    ]


def _state(criterion: Criterion, quantity: Quantity) -> tuple[State, str]:
    """Return the state of a criterion and its reason."""
    if criterion.limit is None:
        return "left out", "nobody asks for it"
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
    return ("undecided", "the limit lies within the interval") if any(meets) else ("fail", "")


def outcome(comparisons: Sequence[Comparison]) -> Outcome:
    """Return fail if a criterion fails, pass if all applicable ones pass, else incomplete."""
    states = {item.state for item in comparisons}
    return "fail" if "fail" in states else "incomplete" if "undecided" in states else "pass"
