"""How deep the wall of a position is gone at a given hour.

The patch thins slowly and unevenly about a linear trend, the shape of the paper's figure 15. A hole
is a pit in a patch that is much less thinned: the mean depth enters the plate model, the pit's depth
only decides when nothing is reflected any more. That split is our reading of the paper, which found
holes at a time of flight only about 10 % longer. A table of hours and depths replaces the trend.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware_drivers.nanoseconds import NS_PER_S
from simulator.numerics.keyed_random import Purpose, generator
from simulator.parameters.experiment import ThinningParameters
from simulator.parameters.plate import DEEPEST_PATCH_FRACTION

HARMONICS = 5
"""Slow variations of the rate between onset and reference hour: periods down to a fifth of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wall:
    """State of a wall as fractions of its thickness."""

    depth_fraction: float
    pit_depth_fraction: float

    @property
    def is_hole(self) -> bool:
        """True once the pit is through: the chain finds no plate and nothing is reflected."""
        return self.pit_depth_fraction >= DEEPEST_PATCH_FRACTION


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WallHistory:
    """Depth of one position over time.

    Attributes
    ----------
    amplitudes, phases_rad
        Shape (HARMONICS,): the rate over its mean is ``1 + sum(a_k cos(2 pi k u + p_k))`` with u the
        time since onset over the time from onset to the reference hour. The amplitudes add up to
        ``unevenness``, below 1, so the depth never falls.
    """

    thinning: ThinningParameters
    amplitudes: NDArray[np.float64]
    phases_rad: NDArray[np.float64]

    def at(self, hour_h: float) -> Wall:
        """State at an hour of the experiment."""
        onset_h, reference_h = self.thinning.onset_h, self.thinning.reference_h
        since_onset_h = max(hour_h - onset_h, 0.0)
        if self.thinning.history:
            hours, depths = zip(*self.thinning.history, strict=True)
            mean = float(np.interp(hour_h, hours, depths))
        else:
            mean = self.thinning.depth_fraction * self._progress(since_onset_h / (reference_h - onset_h))
            mean = min(mean, DEEPEST_PATCH_FRACTION)
        pit = mean
        if self.thinning.hole_h is not None:
            # Compared in hours first: rounding of the ratio must not move the hole by an interval.
            through = hour_h >= self.thinning.hole_h
            growth = since_onset_h / (self.thinning.hole_h - onset_h)
            grown = np.nextafter(DEEPEST_PATCH_FRACTION, 0.0) * min(growth, 1.0)
            pit = DEEPEST_PATCH_FRACTION if through else max(mean, float(grown))
        return Wall(depth_fraction=mean, pit_depth_fraction=pit)

    def _progress(self, u: float) -> float:
        """Integral of the relative rate; 1 at u = 1 whatever the phases, since each term is periodic."""
        k = 2.0 * np.pi * np.arange(1, HARMONICS + 1)
        wobble = self.amplitudes / k * (np.sin(k * u + self.phases_rad) - np.sin(self.phases_rad))
        return u + float(wobble.sum())


def wall_history(thinning: ThinningParameters, *, seed: int, position: str) -> WallHistory:
    """Draw the unevenness of one position's rate."""
    random = generator(seed, Purpose.THINNING, position=position)
    shares = random.dirichlet(np.ones(HARMONICS))
    return WallHistory(
        thinning=thinning,
        amplitudes=thinning.unevenness * shares,
        phases_rad=random.uniform(0.0, 2.0 * np.pi, HARMONICS),
    )


def held_hour_h(elapsed_ns: int, update_interval_s: float) -> float:
    """Hour of the experiment rounded down to the update interval.

    Rounded in integer nanoseconds: a due time that is a multiple of the interval belongs to the
    interval it opens.
    """
    interval_ns = round(update_interval_s * NS_PER_S)
    return elapsed_ns // interval_ns * interval_ns / NS_PER_S / 3600.0
