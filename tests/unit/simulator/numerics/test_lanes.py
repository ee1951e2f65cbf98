"""Vectors in compiled code: every lane by itself, rounded as in IEEE 754."""

import math

import numba
import numpy as np
import pytest

from simulator.numerics.lanes import (
    absolute,
    all_positive,
    broadcast,
    fma,
    lane,
    load,
    positive,
    sqrt,
    store,
    unless_within,
    where_greater,
)

VALUES = np.array([0.1, -2.5, 0.0, math.inf, 1e-300, math.nan, 3.0, -0.0, 7.0, 8.0])
OTHERS = np.array([0.3, 4.0, 0.0, 1.0, 1e300, 1.0, 3.0, 2.0, -7.0, 0.5])


@numba.njit(error_model="numpy")
def arithmetic(a, b, width, out):
    for start in (0, 1):  # unaligned, too
        x, y = load(a, start, 8), load(b, start, 8)
        at = 48 * start
        store(out, at, x + y)
        store(out, at + 8, x - 2.0)
        store(out, at + 16, 3.0 * y)
        store(out, at + 24, x / y)
        store(out, at + 32, fma(x, y, 1.0))
        store(out, at + 40, sqrt(absolute(x)) + broadcast(0.25, 8))


def test_arithmetic_is_numpy_s_lane_by_lane():
    out = np.empty(96)
    arithmetic(VALUES, OTHERS, 8, out)
    with np.errstate(all="ignore"):
        for start in (0, 1):
            x, y = VALUES[start : start + 8], OTHERS[start : start + 8]
            expected = (x + y, x - 2.0, 3.0 * y, x / y, None, np.sqrt(np.abs(x)) + 0.25)
            for k, wanted in enumerate(expected):
                if wanted is not None:
                    np.testing.assert_array_equal(out[48 * start + 8 * k :][:8], wanted)


@numba.njit(error_model="numpy")
def multiplied_and_added(a, b, c, out):
    store(out, 0, fma(load(a, 0, 1), b, load(c, 0, 1)))
    return lane(load(a, 0, 1) * b + load(c, 0, 1), 0)


def test_fma_rounds_once_and_nothing_else_does():
    """(1 + e)(1 - e) - 1 is -e^2: lost when the product is rounded, kept when it is not."""
    e = 2.0**-30
    out = np.empty(1)
    twice = multiplied_and_added(np.array([1.0 + e]), 1.0 - e, np.array([-1.0]), out)
    assert out[0] == -(e**2)
    assert twice == 0.0


@numba.njit(error_model="numpy")
def selected(a, b, out):
    x, y = load(a, 0, 8), load(b, 0, 8)
    store(out, 0, positive(x))
    store(out, 8, where_greater(x, y, x, 0.0))
    store(out, 16, unless_within(x, y, 1.0, 0.0))
    return all_positive(y + 1.0), all_positive(y), lane(x, 6)


def test_selections_and_what_is_not_a_number():
    out = np.empty(24)
    every, not_every, seventh = selected(VALUES, OTHERS, out)
    x, y = VALUES[:8], OTHERS[:8]
    np.testing.assert_array_equal(out[:8], np.where(x > 0.0, x, 0.0))
    np.testing.assert_array_equal(out[8:16], np.where(x > y, x, 0.0))
    np.testing.assert_array_equal(out[16:], np.where(x <= y, 0.0, 1.0))
    assert out[5] == 0.0
    assert out[21] == 1.0
    assert (every, not_every, seventh) == (True, False, 3.0)


@numba.njit(error_model="numpy")
def harmonic(terms, width_is_one, out):
    if width_is_one:
        total = broadcast(0.0, 1)
        for k in range(terms):
            total = total + 1.0 / (broadcast(1.0, 1) + k)
        store(out, 0, total)
    else:
        total_8 = broadcast(0.0, 8)
        for k in range(terms):
            total_8 = total_8 + 1.0 / (broadcast(1.0, 8) + k)
        store(out, 0, total_8)


def test_a_sum_has_the_same_bits_in_any_width():
    one, eight = np.empty(1), np.empty(8)
    harmonic(10_000, True, one)
    harmonic(10_000, False, eight)
    np.testing.assert_array_equal(eight, one[0])


def test_vectors_of_different_width_do_not_mix():
    @numba.njit
    def mixed(a):
        return lane(fma(load(a, 0, 8), load(a, 0, 4), 1.0), 0)

    with pytest.raises(numba.TypingError):
        mixed(VALUES)
