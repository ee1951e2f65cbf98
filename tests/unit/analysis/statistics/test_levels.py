"""Blocks of every level cover a range of sets exactly, the widest in the middle."""

import pytest

from analysis.statistics.levels import (
    choose_sets_per_step,
    get_level_widths,
    list_finer_blocks,
    split_range_into_blocks,
)


def test_each_level_has_blocks_of_four_times_as_many_sets():
    assert get_level_widths(4, 255) == [4, 16, 64]
    assert get_level_widths(4, 256) == [4, 16, 64, 256]
    assert get_level_widths(64, 63) == []
    assert list(list_finer_blocks(3)) == [12, 13, 14, 15]


@pytest.mark.parametrize("finest", [1, 4])
def test_parts_cover_a_range_once_with_whole_blocks(finest):
    widths = get_level_widths(finest, 64)
    for first, end in ((first, end) for first in range(0, 90, 3) for end in range(0, 150, 7)):
        parts = list(split_range_into_blocks(first, end, widths))
        covered = [index for _, start, stop in parts for index in range(start, stop)]
        assert covered == list(range(first, end))
        assert all(start % width == stop % width == 0 for width, start, stop in parts)
        # No narrow part has room for a block of the next level.
        for width, start, stop in parts:
            wider = next((candidate for candidate in widths if candidate > width), None)
            assert wider is None or -(-start // wider) * wider + wider > stop


@pytest.mark.parametrize(
    ("first", "last", "most", "width"), [(0, 9, 10, 1), (0, 10, 10, 2), (7, 8, 1, 16), (7, 7, 1, 1)]
)
def test_a_step_has_as_few_sets_as_the_number_of_steps_allows(first, last, most, width):
    assert choose_sets_per_step(first, last, most) == width
    assert choose_sets_per_step(first, last, most, finest=4) == max(width, 4)
