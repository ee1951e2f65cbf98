"""What many sets of a position say together, so that no question about its history reads each of them.

There are two pyramids of blocks, of ever more sets: what charts show of them (`analysis.statistics.bins`)
and what fits need (`analysis.statistics.trend`). A block is kept once its last set is there. The lowest are
computed from the rows, each other one from those below it, none from what it was before: so the blocks are
a function of the rows, to the last bit, whatever was judged again. A range that begins or ends within a
block is covered by smaller ones, at last by the rows themselves.
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
from daq_service.catalogue.reader import Catalogue, Filters, Scope, chosen, in_plan, made, set_at
from daq_service.catalogue.row_checksum import DamagedRow, checked_values, storable
from daq_service.catalogue.rows import (
    MEASURED_BY,
    AlarmRow,
    AssessmentRow,
    FeatureRow,
    Quality,
    Row,
    SetRow,
    ThicknessRow,
    TrendBlockRow,
    measured,
)
from daq_service.catalogue.tables import alarms, sets, table_of, trend_blocks
from hardware_drivers.measurement import PLANNED_SETS

log = logging.getLogger(__name__)

R = TypeVar("R", bound=Row)
Kind = type[FeatureRow] | type[ThicknessRow]
Pieces = tuple[NDArray[np.int64], NDArray[np.void]]
"""First sets of some pieces, in order, and what each says."""

FACTOR = 4
ASSESSED_VALUES = ("distance_squared", "limit_f", "limit_paper", "chart")
QUALITIES: tuple[str, ...] = get_args(Quality)
"""From the best to the worst."""
_BLOCKS_AT_ONCE = 256


@dataclass(frozen=True, slots=True, kw_only=True)
class _Place:
    """Whose history it is: a position, its kind of rows, and the set behind its last one."""

    position: str
    kind: Kind
    end: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Pyramid:
    """Blocks of ``finest`` sets, of four times as many, and so on.

    Attributes
    ----------
    type_of
        What a block consists of.
    of_sets
        Each set of a range as a piece of its own.
    joined
        Pieces from each start to the next one as one.
    """

    name: str
    finest: int
    type_of: Callable[[Kind], np.dtype[np.void]]
    of_sets: Callable[[Connection, _Place, int, int], Pieces]
    joined: Callable[[NDArray[np.void], NDArray[np.intp]], NDArray[np.void]]

    def widths(self, end: int) -> Iterator[int]:
        width = self.finest
        while width <= end:
            yield width
            width *= FACTOR


def values_of(kind: Kind) -> tuple[str, ...]:
    """Names of the values of a bin, in order."""
    return (*measured(kind), *ASSESSED_VALUES)


def _of_sets(kind: type[Row], position: str, first: int, end: int) -> Filters:
    scope: Scope | None = "set" if kind is FeatureRow else None
    return {"position": position, "first_set": first, "last_set": end - 1, "scope": scope}


def _rows(connection: Connection, kind: type[R], position: str, first: int, end: int) -> list[R]:
    """Rows of a range of sets."""
    table = table_of(kind)
    return made(connection, kind, chosen(select(table), table, _of_sets(kind, position, first, end)))


def _bins(connection: Connection, place: _Place, first: int, end: int) -> Pieces:
    planned = _rows(connection, SetRow, place.position, first, end)
    results = {row.set_index: row for row in _rows(connection, place.kind, place.position, first, end)}
    assessments = {row.set_index: row for row in _rows(connection, AssessmentRow, place.position, first, end)}
    within = (alarms.c.raised_set_index >= first) & (alarms.c.raised_set_index < end)
    raised = select(alarms).where(alarms.c.position == place.position, within)
    n_alarms = Counter(row.raised_set_index for row in made(connection, AlarmRow, raised))
    own = measured(place.kind)
    values = [
        [
            *(getattr(results.get(row.set_index), name, None) for name in own),
            *(getattr(assessments.get(row.set_index), name, None) for name in ASSESSED_VALUES),
        ]
        for row in planned
    ]
    index = np.array([row.set_index for row in planned], dtype=np.int64)
    judged = [assessments.get(row.set_index) for row in planned]
    return index, bins_of_sets(
        set_index=index,
        due_h=[row.due_h for row in planned],
        values=np.array(values, dtype=np.float64).reshape(index.size, len(values_of(place.kind))),
        quality=[
            QUALITIES.index(results[row.set_index].quality) if row.set_index in results else None
            for row in planned
        ],
        missed=[row.state == "missed" for row in planned],
        outlier=[getattr(row, "outlier", None) for row in judged],
        outlier_paper=[getattr(row, "outlier_paper", None) for row in judged],
        in_baseline=[getattr(row, "in_baseline", False) for row in judged],
        n_alarms=[n_alarms[row.set_index] for row in planned],
    )


def _parts(connection: Connection, place: _Place, first: int, end: int) -> Pieces:
    results = _rows(connection, place.kind, place.position, first, end)
    own = measured(place.kind)
    values = np.array([[getattr(row, name) for name in own] for row in results], dtype=np.float64)
    parts = parts_of_points([row.due_h for row in results], values.reshape(len(results), len(own)))
    return np.array([row.set_index for row in results], dtype=np.int64), parts


def _joined_parts(parts: NDArray[np.void], starts: NDArray[np.intp]) -> NDArray[np.void]:
    return np.stack([joined_part(some) for some in np.split(parts, starts[1:])])


_CHARTS = _Pyramid(
    name="bins",
    finest=4,
    type_of=lambda kind: bin_type(len(values_of(kind))),
    of_sets=_bins,
    joined=joined_bins,
)
_FITS = _Pyramid(
    name="fits",
    finest=64,  # a part of fewer points is larger than they are
    type_of=lambda kind: np.dtype((PART, (len(measured(kind)),))),
    of_sets=_parts,
    joined=_joined_parts,
)
_PYRAMIDS = (_CHARTS, _FITS)
_NO_POINTS: np.void = np.zeros(1, PART)[0]


# Blocks ----------------------------------------------------------------------------------------------


def _key(pyramid: _Pyramid, place: _Place, width: int, first: int) -> str:
    # Numbers of one length: so places stand in the order of the sets.
    return f"{place.position}/{pyramid.name}/{width:010d}/{first:010d}"


def _joined(pyramid: _Pyramid, pieces: Pieces, width: int) -> Pieces:
    """Join the pieces of the same ``width`` sets, counted from set 0."""
    index, content = pieces
    if not index.size:
        return pieces
    blocks = index // width
    starts = np.flatnonzero(np.diff(blocks, prepend=-1))
    return blocks[starts] * width, pyramid.joined(content, starts)


def _within(pyramid: _Pyramid, place: _Place, width: int, first: int, end: int) -> Any:
    return (trend_blocks.c.place >= _key(pyramid, place, width, first)) & (
        trend_blocks.c.place < _key(pyramid, place, width, end)
    )


def _stored_blocks(
    connection: Connection, pyramid: _Pyramid, place: _Place, width: int, first: int, end: int
) -> list[tuple[str, bytes]]:
    """Places and contents."""
    within = _within(pyramid, place, width, first, end)
    asked = select(trend_blocks).where(within).order_by(trend_blocks.c.place)
    return [(its_place, block) for its_place, block, _ in checked_values(connection, TrendBlockRow, asked)]


def _stored(
    connection: Connection, pyramid: _Pyramid, place: _Place, width: int, first: int, end: int
) -> Pieces:
    blocks = _stored_blocks(connection, pyramid, place, width, first, end)
    index = np.array([int(its_place.rpartition("/")[2]) for its_place, _ in blocks], dtype=np.int64)
    return index, np.frombuffer(b"".join(block for _, block in blocks), pyramid.type_of(place.kind))


def _computed(
    connection: Connection, pyramid: _Pyramid, place: _Place, width: int, first: int, end: int
) -> list[TrendBlockRow]:
    """Blocks of a width that begin in a range, from what is below them; a block without any set is none."""
    if width == pyramid.finest:
        below = pyramid.of_sets(connection, place, first, end)
    else:
        below = _stored(connection, pyramid, place, width // FACTOR, first, end)
    index, content = _joined(pyramid, below, width)
    return [
        TrendBlockRow(place=_key(pyramid, place, width, int(start)), block=block.tobytes())
        for start, block in zip(index, content, strict=True)
    ]


def _store(
    connection: Connection, pyramid: _Pyramid, place: _Place, width: int, first: int, end: int
) -> None:
    rows = _computed(connection, pyramid, place, width, first, end)
    connection.execute(delete(trend_blocks).where(_within(pyramid, place, width, first, end)))
    if rows:
        connection.execute(insert(trend_blocks), [storable(row) for row in rows])


# Built once: building it costs more than asking.
_NEWEST = (
    select(sets.c.set_index, sets.c.method)
    .where(sets.c.position == bindparam("position"), in_plan(sets))
    .order_by(sets.c.set_index.desc())
    .limit(1)
)


def _place_of(connection: Connection, position: str) -> _Place | None:
    found = connection.execute(_NEWEST, {"position": position}).first()
    if found is None:
        return None
    return _Place(position=position, kind=MEASURED_BY[found.method], end=found.set_index + 1)


# Kept up ---------------------------------------------------------------------------------------------


def last_sets(connection: Connection, positions: Iterable[str]) -> dict[str, int]:
    """Newest set of each position; of one without any, none."""
    places = (_place_of(connection, position) for position in positions)
    return {place.position: place.end - 1 for place in places if place is not None}


def touched_sets(rows: Iterable[Row]) -> dict[str, set[int]]:
    """Find of which planned sets of each position some rows say anything."""
    touched: dict[str, set[int]] = {}
    for row in rows:
        index = row.raised_set_index if isinstance(row, AlarmRow) else getattr(row, "set_index", None)
        position = getattr(row, "position", None)
        if position is not None and index is not None and index < PLANNED_SETS:
            touched.setdefault(position, set()).add(index)
    return touched


def update_trends(
    connection: Connection, touched: Mapping[str, Collection[int]], last_before: Mapping[str, int]
) -> None:
    """Compute the blocks again of which a set has changed, in the transaction that changes it.

    Parameters
    ----------
    last_before
        `last_sets` before: what lay in a block that has its last set now.

    A damaged row keeps no set from being stored: its blocks stay as they were, and `verify` names both.
    """
    for position, indices in touched.items():
        place = _place_of(connection, position)
        if place is None:
            continue
        n_before = last_before.get(position, -1) + 1
        for pyramid in _PYRAMIDS:
            for width in pyramid.widths(place.end):
                unfinished = {n_before // width} if n_before % width else set()
                blocks = sorted({index // width for index in indices} | unfinished)
                for first, end in _runs([block for block in blocks if (block + 1) * width <= place.end]):
                    try:
                        _store(connection, pyramid, place, width, first * width, end * width)
                    except DamagedRow as error:
                        log.warning("trends of %s are not brought up to date: %s", position, error)


def _runs(numbers: Iterable[int]) -> Iterator[tuple[int, int]]:
    """Numbers that follow one another as half-open ranges."""
    first = end = -1
    for number in numbers:
        if number != end and end >= 0:
            yield first, end
        first, end = number if number != end else first, number + 1
    if end >= 0:
        yield first, end


def _everything(connection: Connection) -> Iterator[tuple[_Pyramid, _Place, int, int, int]]:
    """All ranges of blocks, what is below before what is above."""
    for position in connection.execute(select(sets.c.position).distinct()).scalars().all():
        place = _place_of(connection, position)
        assert place is not None
        for pyramid in _PYRAMIDS:
            for width in pyramid.widths(place.end):
                whole, step = place.end // width * width, _BLOCKS_AT_ONCE * pyramid.finest
                for first in range(0, whole, max(step, width)):
                    yield pyramid, place, width, first, min(first + max(step, width), whole)


def rebuild_trends(connection: Connection) -> None:
    """Compute all blocks anew."""
    connection.execute(delete(trend_blocks))
    for blocks in _everything(connection):
        _store(connection, *blocks)


def trend_differences(connection: Connection) -> Iterator[str]:
    """Tell which blocks are not what the rows say."""
    n_expected = 0
    for blocks in _everything(connection):
        expected = {row.place: row.block for row in _computed(connection, *blocks)}
        found = dict(_stored_blocks(connection, *blocks))
        n_expected += len(expected)
        for place in sorted(expected.keys() | found.keys()):
            if found.get(place) != expected.get(place):
                yield f"trend block {place} is not what the rows of its sets say"
    n_found = connection.execute(select(func.count()).select_from(trend_blocks)).scalar_one()
    if n_found != n_expected:
        yield f"there are {n_found} trend blocks, of {n_expected} that the sets have"


# Asked -----------------------------------------------------------------------------------------------


def _covering(
    connection: Connection, pyramid: _Pyramid, place: _Place, first: int, end: int, width: int
) -> list[Pieces]:
    """Pieces that cover a range of sets exactly: blocks of ``width``, smaller ones and sets at its ends."""
    if first >= end:
        return []
    if width < pyramid.finest:
        return [pyramid.of_sets(connection, place, first, end)]
    whole_first, whole_end = -(-first // width) * width, end // width * width
    finer = width // FACTOR
    if whole_first >= whole_end:
        return _covering(connection, pyramid, place, first, end, finer)
    return [
        *_covering(connection, pyramid, place, first, whole_first, finer),
        _stored(connection, pyramid, place, width, whole_first, whole_end),
        *_covering(connection, pyramid, place, whole_end, end, finer),
    ]


def _asked(connection: Connection, position: str, hours: tuple[float | None, float | None]) -> Any:
    """Place and range of sets that are due between two hours, both included."""
    place = _place_of(connection, position)
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
    """Bins over the sets of a position that are due between two hours, both included (None: any).

    Parameters
    ----------
    points
        How many sets make bins unnecessary.
    most_bins
        How many bins at most.

    Returns
    -------
    tuple or None
        Sets of a bin, and the bins (`bin_type` of `values_of`); None: no more sets than points were measured.
    """
    with catalogue.reading() as connection:
        asked = _asked(connection, position, (first_h, last_h))
        if asked is None or _n_measured(connection, *asked, limit=points + 1) <= points:
            return None
        place, first, end = asked
        width = _CHARTS.finest
        while (end - 1) // width - first // width >= most_bins:
            width *= 2
        pieces = _covering(connection, _CHARTS, place, first, end, max(_CHARTS.widths(width)))
    _, bins = _joined(_CHARTS, _concatenated(pieces), width)
    return width, bins[bins["n_sets"] + bins["n_missed"] + bins["n_alarms"] > 0.0]


def trend_part(
    catalogue: Catalogue, position: str, value: str, *, first_h: float | None, last_h: float | None
) -> np.void:
    """Give the `PART` of a measured value over the sets due between two hours, both included: for a fit."""
    with catalogue.reading() as connection:
        asked = _asked(connection, position, (first_h, last_h))
        if asked is None:
            return _NO_POINTS
        place, first, end = asked
        pieces = _covering(connection, _FITS, place, first, end, max(_FITS.widths(end), default=0))
    _, parts = _concatenated(pieces)
    column = measured(place.kind).index(value)
    part: np.void = joined_part(parts[:, [column]])[0] if parts.size else _NO_POINTS
    return part


def _n_measured(connection: Connection, place: _Place, first: int, end: int, *, limit: int) -> int:
    table = table_of(place.kind)
    some = chosen(select(table.c.set_index), table, _of_sets(place.kind, place.position, first, end))
    return connection.execute(
        select(func.count()).select_from(some.order_by(None).limit(limit).subquery())
    ).scalar_one()


def _concatenated(pieces: Iterable[Pieces]) -> Pieces:
    index, content = zip(*pieces, strict=True)
    return np.concatenate(index), np.concatenate(content)
