"""Random numbers that depend on their purpose and never on the order of calls."""

from __future__ import annotations

import hashlib
from enum import IntEnum
from functools import lru_cache
from typing import Any

import numpy as np

from hardware_drivers.measurement import ShotKey
from simulator.numerics.seed_mixing import SeedWords


class Purpose(IntEnum):
    """Purpose of a stream of random numbers; the values are part of every seed's meaning."""

    THINNING = 1
    TEMPERATURE = 2
    SET_SCATTER = 3
    SHOT_SCATTER = 4
    SAMPLING_PHASE = 5
    NOISE = 6
    ECHO_NOISE = 7
    MISSED_STRIKE = 8
    DOUBLE_STRIKE = 9
    LOOSE_CONTACT = 10
    SPIKES = 11
    MAINS_HUM = 12
    FAR_WALL = 13
    BUBBLES = 14
    COUPLING = 15
    SEATING_MEMORY = 16
    SEATING_WANDER = 17
    SEATING_OF_SHOT = 18
    RESEATS = 19
    SEASON = 20
    PROCESS = 21
    NOISY_HOURS = 22
    REFILLS = 23
    PITS = 24


def keyed_generator(
    seed: int, purpose: Purpose, *, position: str = "", key: ShotKey | None = None
) -> np.random.Generator:
    """Create an independent random generator for one purpose, position and shot.

    Parameters
    ----------
    seed
        Seed of the twin, 0 .. 2**32 - 1.
    position
        Name of a position, where a number belongs to it and not to a shot; ignored with ``key``.
    key
        The shot a number belongs to.

    Returns
    -------
    numpy.random.Generator
        SFC64, the fastest of numpy's normal generators, seeded as through SeedSequence, whose mixing
        keeps the streams of neighbouring keys independent.
    """
    name = position if key is None else key.position
    words = [seed, int(purpose), *_hash_name(name)]
    if key is not None:
        words += [key.set_key.number, key.shot_index, key.attempt]
    # Every word is below 2**32: SeedSequence would split a larger one and keys could coincide.
    mixed: Any = SeedWords(np.array(words, dtype=np.uint32))  # NumPy's types know its own class alone
    return np.random.Generator(np.random.SFC64(mixed))


@lru_cache(maxsize=256)
def _hash_name(name: str) -> tuple[int, int]:
    """Hash a name to two 32-bit words of a seed (BLAKE2b), the same in every process."""
    digest = hashlib.blake2b(name.encode(), digest_size=8).digest()
    return int.from_bytes(digest[:4], "little"), int.from_bytes(digest[4:], "little")
