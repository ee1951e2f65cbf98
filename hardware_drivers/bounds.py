"""Bounds of parameters, written once beside the value they bound.

The bounds are `annotated_types` metadata: `check_bounds` enforces them for callers in Python, and
a configuration model that embeds the dataclasses enforces the same ones while reading a file.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields
from typing import Any, get_args, get_type_hints

from annotated_types import Ge, Gt, Le, Lt

_COMPARISONS: tuple[tuple[type, str, str, Callable[[Any, Any], bool]], ...] = (
    (Gt, "gt", "greater than", lambda value, bound: value > bound),
    (Ge, "ge", "at least", lambda value, bound: value >= bound),
    (Lt, "lt", "less than", lambda value, bound: value < bound),
    (Le, "le", "at most", lambda value, bound: value <= bound),
)

_Bound = tuple[str, Any, Callable[[Any, Any], bool]]

_resolved: dict[type, list[tuple[str, list[_Bound]]]] = {}


def _bounds(parameters: type) -> list[tuple[str, list[_Bound]]]:
    """Resolve the bounds of a class once: every shot with its own scatter checks them."""
    if parameters not in _resolved:
        hints = get_type_hints(parameters, include_extras=True)
        _resolved[parameters] = [(field.name, _of_hint(hints[field.name])) for field in fields(parameters)]
    return _resolved[parameters]


def _of_hint(hint: Any) -> list[_Bound]:
    """Bounds of a type, also where it may be absent: ``Annotated[float, Gt(0.0)] | None``."""
    marks = getattr(hint, "__metadata__", ())
    if not marks:
        marks = [mark for part in get_args(hint) for mark in getattr(part, "__metadata__", ())]
    return [
        (words, getattr(mark, attribute), holds)
        for mark in marks
        for kind, attribute, words, holds in _COMPARISONS
        if isinstance(mark, kind)
    ]


def check_bounds(parameters: Any) -> None:
    """Raise ValueError naming the field, its value and its limit if a bound is broken."""
    for name, bounds in _bounds(type(parameters)):
        value = getattr(parameters, name)
        if value is None:
            continue
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"{name} is {value}; it must be a finite number")
        for words, limit, holds in bounds:
            if not holds(value, limit):
                raise ValueError(f"{name} is {value}; it must be {words} {limit}")
