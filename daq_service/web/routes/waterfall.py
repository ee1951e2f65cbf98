"""`/api/v1/waterfall/{position}`: all records of a position as one picture, hour by time."""

from __future__ import annotations

import hashlib
import json
import math
import struct
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from daq_service.archive import SetReference
from daq_service.archive.waterfall.cells import anchors_of
from daq_service.archive.waterfall.image import Picture, Wanted
from daq_service.assessment.baseline_lifecycle import baseline_range
from daq_service.assessment.results_in_file import results_in
from daq_service.catalogue import Catalogue
from daq_service.catalogue.owner import experiment_identity
from daq_service.catalogue.rows import AssessmentRow, SetRow
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import Waterfall, problems
from daq_service.web.answers.problem import invalid, not_found
from daq_service.web.answers.unchanged import unchanged
from daq_service.web.context import Context, ContextOf
from daq_service.web.routes.listing import FromHour, ToHour, last_hour
from daq_service.web.routes.waveforms import OCTET_STREAM, UNCHANGED
from hardware_drivers.methods import PULSE_ECHO

router = APIRouter(tags=["waveforms"])

ROWS, MOST_ROWS = 256, 512
COLUMNS, MOST_COLUMNS = 512, 1024
MOST_JSON_CELLS = 65_536
LONGEST_S = 1e3
FIRST_OF = {"solitary_wave": "isw", "pulse_echo": "first_echo"}
_LOOKED_AT = 50
"""Sets among which one with a sound record shows how the position is sampled."""

Seconds = Annotated[
    float | None,
    Query(ge=-LONGEST_S, le=LONGEST_S, allow_inf_nan=False, description="Time after the anchor"),
]


@router.get(
    "/waterfall/{position}",
    operation_id="get_waterfall",
    response_model=Waterfall,
    responses={
        200: {"content": {OCTET_STREAM: {"schema": {"type": "string", "format": "binary"}}}},
        204: {"description": "No record of the position is stored; /api/v1/sets tells why"},
        304: UNCHANGED,
        **problems(404, 422, 503),
    },
)
def get_waterfall(
    request: Request,
    context: ContextOf,
    position: str,
    from_h: FromHour = None,
    to_h: ToHour = None,
    from_s: Seconds = None,
    to_s: Seconds = None,
    rows: Annotated[int, Query(ge=1, le=MOST_ROWS, description="Most rows")] = ROWS,
    columns: Annotated[
        int, Query(ge=2, le=MOST_COLUMNS, description="Most columns of cells, a number without unit")
    ] = COLUMNS,
    align: Annotated[
        Literal["trigger", "isw", "first_echo"],
        Query(description="Where time counts from; isw and first_echo by method"),
    ] = "trigger",
    shown: Annotated[
        Literal["volts", "normalised", "difference"],
        Query(
            alias="as",
            description="normalised: each row over its greatest magnitude; difference: from the baseline",
        ),
    ] = "volts",
    form: Annotated[Literal["octets", "json"], Query(alias="format")] = "octets",
) -> Response:
    """Draw all accepted records of a position: in each cell the least and the greatest sample.

    Octets: u32 header length, JSON header padded with spaces to a multiple of 8, then float32 (little-endian)
    of all least values by row, then of all greatest; NaN where there is no sample. No sample is lost, however
    few rows and columns; edges of rows lie at multiples of `row_sets`, so the first and last may reach beyond
    the range. A record's time counts from its own anchor; where none was found, it is in no aligned picture.
    """
    method = context.settings.positions[context.known(position)].method
    _check(method, align, from_s, to_s, rows * columns if form == "json" else 0)
    catalogue = context.catalogue()
    index = _Index(catalogue, position)
    last_h = last_hour(from_h, to_h)
    tiles = context.waterfall.tiles(
        context.data_folder,
        experiment_identity(catalogue.experiment_row()),
        position,
        "trigger" if align == "trigger" else "first",
        index.first_files(),
    )
    if tiles is None:
        return Response(status_code=204)
    first = catalogue.rows(SetRow, position=position, first_h=from_h, limit=1)
    last = catalogue.last_rows(SetRow, position, 1, last_h=last_h)
    wanted = Wanted(
        first=first[0].set_index if first else 0,
        last=last[0].set_index if first and last else -1,
        rows=rows,
        columns=columns,
        from_s=from_s,
        to_s=to_s,
    )
    baseline, baseline_sets, baseline_pending = None, None, 0
    if shown == "difference":
        sets = _baseline(context, catalogue, position)
        baseline, baseline_sets, baseline_pending = context.waterfall.mean(tiles, index, sets)
    picture = context.waterfall.picture(tiles, index, wanted, baseline)
    planes = _planes(picture, normalised=shown == "normalised")
    is_echo = method == PULSE_ECHO
    header = {
        "position": position,
        "method": method,
        "align": align,
        "shown": shown,
        "unit": "1" if shown == "normalised" else "V",
        "rows": len(picture.rows),
        "columns": picture.frame.n_cells,
        "row_sets": picture.row_sets,
        "cell_s": picture.frame.cell_s,
        "first_s": picture.frame.first_s,
        "whole_s": [tiles.frame.first_s, tiles.frame.first_s + tiles.frame.n_cells * tiles.frame.cell_s],
        "sample_rate_hz": tiles.frame.sample_rate_hz,
        "delay_s": context.settings.ultrasound.delay_s if is_echo else None,
        "velocity_m_per_s": context.settings.ultrasound.velocity_m_per_s if is_echo else None,
        "baseline_sets": baseline_sets,
        **{
            name: [getattr(row, name) for row in picture.rows]
            for name in ("first_set", "last_set", "n_sets", "first_h", "last_h")
        },
        "until_h": _until_h(picture),
        "pending_sets": picture.pending + baseline_pending,
        "unreadable_sets": picture.unreadable,
    }
    told = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
    samples = planes.astype("<f4", copy=False).tobytes()
    etag = f'"{hashlib.blake2b(told + samples, digest_size=16).hexdigest()}-{form}"'
    headers, known = unchanged(request, etag)
    if known is not None:
        return known
    if form == "json":
        extremes = {"minimum": _listed(planes[0]), "maximum": _listed(planes[1])}
        return JsonAnswer({**header, **extremes}, headers=headers)
    told += b" " * (-(4 + len(told)) % 8)
    return Response(struct.pack("<I", len(told)) + told + samples, media_type=OCTET_STREAM, headers=headers)


