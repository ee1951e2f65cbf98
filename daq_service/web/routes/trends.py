"""`/api/v1/trends/{position}`: columns over the test, and `/api/v1/fits/{position}`: their fit."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Query, Request
from numpy.typing import NDArray
from pydantic import StringConstraints, WithJsonSchema
from starlette.responses import Response

from daq_service.assessment.methods import METHODS
from daq_service.catalogue.reader import Filters
from daq_service.catalogue.rollups import QUALITIES, Kind, list_bin_value_names
from daq_service.catalogue.rows import AssessmentRow, WallRow
from daq_service.catalogue.standard_errors import read_error_columns
from daq_service.catalogue.trends import compute_trend_part, read_trend_bins
from daq_service.web.answers.json_answer import JsonAnswer, format_hours_as_rfc3339
from daq_service.web.answers.models import (
    TREND_ASSESSMENTS,
    TREND_FIELDS,
    TREND_STANDARD_ERRORS,
    TREND_WALL,
    UNCHANGED,
    Fit,
    Trend,
    describe_errors,
)
from daq_service.web.answers.problem import invalid
from daq_service.web.answers.unchanged import check_ended_test
from daq_service.web.context import Context, ContextOf
from daq_service.web.routes.listing import FromHour, ToHour, find_last_hour
from daq_service.web.tables.choice import Columns
from hardware_drivers.methods import SOLITARY_WAVE

router = APIRouter(tags=["trends"])

ASSESSMENTS, STANDARD_ERRORS = TREND_ASSESSMENTS, TREND_STANDARD_ERRORS
POINTS, MOST_POINTS = 500, 1000
"""Default and maximum number of entries of an answer."""
MOST_BYTES = 195_000
"""Limit of the columns of an answer; units and names need less than 5 kB."""
_SET_BYTES, _BIN_BYTES = 120, 210
"""Bytes of an entry without its values: index, hours, time, quality; for a bin also counts and sets."""
_NUMBER_BYTES, _WORD_BYTES, _REASON_BYTES = 25, 6, 200
"""Maximum bytes of a 64-bit number, a truth value and the reason of an assessment, with comma."""
COMMON = ("set_index", "due_h", "quality")


FieldName = Annotated[
    str, StringConstraints(max_length=1000), WithJsonSchema({"type": "string", "enum": list(TREND_FIELDS)})
]


def find_unit(field: str) -> str:
    """Return the unit of a column from the suffix of its name; "1" if no suffix names a unit."""
    for suffix, unit in (("_v_s", "V s"), ("_s", "s"), ("_v", "V"), ("_m", "m"), ("_h", "h")):
        if field.endswith(suffix):
            return unit
    return "1"


def parse_fields(
    method: str, fields: str | None, *, known: Sequence[str], extra: Collection[str] = ()
) -> list[str]:
    """Parse a comma-separated list of columns, without repetitions; None selects all known ones.

    Columns of ``extra`` may be chosen by name only.

    Raises
    ------
    Problem
        422: no column, or one that the method does not have.
    """
    if fields is None:
        return list(known)
    chosen = list(dict.fromkeys(part.strip() for part in fields.split(",") if part.strip()))
    unknown = sorted(set(chosen) - {*known, *extra})
    if unknown or not chosen:
        raise invalid(
            "Unknown field",
            f"{', '.join(unknown) or '(no field)'} is not measured by the method {method}.",
            f"Choose from {', '.join((*known, *extra))}.",
        )
    return chosen


@router.get("/trends/{position}", response_model=Trend, responses=UNCHANGED | describe_errors(404, 503))
def get_trend(
    request: Request,
    context: ContextOf,
    position: str,
    fields: Annotated[list[FieldName] | None, Query(max_length=50)] = None,
    from_h: FromHour = None,
    to_h: ToHour = None,
    points: Annotated[int, Query(ge=1, le=MOST_POINTS)] = POINTS,
) -> Response:
    """Return features or thickness with assessments by column, one entry per set or bin of sets.

    Where the range has more sets than points, an entry is a bin of `bin_sets` planned sets. Its columns
    hold means, the worst quality, the first set and hour, and whether any set is an outlier. A narrower
    range has smaller bins, at last single sets. Standard errors are given by name only, for single sets;
    so is the wall thickness of a transducer, of a bin its last one.
    Once the test has ended, the answer has an ETag. An unknown position: 404; an unknown column: 422.
    """
    method = context.settings.positions[context.validate_position(position)].method
    field_list = None if fields is None else ",".join(fields)
    known = (*METHODS[method].value_names, *ASSESSMENTS)
    extra = (*STANDARD_ERRORS, *TREND_WALL) if method == SOLITARY_WAVE else ()
    chosen = parse_fields(method, field_list, known=known, extra=extra)
    last_h = find_last_hour(from_h, to_h)
    fresh = context.read_freshness()
    headers, not_modified = check_ended_test(request, context.data_folder, fresh, is_dated=True)
    if not_modified is not None:
        return not_modified
    kind = METHODS[method].row
    set_bytes, bin_bytes = estimate_entry_bytes(chosen)
    binned = read_trend_bins(
        context.catalogue(),
        position,
        first_h=from_h,
        last_h=last_h,
        points=min(points, MOST_BYTES // set_bytes),
        most_bins=min(points, MOST_BYTES // bin_bytes),
    )
    bin_sets, bins_json = 1, None
    if binned is None:
        columns = read_trend_columns(context, position, chosen, from_h, last_h)
    else:
        bin_sets, bins = binned
        columns, bins_json = build_bin_columns(kind, bins, chosen), build_published_bins(kind, bins, chosen)
    if names := [name for name in TREND_WALL if name in chosen and method == SOLITARY_WAVE]:
        columns |= read_wall_columns(context, position, names, columns["set_index"], from_h, last_h)
    columns["due_utc"] = format_hours_as_rfc3339(fresh.epoch_utc_ns, columns["due_h"])
    columns["age_h"] = [fresh.age_h(hour) for hour in columns["due_h"]]
    return JsonAnswer(
        {
            "position": position,
            "method": method,
            "as_of": fresh.as_of(),
            "units": {name: find_unit(name) for name in ("due_h", "age_h", *chosen) if name not in _UNITLESS},
            "bin_sets": bin_sets,
            "columns": columns,
            "bins": bins_json,
        },
        headers=headers,
    )


def read_wall_columns(
    context: Context,
    position: str,
    names: Sequence[str],
    first_sets: Sequence[int],
    from_h: float | None,
    last_h: float | None,
) -> Columns:
    """Read the wall thickness of a transducer, one entry per set or bin (``first_sets``), None without one.

    Of a bin it is the last one. Raises StorageError if the catalogue cannot be read.
    """
    found = context.catalogue().columns(
        WallRow, ["set_index", *names], position=position, first_h=from_h, last_h=last_h
    )
    entries = np.searchsorted(first_sets, found["set_index"], side="right") - 1
    columns: Columns = {}
    for name in names:
        columns[name] = [None] * len(first_sets)
        for entry, value in zip(entries.tolist(), found[name], strict=True):
            columns[name][entry] = value
    return columns


def estimate_entry_bytes(fields: Sequence[str]) -> tuple[int, int]:
    """Return the maximum size in bytes of a set and of a bin in an answer with these columns (``fields``)."""
    numbers = [name for name in fields if name not in _UNITLESS]
    words = _WORD_BYTES * (len(fields) - len(numbers))
    of_set = _SET_BYTES + words + _NUMBER_BYTES * len(numbers) + _REASON_BYTES * ("reason" in fields)
    # A bin has mean, minimum, maximum and count of each value; it has no reason.
    return of_set, _BIN_BYTES + words + (3 * _NUMBER_BYTES + 8) * len(numbers)


_UNITLESS = frozenset({"outlier", "outlier_mean_3sd", "in_baseline", "reason"})


def read_measured_columns(
    context: Context, position: str, names: Sequence[str], first_h: float | None, last_h: float | None
) -> Columns:
    """Read columns of the measured values of a position, one entry per scheduled set in order.

    Both hours are included; None is open. Raises StorageError if the catalogue cannot be read.
    """
    method = METHODS[context.settings.positions[position].method]
    filters: Filters = {"position": position, "first_h": first_h, "last_h": last_h, **method.of_sets}
    return context.catalogue().columns(method.row, names, **filters)


def read_trend_columns(
    context: Context, position: str, fields: Sequence[str], from_h: float | None, last_h: float | None
) -> Columns:
    """Read `COMMON` and the selected columns, one entry per measured scheduled set in order.

    Both hours are included; None is open. A set without an assessment has None in its columns. Raises
    StorageError if the catalogue cannot be read.
    """
    measured_names = [
        name for name in fields if name in METHODS[context.settings.positions[position].method].value_names
    ]
    assessment_names = [name for name in fields if name in ASSESSMENTS]
    columns = read_measured_columns(context, position, [*COMMON, *measured_names], from_h, last_h)
    if assessment_names:
        assessments = context.catalogue().columns(
            AssessmentRow, ["set_index", *assessment_names], position=position, first_h=from_h, last_h=last_h
        )
        row_of = {index: row for row, index in enumerate(assessments["set_index"])}
        rows = [row_of.get(index) for index in columns["set_index"]]
        for name in assessment_names:
            values = assessments[name]
            columns[name] = [None if row is None else values[row] for row in rows]
    if names := [name for column, name in STANDARD_ERRORS.items() if column in fields]:
        filters: Filters = {"position": position, "first_h": from_h, "last_h": last_h}
        columns |= read_error_columns(context.catalogue(), names, columns["set_index"], **filters)
    return columns


_FLAGS = {
    "outlier": ("n_judged", "n_outliers"),
    "outlier_mean_3sd": ("n_judged_paper", "n_outliers_mean_3sd"),
    "in_baseline": ("n_sets", "n_in_baseline"),
}
"""Column: number of sets with a value, and number of sets where it is true."""
_COUNTS = ("n_sets", "n_missed", "n_outliers", "n_outliers_mean_3sd", "n_alarms")
_SETS_IN_A_BIN = {
    "last_set_index": "last_set",
    "first_outlier_set_index": "first_outlier",
    "first_alarm_set_index": "first_alarm",
}


def build_bin_columns(kind: Kind, bins: NDArray[np.void], fields: Sequence[str]) -> Columns:
    """Build the columns of `read_trend_columns` from bins of sets (`kind`: class of the measured rows).

    One entry per bin: values are means, quality is the worst one, flags are true if any set has them, index
    and hour are those of the first set, and ``reason`` is None.
    """
    columns: Columns = {
        "set_index": bins["first_set"].astype(int).tolist(),
        "due_h": bins["first_h"].tolist(),
        "quality": [
            QUALITIES[int(worst)] if math.isfinite(worst) else None for worst in bins["worst_quality"]
        ],
    }
    for name in fields:
        if name == "reason":  # differs by set
            columns[name] = [None] * bins.size
        elif name in _FLAGS:
            known_counts, true_counts = (bins[column] for column in _FLAGS[name])
            columns[name] = [
                bool(n) if known else None for known, n in zip(known_counts, true_counts, strict=True)
            ]
        else:
            column = list_bin_value_names(kind).index(name) if name in list_bin_value_names(kind) else None
            columns[name] = [None] * bins.size if column is None else _compute_means(bins, column)
    return columns


def _compute_means(bins: NDArray[np.void], column: int) -> list[float]:
    """Return the mean of a value column (its index) in each bin; NaN for a bin without values."""
    count, total = bins["count"][:, column], bins["sum"][:, column]
    mean = np.divide(total, count, out=np.full(bins.size, np.nan), where=count > 0.0)
    # The mean of equal numbers is that number, not its neighbour.
    return np.clip(mean, bins["minimum"][:, column], bins["maximum"][:, column]).tolist()  # type: ignore[no-any-return] # of NumPy


def build_published_bins(kind: Kind, bins: NDArray[np.void], fields: Sequence[str]) -> dict[str, object]:
    """Build the further values of bins for an answer: extremes, counts, last set and hour.

    Also the first outlier and alarm of each bin; None without a value. ``kind`` is the class of the measured
    rows.
    """
    names = [name for name in list_bin_value_names(kind) if name in fields]
    column_of = {name: list_bin_value_names(kind).index(name) for name in names}
    return {
        "minimum": {name: _to_finite_list(bins["minimum"][:, column]) for name, column in column_of.items()},
        "maximum": {name: _to_finite_list(bins["maximum"][:, column]) for name, column in column_of.items()},
        "count": {name: bins["count"][:, column].astype(int).tolist() for name, column in column_of.items()},
        "last_h": bins["last_h"].tolist(),
        **{name: bins[name].astype(int).tolist() for name in _COUNTS},
        **{
            key: [int(index) if math.isfinite(index) else None for index in bins[name]]
            for key, name in _SETS_IN_A_BIN.items()
        },
    }


def _to_finite_list(column: NDArray[np.float64]) -> list[float | None]:
    """Convert a column to a list for JSON; None replaces values that are not finite."""
    return [value if math.isfinite(value) else None for value in column.tolist()]


@router.get("/fits/{position}", response_model=Fit, responses=describe_errors(404, 503))
def get_fit(
    context: ContextOf,
    position: str,
    field: Annotated[str, Query(max_length=40, description="A measured column of the position's method")],
    from_h: FromHour = None,
    to_h: ToHour = None,
) -> JsonAnswer:
    """Fit a second-order polynomial to the sets in the range; sets without a value (null) are excluded.

    With too few sets the coefficients are null, and `reason` states why. An unknown position is answered with
    404, a column that its method does not have with 422.
    """
    from analysis.errors import NotEnoughPointsError
    from analysis.statistics.trend import fit_trend_of_part

    method = context.settings.positions[context.validate_position(position)].method
    (name,) = parse_fields(method, field.replace(",", " "), known=METHODS[method].value_names)
    fresh = context.read_freshness()
    part = compute_trend_part(
        context.catalogue(), position, name, first_h=from_h, last_h=find_last_hour(from_h, to_h)
    )
    n, trend, reason = int(part["n"]), None, None
    try:
        trend = fit_trend_of_part(part)
    except NotEnoughPointsError as error:
        reason = str(error)
    return JsonAnswer(
        {
            "position": position,
            "field": name,
            "unit": find_unit(name),
            "n": n,
            "coefficients": None if trend is None else [trend.constant, trend.linear, trend.quadratic],
            "r_squared": None if trend is None else trend.r_squared,
            "residual_sd": None if trend is None else trend.residual_sd,
            "from_h": float(part["first_h"]) if n else None,
            "to_h": float(part["last_h"]) if n else None,
            "reason": reason,
            "as_of": fresh.as_of(),
        }
    )
