"""Store summaries of many sets of a position, so that queries of its history need not read each set.

There are two hierarchies of blocks of increasing size: bins of charts (`analysis.statistics.bins`) and sums
of fits (`analysis.statistics.trend`). A block is stored once its last set is complete. The smallest blocks
are computed from the rows, each larger one from smaller ones: so the blocks are a function of the rows, to
the last bit, even after a reassessment. Smaller blocks, or the rows, cover the ends of a range.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, bindparam, delete, func, insert, select

from analysis.statistics.bins import bin_type, bins_of_sets, joined_bins
from analysis.statistics.trend import PART, joined_part, parts_of_points
from daq_service.catalogue.reader import Catalogue, Filters, Scope, filtered, in_plan, read_rows, set_at
from daq_service.catalogue.row_checksum import DamagedRow, checked_values, storable
from daq_service.catalogue.rows import (
    MEASURED_BY,
    AlarmRow,
    AssessmentRow,
    FeatureRow,
    Quality,
    Row,
    RowOfSet,
    SetRow,
    ThicknessRow,
    TrendBlockRow,
    measured,
)
from daq_service.catalogue.tables import alarms, sets, table_of, trend_blocks

log = logging.getLogger(__name__)

R = TypeVar("R", bound=Row)
Kind = type[FeatureRow] | type[ThicknessRow]
Pieces = tuple[NDArray[np.int64], NDArray[np.void]]
"""Index of the first set of each piece, in order, and its content."""

FACTOR = 4
ASSESSED_VALUES = ("distance_squared", "limit_f_predictive", "limit_mean_3sd", "mewma_statistic")
QUALITIES: tuple[str, ...] = get_args(Quality)
"""From the best to the worst."""
_BLOCKS_AT_ONCE = 256


@dataclass(frozen=True, slots=True, kw_only=True)
class _PositionRange:
    """A position, its kind of rows, and the index after its last set."""

    position: str
    kind: Kind
    end: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Rollup:
    """Hierarchy of blocks of ``finest`` sets, of four times as many, and so on.

    Attributes
    ----------
    type_of
         Type of a block's content.
    of_sets
         Returns each set of a range as a piece.
    joined
         Combines the pieces from each start to the next one.
    """

    name: str
    finest: int
    type_of: Callable[[Kind], np.dtype[np.void]]
    of_sets: Callable[[Connection, _PositionRange, int, int], Pieces]
    joined: Callable[[NDArray[np.void], NDArray[np.intp]], NDArray[np.void]]

    def widths(self, end: int) -> Iterator[int]:
        """Yield the sizes of blocks in sets."""
        width = self.finest
        while width <= end:
            yield width
            width *= FACTOR


def values_of(kind: Kind) -> tuple[str, ...]:
    """Return the names of the values of a bin, in order."""
    return (*measured(kind), *ASSESSED_VALUES)


def _of_sets(kind: type[Row], position: str, first: int, end: int) -> Filters:
    """Return the filters for a range of sets of a position."""
    scope: Scope | None = "set" if kind is FeatureRow else None
    return {"position": position, "first_set": first, "last_set": end - 1, "scope": scope}


def _rows(connection: Connection, kind: type[R], position: str, first: int, end: int) -> list[R]:
    """Read the rows of a range of sets."""
    table = table_of(kind)
    return read_rows(connection, kind, filtered(select(table), table, _of_sets(kind, position, first, end)))


def _bins(connection: Connection, place: _PositionRange, first: int, end: int) -> Pieces:
    """Compute the bin of each set of a range."""
    set_rows = _rows(connection, SetRow, place.position, first, end)
    results = {row.set_index: row for row in _rows(connection, place.kind, place.position, first, end)}
    assessments = {row.set_index: row for row in _rows(connection, AssessmentRow, place.position, first, end)}
    in_range = (alarms.c.raised_set_index >= first) & (alarms.c.raised_set_index < end)
    scheduled = alarms.c.raised_unscheduled_index == 0
    raised = select(alarms).where(alarms.c.position == place.position, in_range, scheduled)
    n_alarms = Counter(row.raised_set_index for row in read_rows(connection, AlarmRow, raised))
    names = measured(place.kind)
    values = [
        [
            *(getattr(results.get(row.set_index), name, None) for name in names),
            *(getattr(assessments.get(row.set_index), name, None) for name in ASSESSED_VALUES),
        ]
        for row in set_rows
    ]
    index = np.array([row.set_index for row in set_rows], dtype=np.int64)
    set_assessments = [assessments.get(row.set_index) for row in set_rows]
    return index, bins_of_sets(
        set_index=index,
        due_h=[row.due_h for row in set_rows],
        values=np.array(values, dtype=np.float64).reshape(index.size, len(values_of(place.kind))),
        quality=[
            QUALITIES.index(results[row.set_index].quality) if row.set_index in results else None
            for row in set_rows
        ],
        missed=[row.state == "missed" for row in set_rows],
        outlier=[getattr(row, "outlier", None) for row in set_assessments],
        outlier_mean_3sd=[getattr(row, "outlier_mean_3sd", None) for row in set_assessments],
        in_baseline=[getattr(row, "in_baseline", False) for row in set_assessments],
        n_alarms=[n_alarms[row.set_index] for row in set_rows],
    )


def _parts(connection: Connection, place: _PositionRange, first: int, end: int) -> Pieces:
    """Compute the sums for fits of each set of a range."""
    results = _rows(connection, place.kind, place.position, first, end)
    names = measured(place.kind)
    values = np.array([[getattr(row, name) for name in names] for row in results], dtype=np.float64)
    parts = parts_of_points([row.due_h for row in results], values.reshape(len(results), len(names)))
    return np.array([row.set_index for row in results], dtype=np.int64), parts


def _joined_parts(parts: NDArray[np.void], starts: NDArray[np.intp]) -> NDArray[np.void]:
    """Combine the sums from each start to the next one."""
    return np.stack([joined_part(block_parts) for block_parts in np.split(parts, starts[1:])])


_CHARTS = _Rollup(
    name="bins",
    finest=4,
    type_of=lambda kind: bin_type(len(values_of(kind))),
    of_sets=_bins,
    joined=joined_bins,
)
_FITS = _Rollup(
    name="fits",
    finest=64,  # a part of fewer points is larger than they are
    type_of=lambda kind: np.dtype((PART, (len(measured(kind)),))),
    of_sets=_parts,
    joined=_joined_parts,
)
_ROLLUPS = (_CHARTS, _FITS)
_NO_POINTS: np.void = np.zeros(1, PART)[0]


# Blocks ----------------------------------------------------------------------------------------------


def _key(rollup: _Rollup, place: _PositionRange, width: int, first: int) -> str:
    # Numbers of equal length: so keys sort in the order of the sets.
    """Return the key of a block."""
    return f"{place.position}/{rollup.name}/{width:010d}/{first:010d}"


def _joined(rollup: _Rollup, pieces: Pieces, width: int) -> Pieces:
    """Combine the pieces of the same ``width`` sets, counted from set 0."""
    index, content = pieces
    if not index.size:
        return pieces
    blocks = index // width
    starts = np.flatnonzero(np.diff(blocks, prepend=-1))
    return blocks[starts] * width, rollup.joined(content, starts)


def _in_range(rollup: _Rollup, place: _PositionRange, width: int, first: int, end: int) -> Any:
    """Return the condition for the blocks of a range of sets."""
    return (trend_blocks.c.place >= _key(rollup, place, width, first)) & (
        trend_blocks.c.place < _key(rollup, place, width, end)
    )


def _stored_blocks(
    connection: Connection, rollup: _Rollup, place: _PositionRange, width: int, first: int, end: int
) -> list[tuple[str, bytes]]:
    """Read keys and contents of stored blocks."""
    in_range = _in_range(rollup, place, width, first, end)
    statement = select(trend_blocks).where(in_range).order_by(trend_blocks.c.place)
    return [(key, block) for key, block, _ in checked_values(connection, TrendBlockRow, statement)]


def _stored(
    connection: Connection, rollup: _Rollup, place: _PositionRange, width: int, first: int, end: int
) -> Pieces:
    """Read the stored blocks of a range as pieces."""
    blocks = _stored_blocks(connection, rollup, place, width, first, end)
    index = np.array([int(key.rpartition("/")[2]) for key, _ in blocks], dtype=np.int64)
    return index, np.frombuffer(b"".join(block for _, block in blocks), rollup.type_of(place.kind))


def _computed(
    connection: Connection, rollup: _Rollup, place: _PositionRange, width: int, first: int, end: int
) -> list[TrendBlockRow]:
    """Compute the blocks of a width in a range from smaller ones; blocks without a set are omitted."""
    if width == rollup.finest:
        pieces = rollup.of_sets(connection, place, first, end)
    else:
        pieces = _stored(connection, rollup, place, width // FACTOR, first, end)
    index, content = _joined(rollup, pieces, width)
    return [
        TrendBlockRow(place=_key(rollup, place, width, int(start)), block=block.tobytes())
        for start, block in zip(index, content, strict=True)
    ]


def _store(
    connection: Connection, rollup: _Rollup, place: _PositionRange, width: int, first: int, end: int
) -> None:
    """Compute and store the blocks of a range."""
    rows = _computed(connection, rollup, place, width, first, end)
    connection.execute(delete(trend_blocks).where(_in_range(rollup, place, width, first, end)))
    if rows:
        connection.execute(insert(trend_blocks), [storable(row) for row in rows])


# Built once: building it costs more than executing it.
_NEWEST = (
    select(sets.c.set_index, sets.c.method)
    .where(sets.c.position == bindparam("position"), in_plan(sets))
    .order_by(sets.c.set_index.desc())
    .limit(1)
)


def _position_range_of(connection: Connection, position: str) -> _PositionRange | None:
    """Return the kind of rows and the end of a position; None without sets."""
    found = connection.execute(_NEWEST, {"position": position}).first()
    if found is None:
        return None
    return _PositionRange(position=position, kind=MEASURED_BY[found.method], end=found.set_index + 1)


# Kept up ---------------------------------------------------------------------------------------------


def last_sets(connection: Connection, positions: Iterable[str]) -> dict[str, int]:
    """Return the newest set of each position that has one."""
    places = (_position_range_of(connection, position) for position in positions)
    return {place.position: place.end - 1 for place in places if place is not None}


def touched_sets(rows: Iterable[Row]) -> dict[str, set[int]]:
    """Return the scheduled sets of each position that the rows belong to."""
    touched: dict[str, set[int]] = {}
    for row in rows:
        if isinstance(row, AlarmRow):
            key, position = row.raised_set_key, row.position
        elif isinstance(row, RowOfSet):
            key, position = row.set_key, row.position
        else:
            continue
        if position is not None and key is not None and not key.unscheduled_index:
            touched.setdefault(position, set()).add(key.set_index)
    return touched


def update_trends(
    connection: Connection, touched: Mapping[str, Collection[int]], last_before: Mapping[str, int]
) -> None:
    """Recompute the blocks of changed sets, in the transaction that changes them.

    Parameters
    ----------
    last_before
         `last_sets` before the change: their blocks may be complete now.

     A corrupt row does not prevent the storage of a set: its blocks stay, and `verify` reports both.
    """
    for position, indices in touched.items():
        place = _position_range_of(connection, position)
        if place is None:
            continue
        n_before = last_before.get(position, -1) + 1
        for rollup in _ROLLUPS:
            for width in rollup.widths(place.end):
                unfinished = {n_before // width} if n_before % width else set()
                blocks = sorted({index // width for index in indices} | unfinished)
                for first, end in _runs([block for block in blocks if (block + 1) * width <= place.end]):
                    try:
                        _store(connection, rollup, place, width, first * width, end * width)
                    except DamagedRow as error:
                        log.warning("trends of %s are not brought up to date: %s", position, error)


def _runs(numbers: Iterable[int]) -> Iterator[tuple[int, int]]:
    """Yield consecutive numbers as half-open ranges."""
    first = end = -1
    for number in numbers:
        if number != end and end >= 0:
            yield first, end
        first, end = number if number != end else first, number + 1
    if end >= 0:
        yield first, end


def _all_ranges(connection: Connection) -> Iterator[tuple[_Rollup, _PositionRange, int, int, int]]:
    """Yield all ranges of blocks, smaller blocks first."""
    for position in connection.execute(select(sets.c.position).distinct()).scalars().all():
        place = _position_range_of(connection, position)
        assert place is not None
        for rollup in _ROLLUPS:
            for width in rollup.widths(place.end):
                complete, step = place.end // width * width, _BLOCKS_AT_ONCE * rollup.finest
                for first in range(0, complete, max(step, width)):
                    yield rollup, place, width, first, min(first + max(step, width), complete)


def rebuild_trends(connection: Connection) -> None:
    """Recompute all blocks."""
    connection.execute(delete(trend_blocks))
    for blocks in _all_ranges(connection):
        _store(connection, *blocks)


def trend_differences(connection: Connection) -> Iterator[str]:
    """Yield a message for each block that differs from its rows."""
    n_expected = 0
    for blocks in _all_ranges(connection):
        expected = {row.place: row.block for row in _computed(connection, *blocks)}
        stored = dict(_stored_blocks(connection, *blocks))
        n_expected += len(expected)
        for key in sorted(expected.keys() | stored.keys()):
            if stored.get(key) != expected.get(key):
                yield f"trend block {key} is not what the rows of its sets say"
    n_found = connection.execute(select(func.count()).select_from(trend_blocks)).scalar_one()
    if n_found != n_expected:
        yield f"there are {n_found} trend blocks, of {n_expected} that the sets have"


# Asked -----------------------------------------------------------------------------------------------


def _covering(
    connection: Connection, rollup: _Rollup, place: _PositionRange, first: int, end: int, width: int
) -> list[Pieces]:
    """Return pieces that cover a range exactly: blocks of ``width``, smaller ones and sets at the ends."""
    if first >= end:
        return []
    if width < rollup.finest:
        return [rollup.of_sets(connection, place, first, end)]
    whole_first, whole_end = -(-first // width) * width, end // width * width
    finer = width // FACTOR
    if whole_first >= whole_end:
        return _covering(connection, rollup, place, first, end, finer)
    return [
        *_covering(connection, rollup, place, first, whole_first, finer),
        _stored(connection, rollup, place, width, whole_first, whole_end),
        *_covering(connection, rollup, place, whole_end, end, finer),
    ]


def _range_of_hours(connection: Connection, position: str, hours: tuple[float | None, float | None]) -> Any:
    """Return position and range of sets due between two hours, inclusive."""
    place = _position_range_of(connection, position)
    if place is None:
        return None
    first: int | None = 0
    last: int | None = place.end - 1
    if hours[0] is not None:
        first = connection.execute(select(set_at(sets, hours[0], "first"))).scalar()
    if hours[1] is not None:
        last = connection.execute(select(set_at(sets, hours[1], "last"))).scalar()
    if first is None or last is None or first > last:
        return None
    return place, first, min(last + 1, place.end)


def trend_bins(
    catalogue: Catalogue,
    position: str,
    *,
    first_h: float | None,
    last_h: float | None,
    points: int,
    most_bins: int,
) -> tuple[int, NDArray[np.void]] | None:
    """Return the bins over the sets of a position due between two hours, inclusive (None: any).

    Parameters
    ----------
    points
         Maximum number of sets for which no bins are needed.
    most_bins
         Maximum number of bins.

    Returns
    -------
    tuple or None
        Sets of a bin, and the bins (`bin_type` of `values_of`); None: at most ``points`` sets were measured.
    """
    with catalogue.reading() as connection:
        position_range = _range_of_hours(connection, position, (first_h, last_h))
        if position_range is None or _n_measured(connection, *position_range, limit=points + 1) <= points:
            return None
        place, first, end = position_range
        width = _CHARTS.finest
        while (end - 1) // width - first // width >= most_bins:
            width *= 2
        pieces = _covering(connection, _CHARTS, place, first, end, max(_CHARTS.widths(width)))
    _, bins = _joined(_CHARTS, _concatenated(pieces), width)
    return width, bins[bins["n_sets"] + bins["n_missed"] + bins["n_alarms"] > 0.0]


def trend_part(
    catalogue: Catalogue, position: str, value: str, *, first_h: float | None, last_h: float | None
) -> np.void:
    """Return the `PART` of a measured value over the sets due between two hours, inclusive, for a fit."""
    with catalogue.reading() as connection:
        position_range = _range_of_hours(connection, position, (first_h, last_h))
        if position_range is None:
            return _NO_POINTS
        place, first, end = position_range
        pieces = _covering(connection, _FITS, place, first, end, max(_FITS.widths(end), default=0))
    _, parts = _concatenated(pieces)
    column = measured(place.kind).index(value)
    part: np.void = joined_part(parts[:, [column]])[0] if parts.size else _NO_POINTS
    return part


def _n_measured(connection: Connection, place: _PositionRange, first: int, end: int, *, limit: int) -> int:
    """Count the measured sets of a range, up to a limit."""
    table = table_of(place.kind)
    statement = filtered(select(table.c.set_index), table, _of_sets(place.kind, place.position, first, end))
    return connection.execute(
        select(func.count()).select_from(statement.order_by(None).limit(limit).subquery())
    ).scalar_one()


def _concatenated(pieces: Iterable[Pieces]) -> Pieces:
    """Concatenate pieces."""
    index, content = zip(*pieces, strict=True)
    return np.concatenate(index), np.concatenate(content)
