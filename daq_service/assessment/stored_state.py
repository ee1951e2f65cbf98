"""State of an assessor as JSON that is exact to the last bit, and the catalogue rows that keep it.

A state is a frozen dataclass of numbers, texts, arrays and further dataclasses. Its type directs the reading.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from daq_service.catalogue.rows import AssessorStateRow

S = TypeVar("S")

STATE_FORMAT = 1
"""Version of the stored states; a state of another version is computed from the stored sets."""
FROZEN_FIELDS = frozenset({"healthy", "n_left_out", "baseline", "reference"})
"""Fields of a state that rarely change. They are large and have a row of their own."""


def state_rows(
    before: Any, after: Any, *, position: str, baseline_id: int | None, configuration_hash: str
) -> list[AssessorStateRow]:
    """Return the rows of a state that differ from those of the state before; None: all of them."""
    parts = {"frozen": FROZEN_FIELDS, "running": {item.name for item in fields(after)} - FROZEN_FIELDS}
    rows = []
    for part, names in parts.items():
        values = {item.name: getattr(after, item.name) for item in fields(after) if item.name in names}
        if before is not None and all(getattr(before, name) is value for name, value in values.items()):
            continue
        rows.append(
            AssessorStateRow(
                place=f"{position}/{part}",
                position=position,
                baseline_id=baseline_id,
                configuration_hash=configuration_hash,
                format=STATE_FORMAT,
                state=json.dumps(values, default=_encoded, separators=(",", ":")),
            )
        )
    return rows


def state_of(kind: type[S], rows: Iterable[AssessorStateRow]) -> S:
    """Return the state that rows keep."""
    values: dict[str, object] = {}
    for row in rows:
        values |= json.loads(row.state)
    decoded: S = _decoded(kind, values)
    return decoded


def _encoded(value: object) -> object:
    if isinstance(value, np.ndarray):
        assert value.flags.c_contiguous, "in another order sums would be rounded otherwise"
        content = base64.b64encode(value.tobytes()).decode()
        return {"dtype": value.dtype.str, "shape": value.shape, "base64": content}
    if is_dataclass(value):
        return {item.name: getattr(value, item.name) for item in fields(value) if item.init}
    raise TypeError(f"a state has no {type(value)}")


def _decoded(kind: Any, value: Any) -> Any:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        (kind,) = (argument for argument in arguments if argument is not NoneType)
        return None if value is None else _decoded(kind, value)
    if origin is np.ndarray:
        content = np.frombuffer(base64.b64decode(value["base64"]), dtype=value["dtype"])
        array = content.reshape(value["shape"]).copy()
        array.flags.writeable = False
        return array
    if isinstance(kind, type) and is_dataclass(kind):
        hints = _hints(kind)
        return kind(**{name: _decoded(hints[name], item) for name, item in value.items()})
    if origin is not None and issubclass(origin, Mapping):
        return {name: _decoded(arguments[1], item) for name, item in value.items()}
    if origin is tuple and arguments[-1] is not Ellipsis:
        return tuple(_decoded(argument, item) for argument, item in zip(arguments, value, strict=True))
    if origin is not None and issubclass(origin, Sequence):
        items = [_decoded(arguments[0], item) for item in value]
        return items if origin is list else tuple(items)
    return value


@cache
def _hints(kind: type) -> dict[str, object]:
    return get_type_hints(kind)
