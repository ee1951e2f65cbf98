"""Frozen dataclasses of numbers, texts, arrays and further dataclasses as JSON, exact to the last bit.

The type directs the reading.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

T = TypeVar("T")


def to_json(values: Mapping[str, object]) -> str:
    """Serialize fields of a dataclass, given by name, as compact JSON; arrays keep every bit.

    Arrays must be C-contiguous. Raise TypeError for a value that is no JSON type, array or dataclass.
    """
    return json.dumps(values, default=_encode_value, separators=(",", ":"))


def from_json(kind: type[T], *texts: str) -> T:
    """Restore a dataclass of type ``kind`` from JSON texts that together hold its fields, as `to_json` wrote.

    Raise ValueError for text that is no JSON, KeyError for an unknown field, TypeError for a missing one.
    """
    values: dict[str, object] = {}
    for text in texts:
        values |= json.loads(text)
    decoded: T = _decode_value(kind, values)
    return decoded


def _encode_value(value: object) -> object:
    """Convert an array (base64 of its bytes) or a dataclass (fields by name) to JSON types.

    Raise TypeError for any other value.
    """
    if isinstance(value, np.ndarray):
        assert value.flags.c_contiguous, "in another order sums would be rounded otherwise"
        content = base64.b64encode(value.tobytes()).decode()
        return {"dtype": value.dtype.str, "shape": value.shape, "base64": content}
    if is_dataclass(value):
        return {item.name: getattr(value, item.name) for item in fields(value) if item.init}
    raise TypeError(f"a state has no {type(value)}")


def _decode_value(kind: Any, value: Any) -> Any:
    """Restore a value of the declared type ``kind`` from its JSON form; arrays become read-only.

    Sequences not declared as a list become tuples. Raise KeyError for an unknown field of a dataclass,
    TypeError for a missing one.
    """
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        (kind,) = (argument for argument in arguments if argument is not NoneType)
        return None if value is None else _decode_value(kind, value)
    if origin is np.ndarray:
        content = np.frombuffer(base64.b64decode(value["base64"]), dtype=value["dtype"])
        array = content.reshape(value["shape"]).copy()
        array.flags.writeable = False
        return array
    if isinstance(kind, type) and is_dataclass(kind):
        hints = _resolve_type_hints(kind)
        return kind(**{name: _decode_value(hints[name], item) for name, item in value.items()})
    if origin is not None and issubclass(origin, Mapping):
        return {name: _decode_value(arguments[1], item) for name, item in value.items()}
    if origin is tuple and arguments[-1] is not Ellipsis:
        return tuple(_decode_value(argument, item) for argument, item in zip(arguments, value, strict=True))
    if origin is not None and issubclass(origin, Sequence):
        items = [_decode_value(arguments[0], item) for item in value]
        return items if origin is list else tuple(items)
    return value


@cache
def _resolve_type_hints(kind: type) -> dict[str, object]:
    """Return the resolved types of a dataclass's fields by name; computed once per class."""
    return get_type_hints(kind)
