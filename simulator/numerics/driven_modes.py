"""Modes of a small dense system as seen by the force that drives it.

A force sees of each mode its frequency and how far it yields, not its shape. Stiffness and mass are
brought to the standard form ``U^-T M U^-1`` (``K = U^T U``) and to a tridiagonal matrix T (Householder,
LAPACK's dpotrf, dsygst and dsytrd). With the force along the last unknown both leave its direction alone:
the last components of T's eigenvectors are all that is needed, and the QL algorithm that finds the
eigenvalues turns them along. That costs a third of finding all shapes.

The eigenvalues are ``1 / omega^2``, so that slow modes, which a shot needs most, are the most exact. The
last rows of T are what as many Lanczos steps from the load would give: a part of T holds the slow modes
and all of the static deflection, and the rest of T belongs to fast modes that cost more than they tell.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import lapack

from simulator.numerics.arrays import FloatArray
from simulator.numerics.machine_code import jit_compile

ROUNDING = 1e-14
"""Eigenvalues below this part of the largest are rounding; such modes are static."""

SWEEPS = 60
"""More than enough for an eigenvalue; two are usual."""


def find_driven_modes(
    stiffness: FloatArray, mass: FloatArray, load: float, steps: int
) -> tuple[FloatArray, FloatArray, float]:
    """Compute the modes of a linear system that is driven at its last unknown.

    Parameters
    ----------
    stiffness, mass
        float64, shape (r, r), symmetric and positive definite; overwritten.
    load
        Force on the last unknown for a unit force on the system.
    steps
        Size of the part of the tridiagonal matrix that is used, and number of modes; at most r, which gives
        the exact ones.

    Returns
    -------
    omega_rad_per_s
        float64, shape (n_modes,): circular frequencies, rising.
    participation
        float64, shape (n_modes,): mass-normalised displacement along the load, positive.
    residual_compliance_m_per_n
        Static compliance of modes so fast that rounding hides them.

    Raises
    ------
    numpy.linalg.LinAlgError
        Stiffness or mass is not positive definite, or an eigenvalue was not found.
    """
    # A symmetric matrix in C order is the same in LAPACK's order.
    upper, info = lapack.dpotrf(stiffness.T, lower=0, clean=0, overwrite_a=1)
    if info != 0:
        raise np.linalg.LinAlgError("the stiffness is not positive definite")
    standard, _ = lapack.dsygst(mass.T, upper, itype=1, lower=0, overwrite_a=1)
    size = len(upper)
    # Less work space than LAPACK asks for means smaller blocks, which are faster at this size.
    _, diagonal, off_diagonal, _, _ = lapack.dsytrd(standard, lower=0, lwork=8 * size, overwrite_a=1)
    scale = float(np.max(np.abs(diagonal)))
    eigenvalues = diagonal[size - steps :] / scale
    off_diagonal = np.append(off_diagonal[size - steps :] / scale, 0.0)
    along = np.zeros(steps)
    along[-1] = 1.0
    if not (math.isfinite(scale) and _solve_tridiagonal_ql(eigenvalues, off_diagonal, along)):
        raise np.linalg.LinAlgError("an eigenvalue of the reduced plate was not found")
    seen = eigenvalues > ROUNDING
    if not seen.any() or eigenvalues.min() < -ROUNDING:
        raise np.linalg.LinAlgError("the mass is not positive definite")
    flexibility = (load / upper[-1, -1] * along) ** 2
    order = np.argsort(-eigenvalues[seen])
    omega = 1.0 / np.sqrt(scale * eigenvalues[seen][order])
    return omega, omega * np.sqrt(flexibility[seen][order]), float(flexibility[~seen].sum())


@jit_compile(nogil=True)
def _solve_tridiagonal_ql(d: FloatArray, e: FloatArray, z: FloatArray) -> bool:
    """Compute eigenvalues of a symmetric tridiagonal matrix in place, and one row of eigenvectors.

    Implicit QL with Wilkinson's shift (Bowdler, Martin, Reinsch and Wilkinson 1968,
    doi:10.1007/BF02166692). It is exact for small eigenvalues if they come first.

    Parameters
    ----------
    d, e, z
        float64, shape (n,): diagonal, off-diagonal (the last is zero) and a row vector; they become the
        eigenvalues, zeros, and the row times the eigenvectors.

    Returns
    -------
    False if an eigenvalue needs more than 60 sweeps, otherwise True.
    """
    n = d.shape[0]
    epsilon = np.finfo(np.float64).eps
    for low in range(n):
        for sweep in range(SWEEPS + 1):
            high = low
            while high < n - 1 and abs(e[high]) > epsilon * (abs(d[high]) + abs(d[high + 1])):
                high += 1
            if high == low:
                break
            if sweep == SWEEPS:
                return False
            g = (d[low + 1] - d[low]) / (2.0 * e[low])
            r = math.sqrt(g * g + 1.0)
            g = d[high] - d[low] + e[low] / (g + (r if g >= 0.0 else -r))
            s = c = 1.0
            p = 0.0
            split = False
            for i in range(high - 1, low - 1, -1):
                f = s * e[i]
                b = c * e[i]
                r = math.sqrt(f * f + g * g)
                e[i + 1] = r
                if r == 0.0:
                    d[i + 1] -= p
                    e[high] = 0.0
                    split = True
                    break
                s = f / r
                c = g / r
                g = d[i + 1] - p
                r = (d[i] - g) * s + 2.0 * c * b
                p = s * r
                d[i + 1] = g + p
                g = c * r - b
                f = z[i + 1]
                z[i + 1] = s * z[i] + c * f
                z[i] = c * z[i] - s * f
            if not split:
                d[low] -= p
                e[low] = g
                e[high] = 0.0
    return True
