"""Plate projected onto a basis: its modes at any depth, for any original model."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from simulator.numerics.arrays import FloatArray
from simulator.numerics.driven_modes import find_driven_modes

MERGE_TOLERANCE = 5e-7
"""Directions weaker than this part of the strongest are left out of the merged basis."""

MODES_PER_DIRECTION = 0.75
"""The fastest modes of so many directions are no modes of the plate, and three quarters do as well."""

UNSEEN_FRACTION = 1e-9
"""Modes that give less than this part of the static deflection are left out."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlateModes:
    """Modes of the plate at one depth, for the chain.

    Attributes
    ----------
    omega_rad_per_s
        float64, shape (n_modes,), rising.
    participation
        float64, shape (n_modes,): phi, the mass-normalised deflection under the chain, kg^-1/2.
    residual_compliance_m_per_n
        Static compliance of all modes left out.
    """

    omega_rad_per_s: FloatArray
    participation: FloatArray
    residual_compliance_m_per_n: float = 0.0

    @property
    def static_compliance_m_per_n(self) -> float:
        """Return the deflection under the chain for a static unit force, in m/N, residual included."""
        modal = np.sum((self.participation / self.omega_rad_per_s) ** 2)
        return float(modal) + self.residual_compliance_m_per_n

    def with_scaled_modulus(self, factor: float) -> PlateModes:
        """Return the modes for `factor` times Young's modulus; frequencies scale with its square root."""
        return PlateModes(
            omega_rad_per_s=self.omega_rad_per_s * math.sqrt(factor),
            participation=self.participation,
            residual_compliance_m_per_n=self.residual_compliance_m_per_n / factor,
        )

    def cut_off_fast_modes(self, omega_rad_per_s: float, yielding_per_kg: float) -> PlateModes:
        """Return the modes up to a frequency; those above become residual compliance.

        Parameters
        ----------
        omega_rad_per_s
            No mode above this frequency is kept.
        yielding_per_kg
            Nor one with which the sum of squared participations, by which the plate yields to a sudden
            impulse, would exceed this.
        """
        flexibility = (self.participation / self.omega_rad_per_s) ** 2
        seen = flexibility > UNSEEN_FRACTION * flexibility.sum()
        is_strong = seen & (self.omega_rad_per_s <= omega_rad_per_s)
        is_strong &= np.cumsum(self.participation**2) <= yielding_per_kg
        return PlateModes(
            omega_rad_per_s=self.omega_rad_per_s[is_strong],
            participation=self.participation[is_strong],
            residual_compliance_m_per_n=self.residual_compliance_m_per_n
            + float(flexibility[~is_strong].sum()),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReducedPlate:
    """Projected plate, a cubic polynomial in the remaining thickness like `mindlin_plate.AffinePlate`.

    Attributes
    ----------
    stiffness, mass
        float64, shape (4, r, r): coefficients of 1, s, s^2 and s^3, symmetric. The last direction of the
        basis is that of the load, no other feels it.
    load
        float64, shape (1,): force in the last direction for a unit force of the chain.
    """

    stiffness: FloatArray
    mass: FloatArray
    load: FloatArray

    def modes(self, depth_fraction: float) -> PlateModes:
        """Compute the modes of the reduced plate with the patch thinned by `depth_fraction`.

        Raise LinAlgError if the projected matrices are not positive definite.
        """
        size = self.stiffness.shape[1]
        powers = (1.0 - depth_fraction) ** np.arange(4.0)
        k, m = ((powers @ terms.reshape(4, -1)).reshape(size, size) for terms in (self.stiffness, self.mass))
        omega, participation, residual = find_driven_modes(
            k, m, float(self.load[0]), math.ceil(MODES_PER_DIRECTION * size)
        )
        return PlateModes(
            omega_rad_per_s=omega, participation=participation, residual_compliance_m_per_n=residual
        )


def merge_vectors(vectors: FloatArray, weight: FloatArray, strengths: list[FloatArray]) -> FloatArray:
    """Build a basis of the span of `vectors`' rows without the weakest directions.

    Parameters
    ----------
    vectors
        float64, shape (count, n): the spaces' vectors, space after space.
    weight
        float64, shape (n,): the basis is orthonormal after multiplication with it.
    strengths
        For each space the columns that make its directions of its vectors, in their relative strength; all
        spaces have the same weight.

    Returns
    -------
    float64, shape (count, r): the columns that make the basis of the vectors.
    """
    weighted = vectors * weight
    gram = weighted @ weighted.T
    start = 0
    alike = []
    for columns in strengths:
        own = gram[start : start + len(columns), start : start + len(columns)]
        alike.append(columns / np.sqrt(np.sum(columns * (own @ columns))))
        start += len(columns)
    mixing = linalg.block_diag(*alike)
    strength, directions = linalg.eigh(mixing.T @ gram @ mixing, check_finite=False)
    is_strong = strength > MERGE_TOLERANCE**2 * strength[-1]
    return np.asarray(mixing @ (directions[:, is_strong] / np.sqrt(strength[is_strong])))
