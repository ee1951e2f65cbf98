"""Wall loss of a position at a given hour.

The patch thins slowly and unevenly about a linear trend, the shape of the paper's figure 15. A hole
is a pit in a patch that is much less thinned: the mean depth enters the plate model, the pit's depth
only decides when nothing is reflected any more. That split is our reading of the paper, which found
holes at a time of flight only about 10 % longer. A table of hours and depths replaces the trend.

With `pits_per_edge` the patch is a mosaic of pits whose depths have a spectrum: their mean follows the trend,
they all grow alike, so that the patch roughens as it thins, and the deepest one, under the chain, goes
through. The plate is reduced once for its life: each pit's depth is a constant part of the deepest one's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy  # `scipy.optimize` comes when asked for
from numpy.typing import NDArray

from hardware_drivers.nanoseconds import NS_PER_S
from simulator.errors import SpecimenError
from simulator.numerics.arrays import FloatArray
from simulator.numerics.keyed_random import Purpose, keyed_generator
from simulator.parameters.experiment import ThinningParameters, TwinParameters
from simulator.parameters.plate import DEEPEST_PATCH_FRACTION, CorrosionParameters, PatchParameters

PIT_SHAPE = 2.0
"""Of the Weibull distribution of pit depths, which is often fitted to them (that it is 2: assumption)."""
SHALLOWEST_PIT = 0.05
"""Part of the deepest one's depth that even the shallowest has: the patch thins everywhere (assumption)."""
HARMONICS = 5
"""Slow variations of the rate between onset and reference hour: periods down to a fifth of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wall:
    """State of a wall as fractions of its thickness.

    Attributes
    ----------
    depth_fraction, pit_depth_fraction
        Mean and deepest.
    is_pitted
        The plate's patch is a mosaic of pits.
    """

    depth_fraction: float
    pit_depth_fraction: float
    is_pitted: bool = False

    @property
    def patch_depth_fraction(self) -> float:
        """Return the depth for the model of the plate: a flat patch's mean, a mosaic's deepest pit."""
        return self.pit_depth_fraction if self.is_pitted else self.depth_fraction

    @property
    def is_hole(self) -> bool:
        """Return True once the pit is through: the chain finds no plate and nothing is reflected."""
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
    pits
        Shape (pits_per_edge, pits_per_edge): depth of each pit over that of the deepest; empty without.
    """

    thinning: ThinningParameters
    amplitudes: NDArray[np.float64]
    phases_rad: NDArray[np.float64]
    pits: NDArray[np.float64]

    def at(self, hour_h: float) -> Wall:
        """Return the mean and deepest wall loss at an hour of the test; cached."""
        return _compute_wall_state(self, hour_h)

    def compute_mean_depth(self, hour_h: float) -> float:
        """Return the mean depth at an hour of the test, as a fraction of the thickness; it never falls."""
        onset_h, reference_h = self.thinning.onset_h, self.thinning.reference_h
        if self.thinning.history:
            hours, depths = zip(*self.thinning.history, strict=True)
            return float(np.interp(hour_h, hours, depths))
        u = max(hour_h - onset_h, 0.0) / (reference_h - onset_h)
        return min(self.thinning.depth_fraction * self._integrate_rate(u), DEEPEST_PATCH_FRACTION)

    def _integrate_rate(self, u: float) -> float:
        """Integrate the uneven rate of thinning, relative to its mean, up to ``u``.

        ``u`` is the time since onset over that from onset to the reference hour. The result is 1 at u = 1 for
        any phases, since each term is periodic.
        """
        k = 2.0 * np.pi * np.arange(1, HARMONICS + 1)
        wobble = self.amplitudes / k * (np.sin(k * u + self.phases_rad) - np.sin(self.phases_rad))
        return u + float(wobble.sum())


@lru_cache(maxsize=256)
def _compute_wall_state(history: WallHistory, hour_h: float) -> Wall:
    """Return mean and deepest loss of a wall at an hour, cached: all shots of a set need it."""
    mean = history.compute_mean_depth(hour_h)
    pit, onset_h = mean, history.thinning.onset_h
    is_pitted = history.pits.size > 0
    if is_pitted:
        pit = min(mean / float(history.pits.mean()), DEEPEST_PATCH_FRACTION)
    if history.thinning.hole_h is not None:
        # Compared in hours first: rounding of the ratio must not move the hole by an interval.
        through = hour_h >= history.thinning.hole_h
        deepest = float(np.nextafter(DEEPEST_PATCH_FRACTION, 0.0))
        growth = max(hour_h - onset_h, 0.0) / (history.thinning.hole_h - onset_h)
        grown = min(pit, deepest) if is_pitted else max(mean, deepest * min(growth, 1.0))
        pit = DEEPEST_PATCH_FRACTION if through else grown
    return Wall(depth_fraction=mean, pit_depth_fraction=pit, is_pitted=is_pitted)