class _Index:
    """What a picture asks the catalogue (`picture.Index`)."""

    def __init__(self, catalogue: Catalogue, position: str) -> None:
        self._catalogue, self._position = catalogue, position

    def n_stored(self, first: int, last: int) -> int:
        return self._catalogue.n_stored(self._position, first, last)

    def file(self, set_index: int) -> SetReference | None:
        rows = self._catalogue.rows(SetRow, position=self._position, set_index=set_index)
        return next((SetReference(row.file) for row in rows if row.file is not None), None)

    def anchors(self, set_index: int) -> Mapping[int, float]:
        return anchors_of(results_in(self._catalogue, set_index))

    def first_files(self) -> list[SetReference]:
        """Files of the first sets."""
        rows = self._catalogue.rows(SetRow, position=self._position, tried=True, limit=_LOOKED_AT)
        return [SetReference(row.file) for row in rows if row.file is not None]


def _check(method: str, align: str, from_s: float | None, to_s: float | None, json_cells: int) -> None:
    """Refuse what no picture can be.

    Raises
    ------
    Problem
        422.
    """
    if align not in ("trigger", FIRST_OF[method]):
        raise invalid(
            "The records have no such mark",
            f"align is {align}, and the position's method is {method}.",
            f"Choose trigger or {FIRST_OF[method]}.",
        )
    if from_s is not None and to_s is not None and to_s <= from_s:
        raise invalid(
            "The range is upside down",
            f"from_s is {from_s:g} and to_s is {to_s:g}.",
            "Let to_s be greater than from_s.",
        )
    if json_cells > MOST_JSON_CELLS:
        raise invalid(
            "Too much for JSON",
            f"rows times columns is {json_cells}; JSON takes at most {MOST_JSON_CELLS}.",
            "Ask for fewer rows or columns, or leave format out.",
        )


def _baseline(context: Context, catalogue: Catalogue, position: str) -> list[int]:
    """Choose the sets of the present baseline; of a probe its first reading.

    Raises
    ------
    Problem
        404: there is none yet.
    """
    if context.settings.positions[position].method == PULSE_ECHO:
        reading = catalogue.first_reading(position)
        found = [] if reading is None else [reading.set_index]
    else:
        its = baseline_range(position, context.settings, catalogue.baseline(position))
        assessments = catalogue.rows(
            AssessmentRow, position=position, first_set=its.first_set, last_set=its.last_set
        )
        found = [row.set_index for row in assessments if row.in_baseline]
    if not found:
        raise not_found(
            f"Position {position} has no baseline yet.",
            "Ask for volts; /api/v1/trends tells when it is recorded.",
        )
    return found


def _planes(picture: Picture, *, normalised: bool) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Shape (2, rows, columns): the least and the greatest of each cell."""
    if not picture.rows:
        return np.zeros((2, 0, picture.frame.n_cells), dtype=np.float32)
    planes = np.stack([row.planes for row in picture.rows], axis=1)
    if normalised:
        over = np.array([peak if peak > 0.0 else math.nan for peak in picture.peaks], dtype=np.float32)
        planes = planes / over[None, :, None]
    return planes


def _until_h(picture: Picture) -> list[float]:
    """Give the hour at which each row ends: as if sets were due as often as around it."""
    rows, ends, step_h = picture.rows, [], math.nan
    for row, after in zip(rows, [*rows[1:], None][: len(rows)], strict=True):
        if after is not None:
            step_h = (after.first_h - row.last_h) / (after.first_set - row.last_set)
        elif row.last_set > row.first_set:
            step_h = (row.last_h - row.first_h) / (row.last_set - row.first_set)
        ends.append(row.last_h + (step_h if math.isfinite(step_h) else 1.0))
    return ends


def _listed(plane: np.ndarray[Any, np.dtype[np.float32]]) -> list[list[float | None]]:
    return [[None if math.isnan(value) else value for value in row] for row in plane.tolist()]
