"""Far wall under an ultrasonic probe: facets of local thickness, weighted by the beam.

Every spot corrodes at a rate of its own that it keeps: the local loss is the mean loss times a lognormal
field whose logarithm is Gaussian and correlated over a few millimetres. So the wall roughens as
it thins, a sound wall is smooth, no spot ever grows back, and pits are deeper than plateaus are high.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from simulator.numerics.arrays import FloatArray
from simulator.numerics.keyed_random import Purpose, keyed_generator
from simulator.parameters.echo import EchoParameters

PLANE_WAVES = 512
"""Waves the field is made of: its fourth moment then misses the Gaussian one by 0.3 %."""
FACETS_ACROSS = 80
"""Facets along a diameter: heights then change by little of the wave's length from one to the next."""
SPOT_REACH_DIAMETERS = 1.2
"""Radius of the disk of facets in -6 dB diameters: the beam has fallen by 35 dB there."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoughSpot:
    """Rough part of the far wall under a probe, at any depth.

    Attributes
    ----------
    relative_loss
        Shape (n,): local loss of the wall over the mean one, positive; its weighted mean is 1.
    weights
        Shape (n,): sensitivity of the probe to each facet; they add up to 1.
    """

    relative_loss: FloatArray
    weights: FloatArray

    def at(self, pristine_m: float, depth_fraction: float) -> FarWall:
        """Return the far wall after a mean loss of ``depth_fraction`` of its thickness under the beam.

        Facets through which the wall is gone send nothing back: they stay, with thickness 0.
        """
        thickness_m = pristine_m * np.maximum(1.0 - depth_fraction * self.relative_loss, 0.0)
        return FarWall(thickness_m=thickness_m, weights=self.weights)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FarWall:
    """Facets of the far wall; shapes (n,), the weights add up to 1."""

    thickness_m: FloatArray
    weights: FloatArray

    @property
    def mean_m(self) -> float:
        """Return the mean thickness in m, weighted by the beam."""
        return float(self.weights @ self.thickness_m)

    @property
    def rms_m(self) -> float:
        """Return the RMS roughness in m about the mean thickness, weighted by the beam."""
        return math.sqrt(float(self.weights @ (self.thickness_m - self.mean_m) ** 2))

    @property
    def least_m(self) -> float:
        """Return the thickness in m of the thinnest facet inside the -6 dB spot."""
        return float(self.thickness_m[self.weights >= 0.5 * self.weights.max()].min())


def build_smooth_wall(thickness_m: float) -> FarWall:
    """Create a far wall of uniform thickness: one facet of weight 1."""
    return FarWall(thickness_m=np.array([thickness_m]), weights=np.ones(1))


@functools.lru_cache(maxsize=16)
def draw_rough_spot(
    echo: EchoParameters, *, seed: int, position: str, facets_across: int = FACETS_ACROSS
) -> RoughSpot | None:
    """Draw the rough far wall under the probe of one position; None if it stays smooth.

    The depth of a position with a probe is the mean under its beam: the relative loss is scaled to that. The
    field does not depend on the number of facets, so a finer grid samples the same wall. The last 16 results
    are cached, because drawing is the costliest part of building a specimen.
    """
    if echo.roughness_fraction == 0.0:
        return None
    reach_m = SPOT_REACH_DIAMETERS * echo.beam_diameter_m
    across_m = np.linspace(-reach_m, reach_m, 2 * facets_across + 1)[1::2]
    field = draw_gaussian_field(
        across_m,
        across_m,
        echo.correlation_length_m,
        keyed_generator(seed, Purpose.FAR_WALL, position=position),
    )
    distance_m = np.hypot(*np.meshgrid(across_m, across_m, indexing="ij"))
    seen = distance_m <= reach_m
    weights = np.exp(-4.0 * math.log(2.0) * (distance_m[seen] / echo.beam_diameter_m) ** 2)
    weights /= weights.sum()
    loss = np.exp(echo.roughness_fraction * field[seen])
    return RoughSpot(relative_loss=loss / (weights @ loss), weights=weights)


def draw_gaussian_field(
    x_m: FloatArray, y_m: FloatArray, correlation_length_m: float, random: np.random.Generator
) -> FloatArray:
    """Draw a stationary Gaussian field of mean 0 and variance 1, shape (n_x, n_y).

    Its autocorrelation is exp(-r^2 / l^2).

    A sum of plane waves of equal amplitude whose wave vectors are drawn from the field's spectrum, which
    for this autocorrelation is a normal one of SD sqrt(2) / l in each direction.
    """
    kx, ky = random.normal(0.0, math.sqrt(2.0) / correlation_length_m, (2, PLANE_WAVES))
    phases = random.uniform(0.0, 2.0 * math.pi, PLANE_WAVES)
    along_x = np.exp(1j * np.outer(x_m, kx))
    along_y = np.exp(1j * (np.outer(y_m, ky) + phases))
    field: FloatArray = math.sqrt(2.0 / PLANE_WAVES) * (along_x @ along_y.T).real
    return field
