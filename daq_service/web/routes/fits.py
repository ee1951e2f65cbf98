"""`/api/v1/fits/{position}`: second-order polynomial through a trend (figures 8, 9 and 11 of the paper)."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from daq_service.assessment.methods import METHODS
from daq_service.catalogue.rollups import trend_part
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import Fit, problems
from daq_service.web.context import ContextOf
from daq_service.web.routes.listing import FromHour, ToHour, last_hour
from daq_service.web.routes.trends import checked_fields, unit_of

router = APIRouter(tags=["trends"])


@router.get("/fits/{position}", response_model=Fit, responses=problems(404, 503))
def get_fit(
    context: ContextOf,
    position: str,
    field: Annotated[str, Query(max_length=40, description="A measured column of the position's method")],
    from_h: FromHour = None,
    to_h: ToHour = None,
) -> JsonAnswer:
    """Fit the sets in the range; sets without a value (null) are excluded."""
    from analysis.errors import NotEnoughPointsError
    from analysis.statistics.trend import trend_of_part

    method = context.settings.positions[context.checked_position(position)].method
    (name,) = checked_fields(method, field.replace(",", " "), known=METHODS[method].values)
    fresh = context.freshness()
    part = trend_part(context.catalogue(), position, name, first_h=from_h, last_h=last_hour(from_h, to_h))
    n = int(part["n"])
    answer: dict[str, object] = {
        "position": position,
        "field": name,
        "unit": unit_of(name),
        "n": n,
        "coefficients": None,
        "r_squared": None,
        "residual_sd": None,
        "from_h": float(part["first_h"]) if n else None,
        "to_h": float(part["last_h"]) if n else None,
        "reason": None,
        "as_of": fresh.as_of(),
    }
    try:
        trend = trend_of_part(part)
    except NotEnoughPointsError as error:
        answer["reason"] = str(error)
    else:
        answer["coefficients"] = [trend.constant, trend.linear, trend.quadratic]
        answer["r_squared"] = trend.r_squared
        answer["residual_sd"] = trend.residual_sd
    return JsonAnswer(answer)
