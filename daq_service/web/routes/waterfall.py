"""`/api/v1/waterfall/{position}`: all waveforms of a position as one image, hour by time."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from fastapi import APIRouter, Query, Request
from numpy.typing import NDArray
from starlette.responses import Response

from daq_service.archive import SetReference
from daq_service.archive.waterfall.cells import extract_anchors
from daq_service.archive.waterfall.image import Picture, Wanted
from daq_service.assessment.baseline_lifecycle import get_baseline_range
from daq_service.assessment.results_in_file import read_set_results
from daq_service.catalogue import Catalogue
from daq_service.catalogue.owner import build_experiment_identity
from daq_service.catalogue.rows import AssessmentRow, SetRow
from daq_service.web.answers.json_answer import JsonAnswer, build_framed_body
from daq_service.web.answers.models import UNCHANGED, Waterfall, describe_errors, describe_files
from daq_service.web.answers.problem import invalid, not_found
from daq_service.web.answers.unchanged import check_etag
from daq_service.web.context import Context, ContextOf
from daq_service.web.routes.listing import FromHour, ToHour, find_last_hour
from daq_service.web.routes.waveforms import OCTET_STREAM
from hardware_drivers.measurement import SetKey
from hardware_drivers.methods import PULSE_ECHO

router = APIRouter(tags=["waveforms"])

ROWS, MOST_ROWS = 256, 512
COLUMNS, MOST_COLUMNS = 512, 1024
MOST_JSON_CELLS = 65_536
LONGEST_S = 1e3
FIRST_OF = {"solitary_wave": "isw", "pulse_echo": "first_echo"}
_MOST_FIRST_SETS = 50
"""Number of first sets to search for a valid record, which gives the sampling of the position."""

Seconds = Annotated[
    float | None,
    Query(ge=-LONGEST_S, le=LONGEST_S, allow_inf_nan=False, description="Time after the anchor"),
]


@router.get(
    "/waterfall/{position}",
    response_model=Waterfall,
    responses=describe_files(OCTET_STREAM)
    | {204: {"description": "No record of the position is stored; /api/v1/sets has the reason"}}
    | UNCHANGED
    | describe_errors(404, 503),
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
    columns: Annotated[int, Query(ge=2, le=MOST_COLUMNS)] = COLUMNS,
    align: Literal["trigger", "isw", "first_echo"] = "trigger",
    shown: Annotated[Literal["volts", "normalised", "difference"], Query(alias="as")] = "volts",
    form: Annotated[Literal["octets", "json"], Query(alias="format")] = "octets",
) -> Response:
    """Return all accepted waveforms of a position as an image of the extremes of each cell.

    Octets: u32 header length, JSON header padded with spaces to a multiple of 8, then float32
    (little-endian). These are all minima by row, then all maxima; NaN where there is no sample. No sample is
    lost, even with few rows and columns. Edges of rows are at multiples of `row_sets`, so the first and last
    may exceed the range. The time of a record counts from its anchor; a record without one is in no aligned
    image. The difference to the baseline is answered with 404 before there is one.
    """
    method = context.settings.positions[context.validate_position(position)].method
    _check_parameters(method, align, from_s, to_s, rows * columns if form == "json" else 0)
    catalogue = context.catalogue()
    index = _CatalogueIndex(catalogue, position)
    last_h = find_last_hour(from_h, to_h)
    tiles = context.waterfall.tiles(
        context.data_folder,
        build_experiment_identity(catalogue.read_experiment()),
        position,
        "trigger" if align == "trigger" else "first",
        index.list_first_files(),
    )
    if tiles is None:
        return Response(status_code=204)
    first_rows = catalogue.rows(SetRow, position=position, first_h=from_h, limit=1)
    last_rows = catalogue.read_last_rows(SetRow, position, 1, last_h=last_h)
    wanted = Wanted(
        first=first_rows[0].set_index if first_rows else 0,
        last=last_rows[0].set_index if first_rows and last_rows else -1,
        rows=rows,
        columns=columns,
        from_s=from_s,
        to_s=to_s,
    )
    baseline, baseline_sets, baseline_pending = None, None, 0
    if shown == "difference":
        sets = _list_baseline_sets(context, catalogue, position)
        baseline, baseline_sets, baseline_pending = context.waterfall.mean(tiles, index, sets)
    picture = context.waterfall.compute_figure(tiles, index, wanted, baseline)
    planes = _stack_planes(picture, normalised=shown == "normalised")
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
        "until_h": _compute_row_ends_h(picture),
        "pending_sets": picture.pending + baseline_pending,
        "unreadable_sets": picture.unreadable,
    }
    content = build_framed_body(header, planes.astype("<f4", copy=False).tobytes())
    etag = f'"{hashlib.blake2b(content, digest_size=16).hexdigest()}-{form}"'
    headers, not_modified = check_etag(request, etag)
    if not_modified is not None:
        return not_modified
    if form == "json":
        extremes = {"minimum": _to_nested_lists(planes[0]), "maximum": _to_nested_lists(planes[1])}
        return JsonAnswer({**header, **extremes}, headers=headers)
    return Response(content, media_type=OCTET_STREAM, headers=headers)


class _CatalogueIndex:
    """Index of an image in the catalogue (`image.Index`)."""

    def __init__(self, catalogue: Catalogue, position: str) -> None:
        self._catalogue, self._position = catalogue, position

    def count_stored_sets(self, first: int, last: int) -> int:
        """Count the sets of the position with records between two indices, both included."""
        return self._catalogue.count_stored_sets(self._position, first, last)

    def file(self, set_index: int) -> SetReference | None:
        """Return the reference of the file of a scheduled set; None if it has none."""
        rows = self._catalogue.rows(SetRow, position=self._position, set_index=set_index)
        return next((SetReference(row.file) for row in rows if row.file is not None), None)

    def read_anchors(self, set_index: int) -> Mapping[int, float]:
        """Read the time of the first pulse or echo of each shot of a scheduled set, s, by record number.

        Empty without any.
        """
        return extract_anchors(read_set_results(self._catalogue, SetKey(set_index)))

    def list_first_files(self) -> list[SetReference]:
        """List the files of the first 50 attempted sets of the position, without those that have none."""
        rows = self._catalogue.rows(SetRow, position=self._position, tried=True, limit=_MOST_FIRST_SETS)
        return [SetReference(row.file) for row in rows if row.file is not None]


def _check_parameters(
    method: str, align: str, from_s: float | None, to_s: float | None, json_cells: int
) -> None:
    """Require that alignment, time range and number of JSON cells of an image are valid.

    Raises
    ------
    Problem
        422: another method's alignment, an empty time range, or more than 65,536 JSON cells.
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


