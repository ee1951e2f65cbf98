"""Loops over the samples of a record, compiled: one pass each where arrays would take ten.

They release the GIL, so that a record computed ahead does not hold up the thread that stores the present
one. No sum is reordered and nothing is contracted: every sample has the digits that the same formula in
NumPy gives it. About the machine code on disk see `simulator.coupled_kernel`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    try:
        compiled: Callable[..., Any] = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no folder for the machine code can be written
        compiled = numba.njit(**options)(function)
    return compiled


@_compiled
def cubic_samples(
    volts: FloatArray, step_s: float, start_s: float, rate_hz: float, n_samples: int
) -> FloatArray:
    """Lagrange's cubic through the four nearest points, read off on the sample clock.

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
    sampled = np.zeros(n_samples)
    last = volts.shape[0] - 1
    steps_per_sample = 1.0 / (rate_hz * step_s)
    offset = start_s / step_s
    known = -1
    cubic = square = slope = here = 0.0
    for i in range(max(0, math.ceil(-start_s * rate_hz)), n_samples):
        place = min(max(i * steps_per_sample + offset, 0.0), float(last))
        k = int(place)
        if k != known:
            known = k
            before = volts[k - 1] if k > 0 else 0.0
            here = volts[k]
            after = volts[min(k + 1, last)]
            later = volts[min(k + 2, last)]
            cubic = (later - before) / 6.0 + 0.5 * (here - after)
            square = 0.5 * (before + after) - here
            slope = after - here - square - cubic
        place -= k
        sampled[i] = ((cubic * place + square) * place + slope) * place + here
    return sampled


@_compiled
def inverted_codes(
    volts: FloatArray, offset_v: float, slope_v: float, curved: FloatArray, passes: int, low: int, high: int
) -> FloatArray:
    """Whole codes of voltages: inverse of ``offset + slope (c + sum(curved[k] c**(k + 2)))``, clipped.

    Parameters
    ----------
    volts
        float64, shape (n,).
    passes
        How often the bend at the last answer is taken off the line's.
    low, high
        Outermost codes. Beyond them the polynomial says nothing: outside 1.1 times them the line's answer
        is held.

    Returns
    -------
    FloatArray
        float64, shape (n,): whole numbers in low .. high.
    """
    n = volts.shape[0]
    lowest, highest = 1.1 * low, 1.1 * high
    line = np.empty(n)
    for i in range(n):
        line[i] = min(max((volts[i] - offset_v) / slope_v, lowest), highest)
    code = line.copy()
    bend = np.empty(n)
    # One short loop after the other: each is a vector instruction or two.
    for _ in range(passes):
        bend[:] = curved[-1]
        for k in range(curved.shape[0] - 2, -1, -1):
            coefficient = curved[k]
            for i in range(n):
                bend[i] = bend[i] * code[i] + coefficient
        for i in range(n):
            code[i] = line[i] - bend[i] * code[i] * code[i]
    lowest, highest = float(low), float(high)
    for i in range(n):
        code[i] = min(max(np.rint(code[i]), lowest), highest)
    return code
