"""Fast FFT lengths."""

from functools import cache


@cache
def next_fast_length(n: int, factors: tuple[int, ...] = (2, 3, 5)) -> int:
    """Return the smallest length of at least ``n`` >= 1 that is a product of ``factors``.

    As `scipy.fft.next_fast_len`, whose import a recorder's start need not wait for.
    """
    while not _is_product(n, factors):
        n += 1
    return n


def _is_product(n: int, factors: tuple[int, ...]) -> bool:
    """Check whether a number has no prime factors other than ``factors``."""
    for factor in factors:
        while n % factor == 0:
            n //= factor
    return n == 1
