"""Weights of the time loop for exact propagation of a plate's modes under interpolated impulses."""

from __future__ import annotations

from functools import cache

import numpy as np

from simulator.numerics.arrays import FloatArray
from simulator.shot.kernel import BANK_ROWS, BLOCK

FEW_POINTS, FEW_POINTS_PHASE_RAD = 10, 1.5
MANY_POINTS = 24
"""Gauss points that integrate `modal_weights` to rounding: few up to this omega h, many up to 10."""


def modal_weights(omega_rad_per_s: FloatArray, participation: FloatArray, step_s: float) -> FloatArray:
    """Compute weights of a plate's modes for a step, shape (n_blocks * BANK_ROWS * BLOCK,).

    I is the impulse of the spring in the plate's contact less that of its static force, S the impulse of the
    dashpot, both since the start (`kernel`). A step turns ``y = phi z / omega``, whose real parts add up to
    the deflection under the chain, by ``t = exp(-i omega h)`` and adds ``a I1 + b I2 + c I3 + d S1``, I and S
    one, two and three steps ago; what the step's own I and S add is left out of y and added, turned, in the
    next step. Instead of y its sum with ``b' I1 + c' I2``, ``c' = c / t`` and ``b' = (b + c') / t``, is kept,
    to which I adds ``(a + b') I1`` alone; and of the imaginary part, ``g = im sin(omega h) + re (1 -
    cos(omega h))``, so that turning is ``g += m re; re += g`` with ``m = -4 sin^2(omega h / 2)``.

    The rows of a block are: m; what I and S one step ago add to re and g; omega / phi; the real parts of what
    this step's own I and S add, and of b' and c': they lead back to y; and what g, re, I now, one and two
    steps ago and S now add to the mode's speed. Zeros fill up the last block, modes that never move.

    Parameters
    ----------
    omega_rad_per_s, participation
        Shape (n_modes,): circular frequency and mass-normalised deflection phi under the chain.
    step_s
        h; the weights are exact to rounding up to omega h = 10.
    """
    turned = omega_rad_per_s * step_s
    few = turned.max(initial=0.0) <= FEW_POINTS_PHASE_RAD
    to_end, shares = _gauss_rule_of_step(FEW_POINTS if few else MANY_POINTS)
    phase = np.multiply.outer(turned, to_end)
    own = (np.cos(phase) @ shares - 1j * (np.sin(phase) @ shares)) * (participation**2 * step_s)[:, None]
    turn = np.cos(turned) - 1j * np.sin(turned)
    earlier = own[:, 3] / turn
    last = (own[:, 2] + earlier) / turn
    m, sine = -4.0 * np.sin(0.5 * turned) ** 2, np.sin(turned)
    rows = [m]
    for column in (turn * own[:, 0] + own[:, 1] + last, turn * own[:, 4] + own[:, 5]):
        rows += [column.real, column.imag * sine - 0.5 * m * column.real]
    stretch = omega_rad_per_s / participation
    rows += [stretch, own[:, 0].real, own[:, 4].real, last.real, earlier.real]
    rows += [stretch / sine, 0.5 * m * stretch / sine, stretch * own[:, 0].imag + participation]
    rows += [-stretch * last.imag, -stretch * earlier.imag, stretch * own[:, 4].imag + participation]
    n_blocks = -(-len(omega_rad_per_s) // BLOCK)
    bank = np.zeros((BANK_ROWS, n_blocks * BLOCK))
    bank[:, : len(omega_rad_per_s)] = rows
    return np.ascontiguousarray(bank.reshape(BANK_ROWS, n_blocks, BLOCK).swapaxes(0, 1)).ravel()


@cache
def _gauss_rule_of_step(points: int) -> tuple[FloatArray, FloatArray]:
    """Return each Gauss point's distance from the step's end, (points,), and six weights of it, (points, 6).

    These are of the cubic through I at tau = 1, 0, -1 and -2 and of the line through S at 1 and 0, with tau
    in steps from the step's start; I and S are those of `modal_weights`. Cached: callers must not write to
    them.
    """
    roots, weights = np.polynomial.legendre.leggauss(points)
    tau = 0.5 * (roots + 1.0)
    lagrange = (
        tau * (tau + 1.0) * (tau + 2.0) / 6.0,
        -(tau - 1.0) * (tau + 1.0) * (tau + 2.0) / 2.0,
        (tau - 1.0) * tau * (tau + 2.0) / 2.0,
        -(tau - 1.0) * tau * (tau + 1.0) / 6.0,
        tau,
        1.0 - tau,
    )
    return 1.0 - tau, np.stack([0.5 * weights * values for values in lagrange], axis=1)
