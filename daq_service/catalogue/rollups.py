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
from dataclasses import dataclass, replace
from typing import TypeVar, get_args

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import BindParameter, ColumnElement, Connection, bindparam, delete, select

from analysis.statistics.bins import build_bin_dtype, join_bins, make_bins
from analysis.statistics.levels import FACTOR, get_level_widths
from analysis.statistics.trend import PART, build_fit_parts, join_fit_parts
from daq_service.catalogue.reader import is_scheduled
from daq_service.catalogue.rows import (
    MEASURED,
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
)
from daq_service.catalogue.stored_rows import (
    DamagedRow,
    Prepared,
    compile_sql,
    insert_rows,
    read_rows,
    read_values,
)
from daq_service.catalogue.tables import TABLES, alarms, sets, trend_blocks

log = logging.getLogger(__name__)

R = TypeVar("R", bound=Row)
Kind = type[FeatureRow] | type[ThicknessRow]
Pieces = tuple[NDArray[np.int64], NDArray[np.void]]
"""Index of the first set of each piece, in order, and its content."""

ASSESSED_VALUES = ("distance_squared", "limit_f_predictive", "limit_mean_3sd", "mewma_statistic")
QUALITIES: tuple[str, ...] = get_args(Quality)
"""From the best to the worst."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionRange:
    """A position, its kind of rows, and the index after its last set."""

    position: str
    kind: Kind
    end: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rollup:
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
    of_sets: Callable[[Connection, PositionRange, int, int], Pieces]
    joined: Callable[[NDArray[np.void], NDArray[np.intp]], NDArray[np.void]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Blocks:
    """Blocks of one width over a range of sets of a position."""

    rollup: Rollup
    place: PositionRange
    width: int
    first: int
    end: int

    def key(self, first: int) -> str:
        """Return the key of the block that starts with set ``first``; keys of a width sort by set."""
        # Numbers of equal length: so keys sort in the order of the sets.
        return f"{self.place.position}/{self.rollup.name}/{self.width:010d}/{first:010d}"


def list_bin_value_names(kind: Kind) -> tuple[str, ...]:
    """List the names of the values of a bin, in order: the measured ones, then the assessed ones."""
    return (*MEASURED[kind], *ASSESSED_VALUES)


def build_set_filter(kind: type[Row], position: object, first: object, last: object) -> ColumnElement[bool]:
    """Build the condition for a position's rows of scheduled sets from ``first`` to ``last``, both included.

    Of features, only rows of sets are selected, none of single shots.
    """
    table = TABLES[kind]
    in_range = table.c.set_index.between(first, last)
    of_sets = (table.c.position == position) & in_range & is_scheduled(table)
    return of_sets & table.c.shot_index.is_(None) if kind is FeatureRow else of_sets


_RANGE: tuple[BindParameter[object], ...] = bindparam("of_position"), bindparam("first"), bindparam("last")
_OF_RANGE: dict[type[Row], Prepared] = {
    kind: compile_sql(
        select(TABLES[kind]).where(build_set_filter(kind, *_RANGE)).order_by(TABLES[kind].c.set_index)
    )
    for kind in (SetRow, AssessmentRow, *MEASURED_BY.values())
}
_RAISED = compile_sql(
    select(alarms).where(
        alarms.c.position == _RANGE[0],
        alarms.c.raised_set_index.between(_RANGE[1], _RANGE[2]),
        alarms.c.raised_unscheduled_index == 0,
    )
)
_BLOCKS = (trend_blocks.c.place >= bindparam("first")) & (trend_blocks.c.place < bindparam("end"))
_STORED = compile_sql(select(trend_blocks).where(_BLOCKS).order_by(trend_blocks.c.place))
_DELETE = compile_sql(delete(trend_blocks).where(_BLOCKS))


def _read_rows(connection: Connection, kind: type[R], **of_range: object) -> Iterator[R]:
    """Yield the rows of a range of scheduled sets by set index; raise DamagedRow at a corrupt one.

    ``of_range`` gives ``of_position``, ``first`` and ``last`` (included). A row of a single shot is corrupt,
    too.
    """
    for row in read_rows(connection, kind, _OF_RANGE[kind], **of_range):
        if isinstance(row, FeatureRow) and row.shot_index is not None:
            raise DamagedRow(f"an index of table features is corrupt: it has shot {row.shot_index} as a set")
        yield row


def _compute_bins(connection: Connection, place: PositionRange, first: int, end: int) -> Pieces:
    """Compute a bin for each scheduled set from ``first`` to ``end`` (excluded) from its stored rows.

    Returns set indices and bins. Raises DamagedRow at a corrupt row.
    """
    of_range = {"of_position": place.position, "first": first, "last": end - 1}
    set_rows = list(_read_rows(connection, SetRow, **of_range))
    results = {row.set_index: row for row in _read_rows(connection, place.kind, **of_range)}
    assessments = {row.set_index: row for row in _read_rows(connection, AssessmentRow, **of_range)}
    raised = read_rows(connection, AlarmRow, _RAISED, **of_range)
    n_alarms = Counter(row.raised_set_index for row in raised)
    values = [
        [
            *(getattr(results.get(row.set_index), name, None) for name in MEASURED[place.kind]),
            *(getattr(assessments.get(row.set_index), name, None) for name in ASSESSED_VALUES),
        ]
        for row in set_rows
    ]
    index = np.array([row.set_index for row in set_rows], dtype=np.int64)
    set_assessments = [assessments.get(row.set_index) for row in set_rows]
    return index, make_bins(
        set_index=index,
        due_h=[row.due_h for row in set_rows],
        values=np.array(values, dtype=np.float64).reshape(index.size, len(list_bin_value_names(place.kind))),
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


def _compute_fit_sums(connection: Connection, place: PositionRange, first: int, end: int) -> Pieces:
    """Compute the sums for fits for each scheduled set from ``first`` to ``end`` (excluded) that has results.

    Returns set indices and sums, shape (n_sets, n_values). Raises DamagedRow at a corrupt row.
    """
    results = list(_read_rows(connection, place.kind, of_position=place.position, first=first, last=end - 1))
    names = MEASURED[place.kind]
    values = np.array([[getattr(row, name) for name in names] for row in results], dtype=np.float64)
    parts = build_fit_parts([row.due_h for row in results], values.reshape(len(results), len(names)))
    return np.array([row.set_index for row in results], dtype=np.int64), parts


CHARTS = Rollup(
    name="bins",
    finest=4,
    type_of=lambda kind: build_bin_dtype(len(list_bin_value_names(kind))),
    of_sets=_compute_bins,
    joined=join_bins,
)
FITS = Rollup(
    name="fits",
    finest=64,  # a part of fewer points is larger than they are
    type_of=lambda kind: np.dtype((PART, (len(MEASURED[kind]),))),
    of_sets=_compute_fit_sums,
    joined=lambda parts, starts: np.stack([join_fit_parts(one) for one in np.split(parts, starts[1:])]),
)
ROLLUPS = (CHARTS, FITS)


# Blocks ----------------------------------------------------------------------------------------------


def join_pieces(rollup: Rollup, pieces: Pieces, width: int) -> Pieces:
    """Combine pieces (set index and content) to blocks of ``width`` sets, counted from set 0.

    A block without a piece is omitted; the index of a block is that of its first set.
    """
    index, content = pieces
    if not index.size:
        return pieces
    blocks = index // width
    starts = np.flatnonzero(np.diff(blocks, prepend=-1))
    return blocks[starts] * width, rollup.joined(content, starts)


def read_stored_blocks(connection: Connection, blocks: Blocks) -> list[tuple[str, bytes]]:
    """Read keys and contents of the stored blocks of a range, in the order of the sets.

    Raises DamagedRow if one does not match its checksum.
    """
    of_range = {"first": blocks.key(blocks.first), "end": blocks.key(blocks.end)}
    return [(key, block) for key, block, _ in read_values(connection, TrendBlockRow, _STORED, **of_range)]


def read_stored_pieces(connection: Connection, blocks: Blocks) -> Pieces:
    """Read stored blocks as pieces; below the finest width of the rollup, compute a piece for each set.

    Raises DamagedRow at a corrupt block or row.
    """
    rollup, place = blocks.rollup, blocks.place
    if blocks.width < rollup.finest:
        return rollup.of_sets(connection, place, blocks.first, blocks.end)
    stored = read_stored_blocks(connection, blocks)
    index = np.array([int(key.rpartition("/")[2]) for key, _ in stored], dtype=np.int64)
    return index, np.frombuffer(b"".join(block for _, block in stored), rollup.type_of(place.kind))


def compute_blocks(connection: Connection, blocks: Blocks) -> list[TrendBlockRow]:
    """Compute the blocks of a range from stored smaller ones, or from rows; blocks without a set are omitted.

    Stores nothing. Raises DamagedRow at a corrupt block or row.
    """
    pieces = read_stored_pieces(connection, replace(blocks, width=blocks.width // FACTOR))
    index, content = join_pieces(blocks.rollup, pieces, blocks.width)
    return [
        TrendBlockRow(place=blocks.key(int(start)), block=block.tobytes())
        for start, block in zip(index, content, strict=True)
    ]


def store_blocks(connection: Connection, blocks: Blocks) -> None:
    """Compute the blocks of a range and replace the stored ones, in the caller's transaction.

    Raises DamagedRow at a corrupt block or row, before anything is replaced.
    """
    rows = compute_blocks(connection, blocks)
    _DELETE.execute(connection, first=blocks.key(blocks.first), end=blocks.key(blocks.end))
    insert_rows(connection, rows)


_NEWEST = compile_sql(
    select(sets.c.set_index, sets.c.method)
    .where(sets.c.position == bindparam("of_position"), is_scheduled(sets))
    .order_by(sets.c.set_index.desc())
    .limit(1)
)


def find_position_range(connection: Connection, position: str) -> PositionRange | None:
    """Find the kind of a position's results and the index after its last scheduled set; None without sets."""
    found = _NEWEST.execute(connection, of_position=position).fetchone()
    if found is None:
        return None
    set_index, method = found
    return PositionRange(position=position, kind=MEASURED_BY[method], end=set_index + 1)


