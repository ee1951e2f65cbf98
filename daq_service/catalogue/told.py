"""Rows as others get them: the API, its client, and tables that are exported have these columns.

Times are RFC 3339 text beside hours of the experiment; a unit is in the name of its column.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import NoneType
from typing import Any, Literal, get_args, get_origin

from daq_service.catalogue.rows import AlarmRow, BaselineRow, Row, VerdictRow, columns_of
from hardware_drivers.units import unit_of

Form = Literal["number", "integer", "truth", "time", "text", "nested"]
Purposes = Literal["planned", "confirmation", "any"]
"""Which sets are meant: those of the plan, those beside it, or both."""
_FORMS: dict[Any, Form] = {float: "number", int: "integer", bool: "truth", str: "text"}


@dataclass(frozen=True, slots=True, kw_only=True)
class ToldColumn:
    """A column; ``time`` is RFC 3339 text, ``nested`` lists and tables; an empty ``unit``: it has none."""

    name: str
    form: Form
    unit: str
    nullable: bool


BESIDE: Mapping[type[Row], tuple[ToldColumn, ...]] = {
    BaselineRow: (
        ToldColumn(name="from_h", form="number", unit="h", nullable=False),
        ToldColumn(name="from_utc", form="time", unit="", nullable=False),
        ToldColumn(name="to_h", form="number", unit="h", nullable=False),
        ToldColumn(name="to_utc", form="time", unit="", nullable=False),
        ToldColumn(name="temperature_c", form="nested", unit="degC", nullable=True),
    ),
    VerdictRow: (ToldColumn(name="quality", form="text", unit="", nullable=True),),
    AlarmRow: (ToldColumn(name="proof_sentences", form="nested", unit="", nullable=False),),
}
"""What the service adds: hours and temperatures of a baseline, a judged quality, a proof in sentences."""


def told_columns(kind: type[Row]) -> tuple[ToldColumn, ...]:
    """Columns of a kind of row in their order, the time of each hour and what is added behind them."""
    found: dict[str, ToldColumn] = {}
    for column in columns_of(kind):
        name, form = column.name, _form(column.type)
        if name == "utc_ns" or name.endswith("_utc_ns"):
            name, form = name.removesuffix("_ns"), "time"
        unit = unit_of(name) if form in ("number", "integer") else ""
        found[name] = ToldColumn(name=name, form=form, unit=unit, nullable=column.nullable)
    for hours in [column for column in found.values() if column.unit == "h"]:
        name = hours.name.removesuffix("_h") + "_utc"
        time = ToldColumn(name=name, form="time", unit="", nullable=hours.nullable)
        found.setdefault(name, time)
    return (*found.values(), *BESIDE.get(kind, ()))


def _form(of_type: Any) -> Form:
    plain = next((kind for kind in get_args(of_type) if kind is not NoneType), of_type)
    if get_origin(of_type) is Literal or get_origin(plain) is Literal:
        return "text"
    return _FORMS.get(of_type if get_origin(of_type) else plain, _FORMS.get(plain, "nested"))