def draw_wall_history(thinning: ThinningParameters, *, seed: int, position: str) -> WallHistory:
    """Draw the uneven corrosion rate of one position, and its pits if it has any; same seed, same history.

    Raise SpecimenError if the mean depth at the hour of the hole leaves no room for the pits.
    """
    random = keyed_generator(seed, Purpose.THINNING, position=position)
    shares = random.dirichlet(np.ones(HARMONICS))
    flat = WallHistory(
        thinning=thinning,
        amplitudes=thinning.unevenness * shares,
        phases_rad=random.uniform(0.0, 2.0 * np.pi, HARMONICS),
        pits=np.empty((0, 0)),
    )
    return replace(flat, pits=_draw_pit_depths(flat, seed, position)) if thinning.pits_per_edge else flat


def _draw_pit_depths(flat: WallHistory, seed: int, position: str) -> FloatArray:
    """Draw a Weibull spectrum of pit depths over the deepest, which is in the middle; shape (count, count).

    Where the hour of the hole is given the spectrum is stretched, as a power, until its mean is that of the
    law over `DEEPEST_PATCH_FRACTION` at that hour, so that the deepest pit is through then. Raise
    SpecimenError if the mean depth at that hour leaves no room for such a spectrum.
    """
    count, hole_h = flat.thinning.pits_per_edge, flat.thinning.hole_h
    drawn = keyed_generator(seed, Purpose.PITS, position=position).weibull(PIT_SHAPE, (count, count))
    deepest, middle = np.unravel_index(int(drawn.argmax()), drawn.shape), (count // 2, count // 2)
    drawn[deepest], drawn[middle] = drawn[middle], drawn[deepest]
    pits = np.maximum(drawn / drawn[middle], SHALLOWEST_PIT)
    if hole_h is None:
        return np.asarray(pits)
    mean = flat.compute_mean_depth(hole_h) / DEEPEST_PATCH_FRACTION
    least, most = pits.size**-1.0, 1.0
    if not least < mean < most:
        raise SpecimenError(
            f"the mean depth at {position} is {mean * DEEPEST_PATCH_FRACTION:.3g} of the wall at hole_h; "
            f"with {pits.size} pits it must lie between {least * DEEPEST_PATCH_FRACTION:.3g} and "
            f"{DEEPEST_PATCH_FRACTION}: change thinning.{position}.depth_fraction or pits_per_edge"
        )
    power = scipy.optimize.brentq(lambda exponent: float((pits**exponent).mean()) - mean, 0.0, 1e3)
    return np.asarray(np.maximum(pits**power, 1e-6))


def make_patch(twin: TwinParameters, position: str, corrosion: CorrosionParameters) -> CorrosionParameters:
    """Return the patch of a position for its plate model: a mosaic if it has pits.

    Raises
    ------
    SpecimenError
        The patch cannot be divided, or the law of thinning leaves no room for the pits.
    """
    thinning = twin.thinning.get(position, ThinningParameters())
    return divide_into_pits(corrosion, draw_wall_history(thinning, seed=twin.seed, position=position))


def divide_into_pits(corrosion: CorrosionParameters, history: WallHistory) -> CorrosionParameters:
    """Divide a patch into pits; return `corrosion` itself if there are none.

    Raises
    ------
    SpecimenError
        The patch cannot be divided: it is not one flat square.
    """
    if not history.pits.size:
        return corrosion
    if (corrosion.shape, corrosion.profile, corrosion.further) != ("square", "flat", ()):
        raise SpecimenError(
            f"pits_per_edge divides one flat square patch; this one is {corrosion.profile} and "
            f"{corrosion.shape} with {len(corrosion.further)} further patches: set shape = 'square', "
            "profile = 'flat' and no further ones, or pits_per_edge = 0"
        )
    count = len(history.pits)
    size_m = corrosion.size_m / count
    places_m = size_m * (np.arange(count) - count // 2)
    first, *further = (
        PatchParameters(
            size_m=size_m,
            offset_x_m=corrosion.offset_x_m + float(x_m),
            offset_y_m=corrosion.offset_y_m + float(y_m),
            depth_factor=float(history.pits[i, j]),
        )
        for i, x_m in enumerate(places_m)
        for j, y_m in enumerate(places_m)
    )
    return replace(
        corrosion,
        size_m=size_m,
        offset_x_m=first.offset_x_m,
        offset_y_m=first.offset_y_m,
        depth_factor=first.depth_factor,
        further=tuple(further),
    )


def round_down_hour_h(elapsed_ns: int, update_interval_s: float) -> float:
    """Return the hour of the test rounded down to the update interval.

    Rounded in integer nanoseconds: a due time that is a multiple of the interval belongs to the
    interval it opens.
    ``elapsed_ns`` is the time since the start of the test.
    """
    interval_ns = round(update_interval_s * NS_PER_S)
    return elapsed_ns // interval_ns * interval_ns / NS_PER_S / 3600.0
