"""Read, check and rebuild the stored summaries of many sets (`rollups`)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, delete, func, select

from analysis.statistics.levels import choose_sets_per_step, get_level_widths, split_range_into_blocks
from analysis.statistics.trend import PART, join_fit_parts
from daq_service.catalogue.reader import Catalogue, build_set_at_query
from daq_service.catalogue.rollups import (
    CHARTS,
    FITS,
    ROLLUPS,
    Blocks,
    Pieces,
    PositionRange,
    Rollup,
    build_set_filter,
    compute_blocks,
    find_position_range,
    join_pieces,
    read_stored_blocks,
    read_stored_pieces,
    store_blocks,
)
from daq_service.catalogue.rows import MEASURED
from daq_service.catalogue.tables import TABLES, sets, trend_blocks

_BLOCKS_AT_ONCE = 256
_NO_POINTS: np.void = np.zeros(1, PART)[0]


def _iterate_all_blocks(connection: Connection) -> Iterator[Blocks]:
    """Yield the complete blocks of all positions and rollups, in ranges of one width, smaller ones first."""
    for position in connection.execute(select(sets.c.position).distinct()).scalars().all():
        place = find_position_range(connection, position)
        assert place is not None
        for rollup in ROLLUPS:
            for width in get_level_widths(rollup.finest, place.end):
                complete, step = place.end // width * width, max(_BLOCKS_AT_ONCE * rollup.finest, width)
                for first in range(0, complete, step):
                    end = min(first + step, complete)
                    yield Blocks(rollup=rollup, place=place, width=width, first=first, end=end)


def rebuild_trends(connection: Connection) -> None:
    """Delete all blocks and recompute them in the caller's transaction; raise DamagedRow at a corrupt row."""
    connection.execute(delete(trend_blocks))
    for blocks in _iterate_all_blocks(connection):
        store_blocks(connection, blocks)


def find_trend_differences(connection: Connection) -> Iterator[str]:
    """Yield a message for each trend block that differs from its sets' rows, lacks, or is too many.

    A count of stored blocks that is wrong yields one more. Raises DamagedRow at a corrupt row.
    """
    n_expected = 0
    for blocks in _iterate_all_blocks(connection):
        expected = {row.place: row.block for row in compute_blocks(connection, blocks)}
        stored = dict(read_stored_blocks(connection, blocks))
        n_expected += len(expected)
        for key in sorted(expected.keys() | stored.keys()):
            if stored.get(key) != expected.get(key):
                yield f"trend block {key} does not match the rows of its sets"
    n_found = connection.execute(select(func.count()).select_from(trend_blocks)).scalar_one()
    if n_found != n_expected:
        yield f"there are {n_found} trend blocks, of {n_expected} that the sets have"


# Asked -----------------------------------------------------------------------------------------------


def _read_covering_pieces(
    connection: Connection, rollup: Rollup, place: PositionRange, first: int, end: int, widest: int
) -> Pieces:
    """Read pieces that cover sets ``first`` to ``end`` (excluded) exactly, in order: blocks and single sets.

    No block is larger than ``widest`` sets. Raises DamagedRow at a corrupt row.
    """
    parts = [
        read_stored_pieces(connection, Blocks(rollup=rollup, place=place, width=width, first=start, end=stop))
        for width, start, stop in split_range_into_blocks(first, end, get_level_widths(rollup.finest, widest))
    ]
    index, content = zip(*parts, strict=True)
    return np.concatenate(index), np.concatenate(content)


def _find_set_range(connection: Connection, position: str, hours: tuple[float | None, float | None]) -> Any:
    """Find the range of a position's scheduled sets due between two hours, both included (None: no limit).

    Returns position range, first set and the set after the last; None if there are no such sets.
    """
    place = find_position_range(connection, position)
    if place is None:
        return None
    first: int | None = 0
    last: int | None = place.end - 1
    if hours[0] is not None:
        first = connection.execute(select(build_set_at_query(sets, hours[0], "first"))).scalar()
    if hours[1] is not None:
        last = connection.execute(select(build_set_at_query(sets, hours[1], "last"))).scalar()
    if first is None or last is None or first > last:
        return None
    return place, first, min(last + 1, place.end)


def read_trend_bins(
    catalogue: Catalogue,
    position: str,
    *,
    first_h: float | None,
    last_h: float | None,
    points: int,
    most_bins: int,
) -> tuple[int, NDArray[np.void]] | None:
    """Read the bins over the sets of a position due between two hours, both included (None: no limit).

    Parameters
    ----------
    points
         Maximum number of measured sets for which no bins are needed.
    most_bins
         Maximum number of bins.

    Returns
    -------
    tuple or None
        Number of sets per bin, and the bins in order (`build_bin_dtype` of `list_bin_value_names`), without
        empty ones; None: at most ``points`` sets were measured.

    Raises
    ------
    CatalogueDamagedError
        A row or block is corrupt.
    """
    with catalogue.open_snapshot() as connection:
        position_range = _find_set_range(connection, position, (first_h, last_h))
        if position_range is None or _count_sets(connection, *position_range, limit=points + 1) <= points:
            return None
        place, first, end = position_range
        width = choose_sets_per_step(first, end - 1, most_bins, CHARTS.finest)
        pieces = _read_covering_pieces(connection, CHARTS, place, first, end, width)
    _, bins = join_pieces(CHARTS, pieces, width)
    return width, bins[bins["n_sets"] + bins["n_missed"] + bins["n_alarms"] > 0.0]


def compute_trend_part(
    catalogue: Catalogue, position: str, value: str, *, first_h: float | None, last_h: float | None
) -> np.void:
    """Compute the sums (`PART`) of a measured value over sets due between two hours, for a straight-line fit.

    Both hours are included, None is no limit. Without sets the sums are those of no points. Raises ValueError
    if the position's method does not measure ``value``, CatalogueDamagedError at a corrupt row.
    """
    with catalogue.open_snapshot() as connection:
        position_range = _find_set_range(connection, position, (first_h, last_h))
        if position_range is None:
            return _NO_POINTS
        place, first, end = position_range
        _, parts = _read_covering_pieces(connection, FITS, place, first, end, end)
    column = MEASURED[place.kind].index(value)
    part: np.void = join_fit_parts(parts[:, [column]])[0] if parts.size else _NO_POINTS
    return part


def _count_sets(connection: Connection, place: PositionRange, first: int, end: int, *, limit: int) -> int:
    """Count the measured scheduled sets from ``first`` to ``end`` (excluded); stop counting at ``limit``."""
    table = TABLES[place.kind]
    in_range = build_set_filter(place.kind, place.position, first, end - 1)
    statement = select(table.c.set_index).where(in_range)
    return connection.execute(
        select(func.count()).select_from(statement.limit(limit).subquery())
    ).scalar_one()