# Kept up ---------------------------------------------------------------------------------------------


def find_last_sets(connection: Connection, positions: Iterable[str]) -> dict[str, int]:
    """Find the index of the newest scheduled set of each position; omit positions without one."""
    places = (find_position_range(connection, position) for position in positions)
    return {place.position: place.end - 1 for place in places if place is not None}


def collect_changed_sets(rows: Iterable[Row]) -> dict[str, set[int]]:
    """Collect the indices of the scheduled sets to which rows belong, by position; ignore other rows."""
    touched: dict[str, set[int]] = {}
    for row in rows:
        if isinstance(row, AlarmRow):
            index, unscheduled_index = row.raised_set_index, row.raised_unscheduled_index
        elif isinstance(row, RowOfSet):
            index, unscheduled_index = row.set_index, row.unscheduled_index
        else:
            continue
        if row.position is not None and index is not None and not unscheduled_index:
            touched.setdefault(row.position, set()).add(index)
    return touched


def update_trends(
    connection: Connection, touched: Mapping[str, Collection[int]], last_before: Mapping[str, int]
) -> None:
    """Recompute the complete blocks of changed sets, in the transaction that changes them.

    Parameters
    ----------
    touched
        Indices of the changed sets of each position.
    last_before
        `find_last_sets` before the change: the blocks after these sets may be complete now.

    A corrupt row does not prevent the storage of a set: its blocks stay, with a log message, and `verify`
    reports both.
    """
    for position, indices in touched.items():
        place = find_position_range(connection, position)
        if place is None:
            continue
        n_before = last_before.get(position, -1) + 1
        for rollup in ROLLUPS:
            for width in get_level_widths(rollup.finest, place.end):
                unfinished = {n_before // width} if n_before % width else set()
                blocks = sorted({index // width for index in indices} | unfinished)
                for first, end in _to_ranges([block for block in blocks if (block + 1) * width <= place.end]):
                    span = {"first": first * width, "end": end * width}
                    try:
                        store_blocks(connection, Blocks(rollup=rollup, place=place, width=width, **span))
                    except DamagedRow as error:
                        log.warning("trends of %s are not brought up to date: %s", position, error)


def _to_ranges(numbers: Iterable[int]) -> Iterator[tuple[int, int]]:
    """Group increasing numbers into consecutive ranges and yield each as (first, end), ``end`` excluded."""
    first = end = -1
    for number in numbers:
        if number != end and end >= 0:
            yield first, end
        first, end = number if number != end else first, number + 1
    if end >= 0:
        yield first, end
