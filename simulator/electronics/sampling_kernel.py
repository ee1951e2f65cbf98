"""Compiled loops over the samples of a record: one pass each where arrays would take ten.

None takes longer than some 40 us, and none releases the GIL: a record computed ahead would hand it to and
fro with the thread that stores the present one, and each time costs both of them as much as such a loop.
No sum is reordered and nothing is contracted: every sample has the digits that the same formula in NumPy
gives it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.numerics.arrays import FloatArray
from simulator.numerics.lanes import load, positive, store
from simulator.numerics.machine_code import jit_compile

AT_ONCE = 8
"""Samples that are computed at a time: a register of 512 bits, or two of 256."""
BLOCK = 256
"""Samples whose intermediate results stay in the processor's first cache."""


@jit_compile(error_model="numpy")
def interpolate_cubic(
    volts: FloatArray, step_s: float, start_s: float, rate_hz: float, n_samples: int
) -> FloatArray:
    """Interpolate volts at the sample clock by Lagrange's cubic through the four nearest points.

    Parameters
    ----------
    volts
        float64, shape (n,): on a grid of ``step_s`` from time zero; zero before, held after.
    start_s
        Time of the first sample; samples before time zero are zero.

    Returns
    -------
    FloatArray
        float64, shape (n_samples,).
    """
    # Samples between two points of the grid are a vector; what it holds beyond the second one is overwritten.
    sampled = np.zeros(n_samples + AT_ONCE)
    numbers = np.arange(float(AT_ONCE))
    last = volts.shape[0] - 1
    steps_per_sample = 1.0 / (rate_hz * step_s)
    offset = start_s / step_s
    first = max(0, math.ceil(-start_s * rate_hz))
    for k in range(max(0, int(first * steps_per_sample + offset)), last):
        if first >= n_samples:
            break
        end = int((k + 1.0 - offset) / steps_per_sample)
        while end > first and (end - 1) * steps_per_sample + offset >= k + 1.0:
            end -= 1
        while end * steps_per_sample + offset < k + 1.0:
            end += 1
        before = volts[k - 1] if k > 0 else 0.0
        here = volts[k]
        after = volts[k + 1]
        later = volts[min(k + 2, last)]
        cubic = (later - before) / 6.0 + 0.5 * (here - after)
        square = 0.5 * (before + after) - here
        slope = after - here - square - cubic
        for i in range(first, min(end, n_samples), AT_ONCE):
            place = (load(numbers, 0, AT_ONCE) + float(i)) * steps_per_sample + offset
            place = positive(place) - float(k)
            store(sampled, i, ((cubic * place + square) * place + slope) * place + here)
        first = max(first, end)
    sampled[first:] = volts[last]
    return sampled[:n_samples]


@jit_compile(error_model="numpy")
def find_first_crossing_s(volts: FloatArray, step_s: float, level_v: float) -> Any:
    """Return the time in s after the first value at which volts first rise to the level.

    Return the time of the maximum if they never do, or if the first value is above the level already. The
    crossing is interpolated linearly.
    """
    highest = 0
    for k in range(volts.shape[0]):
        if volts[k] >= level_v:
            if k == 0:
                break
            return (k - (volts[k] - level_v) / (volts[k] - volts[k - 1])) * step_s
    for k in range(volts.shape[0]):
        if volts[k] > volts[highest]:
            highest = k
    return highest * step_s


@jit_compile(error_model="numpy")
def find_rising_edge(volts: FloatArray, level_v: float, first: int, n_samples: int) -> int:
    """Return the index of the first of ``n_samples`` from ``first`` on that rises to the level, else -1."""
    for k in range(first, min(first + n_samples, volts.shape[0])):
        if volts[k] >= level_v and not volts[k - 1] >= level_v:
            return k
    return -1


@jit_compile(error_model="numpy")
def add_noise(
    volts: FloatArray,
    white: NDArray[np.float32],
    white_rms: float,
    coarse: FloatArray,
    cubic: FloatArray,
    slow_rms: float,
) -> None:
    """Add white noise and slow noise, each of unit variance times its RMS in V, to volts in place.

    Parameters
    ----------
    volts, white
        Shape (n,).
    coarse
        Slow noise on a coarser grid.
    cubic
        Weights of four points of that grid in each sample of a step, shape (4, samples per step).
    """
    n, per_step = volts.shape[0], cubic.shape[1]
    w0, w1, w2, w3 = cubic[0], cubic[1], cubic[2], cubic[3]
    for step in range(-(-n // per_step)):
        c0, c1, c2, c3 = coarse[step], coarse[step + 1], coarse[step + 2], coarse[step + 3]
        # Slices: numbers counted from their beginning can be vectors.
        here, noise = volts[step * per_step :], white[step * per_step :]
        for k in range(min(per_step, here.shape[0])):
            slow = c0 * w0[k] + c1 * w1[k] + c2 * w2[k] + c3 * w3[k]
            here[k] += noise[k] * white_rms + slow_rms * slow


@jit_compile(error_model="numpy")
def invert_scaling(
    volts: FloatArray,
    offset_v: float,
    slope_v: float,
    curved: FloatArray,
    passes: int,
    low: int,
    high: int,
    codes: NDArray[Any],
) -> None:
    """Convert voltages to clipped ADC codes, written into ``codes``, by iteration.

    This inverts ``offset + slope (c + sum(curved[k] c**(k + 2)))``.

    Parameters
    ----------
    volts
        float64, shape (n,).
    passes
        How often the bend at the last answer is taken off the line's.
    low, high
        Outermost codes. The polynomial is not valid beyond them: the line's answer is held outside 1.1 times
        them.
    codes
        Of an integer type, shape (n,): filled with the answer.
    """
    lowest, highest = 1.1 * low, 1.1 * high
    buffers = np.empty((3, BLOCK))
    for first in range(0, volts.shape[0], BLOCK):
        here, answer = volts[first : first + BLOCK], codes[first : first + BLOCK]
        n = here.shape[0]
        line, code, bend = buffers[0, :n], buffers[1, :n], buffers[2, :n]
        # One short loop after the other: each is a vector instruction or two.
        for i in range(n):
            line[i] = min(max((here[i] - offset_v) / slope_v, lowest), highest)
            code[i] = line[i]
        for _ in range(passes):
            bend[:] = curved[-1]
            for k in range(curved.shape[0] - 2, -1, -1):
                coefficient = curved[k]
                for i in range(n):
                    bend[i] = bend[i] * code[i] + coefficient
            for i in range(n):
                code[i] = line[i] - bend[i] * code[i] * code[i]
        for i in range(n):
            answer[i] = min(max(np.rint(code[i]), float(low)), float(high))
