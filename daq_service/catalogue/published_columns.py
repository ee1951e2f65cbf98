"""Columns of rows in the API, its client, and exported tables.

Times are RFC 3339 text, in addition to hours of the experiment; a unit is in the name of its column.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import NoneType
from typing import Any, Literal, get_args, get_origin

from analysis.diagnosis.hypotheses import CAUSES, OK
from daq_service.catalogue.rows import (
    MEASURED,
    AlarmRow,
    AssessmentRow,
    BaselineRow,
    FeatureRow,
    Row,
    list_columns,
)
from hardware_drivers.units import find_unit

Form = Literal["number", "integer", "truth", "time", "text", "nested"]
Purposes = Literal["planned", "confirmation", "any"]
"""Selected sets: scheduled sets, unscheduled sets, or both."""
_FORMS: dict[object, Form] = {float: "number", int: "integer", bool: "truth", str: "text"}


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedColumn:
    """A column; ``time`` is RFC 3339 text, ``nested`` lists and tables; an empty ``unit``: it has none."""

    name: str
    form: Form
    unit: str
    nullable: bool


ADDED_COLUMNS: Mapping[type[Row], tuple[PublishedColumn, ...]] = {
    BaselineRow: (
        PublishedColumn(name="from_h", form="number", unit="h", nullable=False),
        PublishedColumn(name="from_utc", form="time", unit="", nullable=False),
        PublishedColumn(name="to_h", form="number", unit="h", nullable=False),
        PublishedColumn(name="to_utc", form="time", unit="", nullable=False),
        PublishedColumn(name="temperature_c", form="nested", unit="degC", nullable=True),
    ),
    FeatureRow: (PublishedColumn(name="standard_error", form="nested", unit="", nullable=True),),
    AssessmentRow: (PublishedColumn(name="quality", form="text", unit="", nullable=True),),
    AlarmRow: (
        PublishedColumn(name="headline", form="text", unit="", nullable=False),
        PublishedColumn(name="action", form="text", unit="", nullable=False),
        PublishedColumn(name="response_time_s", form="number", unit="s", nullable=False),
        PublishedColumn(name="evidence_sentences", form="nested", unit="", nullable=False),
    ),
}
"""Columns that the service adds: hours and temperatures of a baseline, assessed quality, alarm texts.

Standard errors of features are those of the means of sets, None for a single shot."""


def _build_part(name: str, form: Form = "number") -> PublishedColumn:
    """Create the published column for a part of a nested value: nullable, a number's unit by its name."""
    return PublishedColumn(
        name=name, form=form, unit=find_unit(name) if form == "number" else "", nullable=True
    )


PARTS: Mapping[type[Row], Mapping[tuple[str, ...], PublishedColumn]] = {
    BaselineRow: {
        **{("baseline_quality", name): _build_part(name) for name in ("n_eff", "phi_pooled", "tail")},
        ("baseline_quality", "false_alarms_per_sensor_year"): _build_part("false_alarms_per_sensor_year"),
        ("baseline_quality", "rate_verified"): _build_part("rate_verified", "truth"),
        ("baseline_quality", "rate_not_verified_reason"): _build_part("rate_not_verified_reason", "text"),
        ("limits", "mewma"): _build_part("mewma_limit"),
        ("limits", "default"): _build_part("limit_default"),
    },
    FeatureRow: {
        ("standard_error", name): _build_part(f"standard_error_{name}") for name in MEASURED[FeatureRow]
    },
    AssessmentRow: {
        ("limits", "mewma"): _build_part("mewma_limit"),
        **{
            ("diagnosis_details", "probabilities", name): _build_part(f"probability_{name}")
            for name in (OK, *CAUSES)
        },
    },
}
"""Values of nested columns as columns of tables, where the nested ones are JSON text."""


def add_nested(kind: type[Row], row: Mapping[str, object]) -> dict[str, object]:
    """Return a copy of a row that also has the parts of nested values in `PARTS`; None for a missing part."""
    extended = dict(row)
    for path, column in PARTS.get(kind, {}).items():
        value: Any = row
        for name in path:
            value = None if value is None else value.get(name)
        extended[column.name] = value
    return extended


def list_shown_columns(kind: type[Row]) -> tuple[PublishedColumn, ...]:
    """List the published columns of a kind of row: stored, UTC times of hours, added, nested parts."""
    columns: dict[str, PublishedColumn] = {}
    for column in list_columns(kind):
        name = column.published_name
        form = choose_published_form(column.type) if name == column.name else "time"
        unit = find_unit(name) if form in ("number", "integer") else ""
        columns[name] = PublishedColumn(name=name, form=form, unit=unit, nullable=column.nullable)
    for hours in [column for column in columns.values() if column.unit == "h"]:
        name = hours.name.removesuffix("_h") + "_utc"
        time = PublishedColumn(name=name, form="time", unit="", nullable=hours.nullable)
        columns.setdefault(name, time)
    return (*columns.values(), *ADDED_COLUMNS.get(kind, ()), *PARTS.get(kind, {}).values())


def choose_published_form(of_type: Any) -> Form:
    """Return the form in which values of a Python type are published; "nested" for lists and unknown types.

    None in a union is ignored; a Literal is "text".
    """
    plain = next((kind for kind in get_args(of_type) if kind is not NoneType), of_type)
    if get_origin(of_type) is Literal or get_origin(plain) is Literal:
        return "text"
    return _FORMS.get(of_type if get_origin(of_type) else plain, _FORMS.get(plain, "nested"))
