"""`/api/v1/trends/{position}`: columns over the test, one entry a set, for charts and analysis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from fastapi import APIRouter, Query

from daq_service.catalogue.reader import Filters
from daq_service.catalogue.rows import VerdictRow
from daq_service.judgement.methods import METHODS
from daq_service.web.answers.json_answer import JsonAnswer, rfc3339_of_hour
from daq_service.web.answers.models import Trend, problems
from daq_service.web.answers.problem import Problem
from daq_service.web.context import Context, ContextOf
from daq_service.web.routes.listing import FromHour, ToHour, last_hour

router = APIRouter(tags=["trends"])

VERDICTS = ("distance_squared", "limit_f", "limit_paper", "outlier", "outlier_paper", "in_baseline", "reason")
COMMON = ("set_index", "due_h", "quality")


def unit_of(field: str) -> str:
    """Read a column's unit from its name; 1 is a pure number."""
    for suffix, unit in (("_v_s", "V s"), ("_s", "s"), ("_v", "V"), ("_m", "m"), ("_h", "h")):
        if field.endswith(suffix):
            return unit
    return "1"


def checked_fields(method: str, fields: str | None, *, known: Sequence[str]) -> list[str]:
    """Names from a comma-separated list.

    Raises
    ------
    Problem
        422: a name that this method does not have.
    """
    if fields is None:
        return list(known)
    chosen = list(dict.fromkeys(part.strip() for part in fields.split(",") if part.strip()))
    unknown = sorted(set(chosen) - set(known))
    if unknown or not chosen:
        raise Problem(
            422,
            "invalid-request",
            "Unknown field",
            f"{', '.join(unknown) or '(no field)'} is not measured by the method {method}.",
            f"Choose from {', '.join(known)}.",
        )
    return chosen


@router.get(
    "/trends/{position}",
    operation_id="get_trend",
    response_model=Trend,
    responses=problems(404, 422, 503),
)
def get_trend(
    context: ContextOf,
    position: str,
    fields: Annotated[
        str | None, Query(max_length=1000, description="Comma-separated columns; absent: all of the method")
    ] = None,
    from_h: FromHour = None,
    to_h: ToHour = None,
) -> JsonAnswer:
    """Tell features or thickness of all sets, with verdicts beside them, by column."""
    method = context.settings.positions[context.known(position)].method
    chosen = checked_fields(method, fields, known=(*METHODS[method].values, *VERDICTS))
    last_h = last_hour(from_h, to_h)
    fresh = context.freshness()
    columns = read_columns(context, position, chosen, from_h, last_h)
    columns["due_utc"] = [rfc3339_of_hour(fresh.epoch_utc_ns, hour) for hour in columns["due_h"]]
    columns["age_h"] = [fresh.age_h(hour) for hour in columns["due_h"]]
    return JsonAnswer(
        {
            "position": position,
            "method": method,
            "as_of": fresh.as_of(),
            "units": {name: unit_of(name) for name in ("due_h", "age_h", *chosen) if name not in _UNITLESS},
            "columns": columns,
        }
    )


_UNITLESS = frozenset({"outlier", "outlier_paper", "in_baseline", "reason"})


def measured_columns(
    context: Context, position: str, names: Sequence[str], first_h: float | None, last_h: float | None
) -> dict[str, list[Any]]:
    """Read columns of what the position's method measured, one entry a set."""
    method = METHODS[context.settings.positions[position].method]
    filters: Filters = {"position": position, "first_h": first_h, "last_h": last_h, **method.of_sets}
    return context.catalogue().columns(method.row, names, **filters)


def read_columns(
    context: Context, position: str, fields: Sequence[str], from_h: float | None, last_h: float | None
) -> dict[str, list[Any]]:
    """Read `COMMON` and the chosen columns; a set without verdict has null in the verdict's columns."""
    own = [name for name in fields if name in METHODS[context.settings.positions[position].method].values]
    judged = [name for name in fields if name in VERDICTS]
    columns = measured_columns(context, position, [*COMMON, *own], from_h, last_h)
    if judged:
        verdicts = context.catalogue().columns(
            VerdictRow, ["set_index", *judged], position=position, first_h=from_h, last_h=last_h
        )
        row_of = {index: row for row, index in enumerate(verdicts["set_index"])}
        rows = [row_of.get(index) for index in columns["set_index"]]
        for name in judged:
            values = verdicts[name]
            columns[name] = [None if row is None else values[row] for row in rows]
    return columns
