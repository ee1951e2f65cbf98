"""Weights with which the time loop propagates the modes of a plate exactly under interpolated impulses."""

from __future__ import annotations

from functools import cache

import numpy as np

from simulator.numerics.arrays import FloatArray
from simulator.shot.kernel import BANK_ROWS, BLOCK

FEW_POINTS, FEW_POINTS_PHASE_RAD = 10, 1.5
MANY_POINTS = 24
"""Gauss points that integrate `modal_weights` to rounding: few up to this omega h, many up to 10."""


def modal_weights(omega_rad_per_s: FloatArray, participation: FloatArray, step_s: float) -> FloatArray:
    """Bank of weights for the modes of a plate, float64, shape (n_blocks * BANK_ROWS * BLOCK,).

    With y = phi z / omega, whose real parts add up to the deflection under the chain, the rows of a block
    are: cos and sin of omega h; real and imaginary weights of I one, two and three steps ago and of S one
    step ago; omega / phi, phi, real and imaginary weights of this step's own I and S. The last block is
    filled up with zeros, modes that never move.

    Parameters
    ----------
    omega_rad_per_s, participation
        Shape (n_modes,): circular frequency and mass-normalised deflection phi under the chain.
    step_s
        h; the weights are exact to rounding up to omega h = 10.
    """
    turned = omega_rad_per_s * step_s
    few = turned.max(initial=0.0) <= FEW_POINTS_PHASE_RAD
    to_end, shares = _gauss_rule(FEW_POINTS if few else MANY_POINTS)
    phase = np.multiply.outer(turned, to_end)
    own = (np.cos(phase) @ shares - 1j * (np.sin(phase) @ shares)) * (participation**2 * step_s)[:, None]
    turn = np.cos(turned) - 1j * np.sin(turned)
    # What a step's own impulse adds is left out of y and made up for, turned, in the next step.
    rows = [turn.real, -turn.imag]
    for column in (turn * own[:, 0] + own[:, 1], own[:, 2], own[:, 3], turn * own[:, 4] + own[:, 5]):
        rows += [column.real, column.imag]
    rows += [omega_rad_per_s / participation, participation]
    for column in (own[:, 0], own[:, 4]):
        rows += [column.real, column.imag]
    n_blocks = -(-len(omega_rad_per_s) // BLOCK)
    bank = np.zeros((BANK_ROWS, n_blocks * BLOCK))
    bank[:, : len(omega_rad_per_s)] = rows
    return np.ascontiguousarray(bank.reshape(BANK_ROWS, n_blocks, BLOCK).swapaxes(0, 1)).ravel()


@cache
def _gauss_rule(points: int) -> tuple[FloatArray, FloatArray]:
    """How far the points are from the step's end, and the weight that each gives to the six values.

    These are of the cubic through I at tau = 1, 0, -1 and -2 and of the line through S at 1 and 0, with
    tau in steps from the step's start.
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
