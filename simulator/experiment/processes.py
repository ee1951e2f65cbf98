"""Random processes with autocorrelation, each set or hour computed independently from the seed.

A recursion would have to be run from the start. Here each value is a sum over a window of innovations that
are drawn by blocks, each block from a key of its own, so that shots may be computed in any order, in any
process and after any restart with the same digits. What is remembered saves time only.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hardware_drivers.measurement import SetKey, ShotKey
from simulator.numerics.arrays import FloatArray
from simulator.numerics.keyed_random import Purpose, keyed_generator

LAGS = 64
"""Innovations in a value of an AR(1) process, and their number in a block: what is left out of the sum is
below 0.8^64 = 6e-7 of the SD (`parameters.nuisance.LONGEST_MEMORY`)."""

WANDER_TERMS = 8
"""Sinusoids in a wander: enough that it does not look periodic over a test."""

RESEAT_BLOCK_H = 1_000.0
"""Re-seats are drawn for so many hours at a time."""


def _make_read_only(drawn: FloatArray) -> FloatArray:
    """Make an array read-only in place and return it."""
    drawn.flags.writeable = False
    return drawn


def draw_unit_t(random: np.random.Generator, dof: float, size: int | tuple[int, ...]) -> FloatArray:
    """Draw numbers of Student's t distribution, scaled to variance 1; ``dof`` must exceed 2."""
    return np.asarray(random.standard_t(dof, size) * np.sqrt((dof - 2.0) / dof))


def compute_ar1_weights(memory: FloatArray) -> FloatArray:
    """Compute the weights of the last `LAGS` innovations in AR(1) processes, shape (LAGS, n), oldest first.

    Parameters
    ----------
    memory
        phi of each process, shape (n,): ``x_k = sqrt(1 - phi^2) sum phi^j e_(k-j)``.
    """
    return np.asarray(np.sqrt(1.0 - memory**2) * memory ** np.arange(LAGS - 1, -1, -1.0)[:, None])


def draw_autocorrelated_values(
    weights: FloatArray, dof: float, *, seed: int, position: str, set_key: SetKey
) -> FloatArray:
    """Return the values of stationary AR(1) processes of variance 1 at a set, shape (n,).

    An unscheduled set shares the past of the next scheduled one and has an innovation of its own: scheduled
    sets are the same with and without it.

    Parameters
    ----------
    weights
        `compute_ar1_weights`.
    dof
        Of the innovations, Student's t of variance 1.
    """
    planned, unscheduled = set_key
    block, first = divmod(planned + bool(unscheduled), LAGS)
    recent = np.concatenate(
        [_draw_innovations(seed, position, number, weights.shape[1], dof) for number in (block, block + 1)]
    )[first + 1 : first + 1 + LAGS]
    if unscheduled:
        key = ShotKey.from_set(set_key, position, 0)
        recent[-1] = draw_unit_t(
            keyed_generator(seed, Purpose.SEATING_MEMORY, key=key), dof, (weights.shape[1],)
        )
    return np.asarray((weights * recent).sum(axis=0))


@lru_cache(maxsize=256)
def _draw_innovations(seed: int, position: str, block: int, size: int, dof: float) -> FloatArray:
    """Draw the innovations of a block of `LAGS` sets, shape (LAGS, size).

    Block 0 holds those before the test. Cached and read-only.
    """
    key = ShotKey(position=position, set_index=block, shot_index=0)
    return _make_read_only(
        draw_unit_t(keyed_generator(seed, Purpose.SEATING_MEMORY, key=key), dof, (LAGS, size))
    )


@lru_cache(maxsize=256)
def draw_slow_drift(
    purpose: Purpose, seed: int, position: str, size: int, shortest_h: float, longest_h: float
) -> tuple[FloatArray, FloatArray]:
    """Draw periods in h and phases in rad of `size` slow drifts, shape (size, WANDER_TERMS) each.

    One period is in each of equal steps of ln(period), so that slow and less slow parts are always present.
    The arrays are cached and read-only.
    """
    random = keyed_generator(seed, purpose, position=position)
    steps = (np.arange(WANDER_TERMS) + random.uniform(0.0, 1.0, (size, WANDER_TERMS))) / WANDER_TERMS
    phases = random.uniform(0.0, 2.0 * np.pi, (size, WANDER_TERMS))
    return _make_read_only(shortest_h * (longest_h / shortest_h) ** steps), _make_read_only(phases)


def evaluate_slow_drift(hour_h: float, drawn: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Evaluate the slow drifts of `draw_slow_drift`, of variance 1, at an hour, shape (size,).

    n equal sinusoids of amplitude a with random phases have the variance n a^2 / 2.
    """
    periods_h, phases_rad = drawn
    turns = np.sin(2.0 * np.pi * hour_h / periods_h + phases_rad)
    return np.asarray(np.sqrt(2.0 / WANDER_TERMS) * turns.sum(axis=-1))


def draw_values_after_reseats(
    hour_h: float, rate_per_h: float, *, seed: int, position: str, size: int
) -> tuple[int, FloatArray]:
    """Count the re-seats up to an hour; return also the values after the last one, shape (size,).

    The re-seats are a Poisson process. The values of ``size`` sources are normal with SD 1, independent of
    the ones before, so that a step is as often up as down; before the first re-seat they are 0.
    """
    last = int(hour_h // RESEAT_BLOCK_H)
    blocks = [_draw_reseats(seed, position, block, rate_per_h, size) for block in range(last + 1)]
    counts = [int(np.searchsorted(hours_h, hour_h, side="right")) for hours_h, _ in blocks]
    for count, (_, places) in zip(reversed(counts), reversed(blocks), strict=True):
        if count:
            return sum(counts), places[count - 1]
    return 0, np.zeros(size)


@lru_cache(maxsize=256)
def _draw_reseats(
    seed: int, position: str, block: int, rate_per_h: float, size: int
) -> tuple[FloatArray, FloatArray]:
    """Draw the re-seats of a block of 1,000 h: hours, rising, and values after each, shape (count, size).

    Both are cached and read-only.
    """
    key = ShotKey(position=position, set_index=block, shot_index=0)
    random = keyed_generator(seed, Purpose.RESEATS, key=key)
    count = int(random.poisson(rate_per_h * RESEAT_BLOCK_H))
    hours_h = RESEAT_BLOCK_H * (block + np.sort(random.uniform(0.0, 1.0, count)))
    return _make_read_only(hours_h), _make_read_only(random.standard_normal((count, size)))


@lru_cache(maxsize=256)
def is_noisy_hour(seed: int, hour: int, probability: float) -> bool:
    """Draw from the seed whether an hour of the test is noisy, the same for all positions."""
    key = ShotKey(position="", set_index=hour, shot_index=0)
    return bool(keyed_generator(seed, Purpose.NOISY_HOURS, key=key).random() < probability)
