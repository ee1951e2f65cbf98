"""Damage to bytes: flips, cuts, pages of zeros and of noise, each by its number alone."""

from __future__ import annotations

import random
from pathlib import Path

PAGE = 4096


def damaged(content: bytes, number: int, *, used: int | None = None) -> bytes:
    """Return the content with one corruption; seven of ten are single flips.

    Parameters
    ----------
    used
        Bytes from the beginning that may be damaged; None: all.
    """
    chance, end = random.Random(number), used or len(content)
    kind, place = chance.randrange(10), chance.randrange(end)
    if kind == 0:
        return content[:place]
    broken = bytearray(content)
    if kind in (1, 2):
        page = slice(place - place % PAGE, min(end, place - place % PAGE + PAGE))
        size = page.stop - page.start
        broken[page] = bytes(size) if kind == 1 else chance.randbytes(size)
    else:
        broken[place] ^= 1 << chance.randrange(8)
    return bytes(broken)


def flip(path: Path, place: int, bits: int = 1) -> None:
    """Flip bits of one byte of a file."""
    content = bytearray(path.read_bytes())
    content[place] ^= bits
    path.write_bytes(content)
