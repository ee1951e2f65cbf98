"""Levels of detail over the sets of a test: blocks of some sets, of four times as many, and so on.

Blocks start at multiples of their width. Rollups of trends and tiles of the waterfall are stored so.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

FACTOR = 4
"""Number of blocks that the next coarser block combines."""


def get_level_widths(finest: int, widest: int) -> list[int]:
    """Return the block width of each level in sets, from ``finest``, times 4 each, to at most ``widest``.

    Return an empty list if ``finest`` exceeds ``widest``.
    """
    widths = []
    while finest <= widest:
        widths.append(finest)
        finest *= FACTOR
    return widths


def list_finer_blocks(number: int) -> range:
    """Return the numbers of the four blocks of the next finer level that block ``number`` combines."""
    return range(number * FACTOR, (number + 1) * FACTOR)


def choose_sets_per_step(first: int, last: int, most: int, finest: int = 1) -> int:
    """Return how many sets a step of a figure combines: ``finest`` times a power of two.

    Parameters
    ----------
    first, last
        Range of sets, inclusive; steps start at multiples of their width.
    most
        Maximum number of steps.
    """
    width = finest
    while last // width - first // width >= most:
        width *= 2
    return width


def split_range_into_blocks(first: int, end: int, widths: Sequence[int]) -> Iterator[tuple[int, int, int]]:
    """Yield width, first and end of blocks that cover a half-open range of sets exactly, in order.

    The widest blocks are in the middle, narrower ones at the ends; parts of width 1 are single sets.
    ``widths`` ascend, each a multiple of the one before; an empty range yields nothing.
    """
    if first >= end:
        return
    if not widths:
        yield 1, first, end
        return
    *finer, width = widths
    whole_first, whole_end = -(-first // width) * width, end // width * width
    if whole_first >= whole_end:
        yield from split_range_into_blocks(first, end, finer)
        return
    yield from split_range_into_blocks(first, whole_first, finer)
    yield width, whole_first, whole_end
    yield from split_range_into_blocks(whole_end, end, finer)
