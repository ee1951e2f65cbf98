"""Bounds of parameters, written once beside the value they bound.

The bounds are `annotated_types` metadata: `check_bounds` enforces them for callers in Python, and
a configuration model that embeds the dataclasses enforces the same ones while reading a file.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields
from typing import Any, get_type_hints

from annotated_types import Ge, Gt, Le, Lt

_COMPARISONS: tuple[tuple[type, str, str, Callable[[Any, Any], bool]], ...] = (
    (Gt, "gt", "greater than", lambda value, bound: value > bound),
    (Ge, "ge", "at least", lambda value, bound: value >= bound),
    (Lt, "lt", "less than", lambda value, bound: value < bound),
    (Le, "le", "at most", lambda value, bound: value <= bound),
)

_resolved: dict[type, dict[str, Any]] = {}


def _annotations(parameters: type) -> dict[str, Any]:
    """Resolve the annotations of a class once: every shot with its own scatter checks its bounds."""
    if parameters not in _resolved:
        _resolved[parameters] = get_type_hints(parameters, include_extras=True)
    return _resolved[parameters]


def check_bounds(parameters: Any) -> None:
    """Raise ValueError naming the field, its value and its limit if a bound is broken."""
    hints = _annotations(type(parameters))
    for field in fields(parameters):
        value = getattr(parameters, field.name)
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"{field.name} is {value}; it must be a finite number")
        for mark in getattr(hints[field.name], "__metadata__", ()):
            for kind, attribute, words, holds in _COMPARISONS:
                if isinstance(mark, kind) and not holds(value, getattr(mark, attribute)):
                    limit = getattr(mark, attribute)
                    raise ValueError(f"{field.name} is {value}; it must be {words} {limit}")