def _list_baseline_sets(context: Context, catalogue: Catalogue, position: str) -> list[int]:
    """Return the indices of the sets of the present baseline; for pulse echo that of the first reading.

    Raises
    ------
    Problem
        404: there is no baseline yet.
    """
    if context.settings.positions[position].method == PULSE_ECHO:
        reading = catalogue.read_first_thickness(position)
        set_indices = [] if reading is None else [reading.set_index]
    else:
        plan = get_baseline_range(position, context.settings, catalogue.baseline(position))
        assessments = catalogue.rows(
            AssessmentRow, position=position, first_set=plan.first_set, last_set=plan.last_set
        )
        set_indices = [row.set_index for row in assessments if row.in_baseline]
    if not set_indices:
        raise not_found(
            f"Position {position} has no baseline yet.",
            "Ask for volts; /api/v1/trends shows when it is recorded.",
        )
    return set_indices


def _stack_planes(picture: Picture, *, normalised: bool) -> NDArray[np.float32]:
    """Stack the minima and maxima of all rows in V, or relative to the peaks; shape (2, rows, columns).

    A row whose peak is 0 becomes NaN in the relative form.
    """
    if not picture.rows:
        return np.zeros((2, 0, picture.frame.n_cells), dtype=np.float32)
    planes = np.stack([row.planes for row in picture.rows], axis=1)
    if normalised:
        peaks = np.array([peak if peak > 0.0 else math.nan for peak in picture.peaks], dtype=np.float32)
        planes = planes / peaks[None, :, None]
    return planes


def _compute_row_ends_h(picture: Picture) -> list[float]:
    """Return the end of each row in h: its last hour plus the interval of the sets around it.

    The interval is that to the next row, else that within the row, else the one before; 1 h if there is none.
    """
    rows, ends, step_h = picture.rows, [], math.nan
    for row, following in zip(rows, [*rows[1:], None][: len(rows)], strict=True):
        if following is not None:
            step_h = (following.first_h - row.last_h) / (following.first_set - row.last_set)
        elif row.last_set > row.first_set:
            step_h = (row.last_h - row.first_h) / (row.last_set - row.first_set)
        ends.append(row.last_h + (step_h if math.isfinite(step_h) else 1.0))
    return ends


def _to_nested_lists(plane: NDArray[np.float32]) -> list[list[float | None]]:
    """Convert an image plane of shape (rows, columns) to nested lists with None instead of NaN."""
    return [[None if math.isnan(value) else value for value in row] for row in plane.tolist()]
