"""Read, check and rebuild the stored summaries of many sets (`rollups`)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, delete, func, select

from analysis.statistics.levels import level_widths, parts_of_range, sets_per_step
from analysis.statistics.trend import PART, joined_part
from daq_service.catalogue.reader import Catalogue, set_at
from daq_service.catalogue.rollups import (
    CHARTS,
    FITS,
    ROLLUPS,
    Blocks,
    Pieces,
    PositionRange,
    Rollup,
    computed_blocks,
    joined_pieces,
    of_sets,
    position_range_of,
    store_blocks,
    stored_blocks,
    stored_pieces,
)
from daq_service.catalogue.rows import MEASURED
from daq_service.catalogue.tables import TABLES, sets, trend_blocks

_BLOCKS_AT_ONCE = 256
_NO_POINTS: np.void = np.zeros(1, PART)[0]


def _all_blocks(connection: Connection) -> Iterator[Blocks]:
    """Yield the blocks of all ranges, smaller blocks first."""
    for position in connection.execute(select(sets.c.position).distinct()).scalars().all():
        place = position_range_of(connection, position)
        assert place is not None
        for rollup in ROLLUPS:
            for width in level_widths(rollup.finest, place.end):
                complete, step = place.end // width * width, max(_BLOCKS_AT_ONCE * rollup.finest, width)
                for first in range(0, complete, step):
                    end = min(first + step, complete)
                    yield Blocks(rollup=rollup, place=place, width=width, first=first, end=end)


def rebuild_trends(connection: Connection) -> None:
    """Recompute all blocks."""
    connection.execute(delete(trend_blocks))
    for blocks in _all_blocks(connection):
        store_blocks(connection, blocks)


def trend_differences(connection: Connection) -> Iterator[str]:
    """Yield a message for each block that differs from its rows."""
    n_expected = 0
    for blocks in _all_blocks(connection):
        expected = {row.place: row.block for row in computed_blocks(connection, blocks)}
        stored = dict(stored_blocks(connection, blocks))
        n_expected += len(expected)
        for key in sorted(expected.keys() | stored.keys()):
            if stored.get(key) != expected.get(key):
                yield f"trend block {key} is not what the rows of its sets say"
    n_found = connection.execute(select(func.count()).select_from(trend_blocks)).scalar_one()
    if n_found != n_expected:
        yield f"there are {n_found} trend blocks, of {n_expected} that the sets have"


# Asked -----------------------------------------------------------------------------------------------


def _covering(
    connection: Connection, rollup: Rollup, place: PositionRange, first: int, end: int, widest: int
) -> Pieces:
    """Return pieces that cover a range exactly: blocks up to a width, smaller ones and sets at the ends."""
    parts = [
        stored_pieces(connection, Blocks(rollup=rollup, place=place, width=width, first=start, end=stop))
        for width, start, stop in parts_of_range(first, end, level_widths(rollup.finest, widest))
    ]
    index, content = zip(*parts, strict=True)
    return np.concatenate(index), np.concatenate(content)


def _range_of_hours(connection: Connection, position: str, hours: tuple[float | None, float | None]) -> Any:
    """Return position and range of sets due between two hours, inclusive."""
    place = position_range_of(connection, position)
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
        width = sets_per_step(first, end - 1, most_bins, CHARTS.finest)
        pieces = _covering(connection, CHARTS, place, first, end, width)
    _, bins = joined_pieces(CHARTS, pieces, width)
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
        _, parts = _covering(connection, FITS, place, first, end, end)
    column = MEASURED[place.kind].index(value)
    part: np.void = joined_part(parts[:, [column]])[0] if parts.size else _NO_POINTS
    return part


def _n_measured(connection: Connection, place: PositionRange, first: int, end: int, *, limit: int) -> int:
    """Count the measured sets of a range, up to a limit."""
    table = TABLES[place.kind]
    in_range = of_sets(place.kind, place.position, first, end - 1)
    statement = select(table.c.set_index).where(in_range)
    return connection.execute(
        select(func.count()).select_from(statement.limit(limit).subquery())
    ).scalar_one()
