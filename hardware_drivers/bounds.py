"""Bounds of parameters, written once next to the value they bound.

The bounds are `annotated_types` metadata. A class decorated with `bounded` enforces them for callers in
Python, and a configuration model that embeds it enforces the same ones while reading a file.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar, dataclass_transform, get_args, get_type_hints

from annotated_types import Ge, Gt, Le, Lt

_COMPARISONS: tuple[tuple[type, str, str, Callable[[Any, Any], bool]], ...] = (
    (Gt, "gt", "greater than", operator.gt),
    (Ge, "ge", "at least", operator.ge),
    (Lt, "lt", "less than", operator.lt),
    (Le, "le", "at most", operator.le),
)

_PAIRS: Mapping[str, Callable[[Any, Any], bool]] = {
    "at least": operator.ge,
    "at most": operator.le,
    "above": operator.gt,
    "later than": operator.gt,
    "below": operator.lt,
    "less than": operator.lt,
}

Parameters = TypeVar("Parameters")

_Bound = tuple[str, Any, Callable[[Any, Any], bool]]

_resolved: dict[type, dict[str, list[_Bound]]] = {}


def _resolve_bounds(parameters: type) -> dict[str, list[_Bound]]:
    """Return the bounds of each field of a parameter class by field name, as `_find_bounds` does.

    They are resolved once per class and cached.
    """
    if parameters not in _resolved:
        hints = get_type_hints(parameters, include_extras=True)
        _resolved[parameters] = {field.name: _find_bounds(hints[field.name]) for field in fields(parameters)}
    return _resolved[parameters]


def _find_bounds(hint: Any) -> list[_Bound]:
    """Return the bounds of a type hint as tuples (relation, limit, comparison); empty if it has none.

    Bounds of the members of a union count too: ``Annotated[float, Gt(0.0)] | None``.
    """
    marks = getattr(hint, "__metadata__", ())
    if not marks:
        marks = [mark for part in get_args(hint) for mark in getattr(part, "__metadata__", ())]
    return [
        (relation, getattr(mark, attribute), holds)
        for mark in marks
        for kind, attribute, relation, holds in _COMPARISONS
        if isinstance(mark, kind)
    ]


def check_bounds(parameters: Any) -> None:
    """Raise ValueError for the first field, in order, whose value breaks a bound; name it, value and limit.

    A float that is not finite breaks every bound, None breaks no bound.
    """
    _check_named_values(
        (name, bounds, getattr(parameters, name))
        for name, bounds in _resolve_bounds(type(parameters)).items()
    )


def check_value_bounds(parameters: type, values: Mapping[str, Any]) -> None:
    """Check values, given by field name, against the bounds of a parameter class without building it.

    Raise ValueError as `check_bounds` does, KeyError for a name that is no field.
    """
    bounds = _resolve_bounds(parameters)
    _check_named_values((name, bounds[name], value) for name, value in values.items())


def _check_named_values(checked: Iterable[tuple[str, list[_Bound], Any]]) -> None:
    """Raise ValueError for the first value that breaks one of its bounds, or is a float that is not finite.

    ``checked`` has name, bounds and value of each; None breaks no bound.
    """
    for name, bounds, value in checked:
        if value is None:
            continue
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"{name} is {value}; it must be a finite number")
        for relation, limit, holds in bounds:
            if not holds(value, limit):
                raise ValueError(f"{name} is {value}; it must be {relation} {limit}")


def check_field_relation(parameters: Any, name: str, relation: str, other: str, unit: str = "") -> None:
    """Raise ValueError unless the value of one field has a given relation to that of another.

    Parameters
    ----------
    name, other
        Fields of `parameters`; the message names both, their values and what the first must be.
    relation
        A key of `_PAIRS`, such as ``at most``; any other is a KeyError.
    unit
        Unit as printed after a value, with its space.
    """
    value, limit = getattr(parameters, name), getattr(parameters, other)
    if not _PAIRS[relation](value, limit):
        raise ValueError(f"{name} is {value}{unit}; it must be {relation} {other} ({limit}{unit})")


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(field,))
def bounded(parameters: type[Parameters]) -> type[Parameters]:
    """Make a class a frozen, keyword-only dataclass with slots whose values obey their bounds.

    Construction raises ValueError as `check_bounds` does. Relations between fields are checked by the class's
    own `__post_init__`, which runs after the bounds. Embedded in a pydantic model the class rejects unknown
    keys.
    """
    own_checks: Callable[[Parameters], None] | None = getattr(parameters, "__post_init__", None)

    def check_all(parameters_object: Parameters) -> None:
        """Check the bounds, then run the class's own `__post_init__`; ValueError of either passes through."""
        check_bounds(parameters_object)
        if own_checks is not None:
            own_checks(parameters_object)

    untyped: Any = parameters
    untyped.__post_init__ = check_all
    untyped.__pydantic_config__ = {"extra": "forbid"}
    return dataclass(frozen=True, slots=True, kw_only=True)(parameters)
