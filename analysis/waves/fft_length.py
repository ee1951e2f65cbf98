"""Fast FFT lengths, and transforms of many rows at once."""

from collections.abc import Callable, Hashable, Sequence
from functools import cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.float64]
Kind = TypeVar("Kind", bound=Hashable)


def apply_by_kind(
    rows: Sequence[Rows], kinds: Sequence[Kind], transform: Callable[[Rows, Kind], Rows]
) -> list[Rows]:
    """Apply ``transform(rows, kind)`` to all rows of a kind at once: a call costs more than a row.

    Parameters
    ----------
    rows
        Each of shape (n,); zeros are added to the shorter ones of a kind.
    """
    found: dict[int, Rows] = {}
    for kind in dict.fromkeys(kinds):
        numbers = [k for k, its_kind in enumerate(kinds) if its_kind == kind]
        stacked = np.zeros((len(numbers), max(rows[k].size for k in numbers)))
        for row, k in zip(stacked, numbers, strict=True):
            row[: rows[k].size] = rows[k]
        found.update(zip(numbers, transform(stacked, kind), strict=True))
    return [found[k] for k in range(len(rows))]


@cache
def fast_length(n: int, factors: tuple[int, ...] = (2, 3, 5)) -> int:
    """Return the smallest length of at least ``n`` >= 1 that is a product of ``factors``.

    As `scipy.fft.next_fast_len`, whose import a recorder's start need not wait for.
    """
    while not _is_product(n, factors):
        n += 1
    return n


def _is_product(n: int, factors: tuple[int, ...]) -> bool:
    for factor in factors:
        while n % factor == 0:
            n //= factor
    return n == 1
