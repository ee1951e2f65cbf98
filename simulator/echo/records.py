"""Records of an ultrasonic probe: from the wall to the averaged record.

What differs between two records of one wall is noise, the couplant and the bubbles in the liquid; each is
keyed by seed, key and purpose.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hardware_drivers.measurement import Calibration, ShotKey
from simulator.echo.far_wall import FarWall, RoughSpot
from simulator.echo.pulse import simulate_bubbles, simulate_echo, travel_time_s, warm_probe_and_wall
from simulator.electronics.transduction import quantise_volts
from simulator.numerics.arrays import FloatArray
from simulator.numerics.keyed_random import Purpose, keyed_generator
from simulator.parameters.echo import EchoParameters

RECORDS_AT_ONCE = 64
"""Single records held at a time where each has to be drawn."""
CLIPPING_SDS = 7.0
"""No sample of a record's white noise reaches so many standard deviations: one in 4e11 does."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProbedWall:
    """Wall under a probe at one hour.

    Attributes
    ----------
    thickness_m
        Mean under the beam.
    facets
        The far wall where it is rough; None where it is smooth.
    warmer_k
        Temperature above the one at which the parameters hold.
    """

    thickness_m: float
    facets: FarWall | None
    warmer_k: float

    def volts(self, echo: EchoParameters) -> FloatArray:
        """Simulate the noise-free record of this wall in V, shape (record_samples,).

        Raise ValueError if a smooth wall has no thickness left.
        """
        return simulate_echo(
            self.thickness_m if self.facets is None else self.facets, warm_probe_and_wall(echo, self.warmer_k)
        )

    def truth(self, echo: EchoParameters) -> dict[str, float]:
        """Return the wall's true values that are stored with a record, by column name.

        They are ``thickness_m`` and ``travel_time_s``, that of a smooth wall, and for a rough wall
        ``thickness_least_m`` and ``roughness_rms_m``.
        """
        known = {
            "thickness_m": self.thickness_m,
            "travel_time_s": travel_time_s(self.thickness_m, warm_probe_and_wall(echo, self.warmer_k)),
        }
        if self.facets is not None:
            known |= {"thickness_least_m": self.facets.least_m, "roughness_rms_m": self.facets.rms_m}
        return known


def build_wall(
    pristine_m: float, depth_fraction: float, spot: RoughSpot | None, warmer_k: float
) -> ProbedWall:
    """Build the wall under a probe at one depth; without a spot or without loss it is smooth.

    ``depth_fraction`` is the mean loss over ``pristine_m``, ``warmer_k`` the temperature in K above that at
    which the parameters hold.
    """
    return ProbedWall(
        thickness_m=pristine_m * (1.0 - depth_fraction),
        facets=None if spot is None or depth_fraction == 0.0 else spot.at(pristine_m, depth_fraction),
        warmer_k=warmer_k,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbance:
    """Disturbances of the records of one acquisition, without the noise.

    Attributes
    ----------
    gain
        Of the couplant, over the nominal one; of all records.
    bubbles
        Whether bubbles rise past the probe.
    """

    gain: float = 1.0
    bubbles: bool = False


def draw_disturbance(
    echo: EchoParameters, *, seed: int, key: ShotKey
) -> tuple[Disturbance, dict[str, float]]:
    """Draw couplant and bubbles of one acquisition; return also the true values of the active ones.

    Those are ``coupling_gain`` and ``bubbles`` (0 or 1). Equal seed and key give the same result.
    """
    gain, bubbles, truth = 1.0, False, {}
    if echo.coupling_sd_db > 0.0:
        level_db = echo.coupling_sd_db * keyed_generator(seed, Purpose.COUPLING, key=key).standard_normal()
        gain = truth["coupling_gain"] = float(10.0 ** (level_db / 20.0))
    if echo.bubble_probability > 0.0:
        bubbles = bool(keyed_generator(seed, Purpose.BUBBLES, key=key).random() < echo.bubble_probability)
        truth["bubbles"] = float(bubbles)
    return Disturbance(gain=gain, bubbles=bubbles), truth


def simulate_disturbed_records(
    wall: ProbedWall, echo: EchoParameters, found: Disturbance, *, seed: int, key: ShotKey, records: int
) -> FloatArray:
    """Simulate single records in volts before their noise, shape (records, record_samples).

    Couplant gain and bubbles are applied; each record has bubbles of its own.
    """
    volts = np.tile(wall.volts(echo), (records, 1))
    if found.bubbles:
        random = keyed_generator(seed, Purpose.BUBBLES, key=key)
        random.random()  # what `disturbance` has drawn
        volts += simulate_bubbles(wall.thickness_m, warm_probe_and_wall(echo, wall.warmer_k), random, records)
    return found.gain * volts


def simulate_record(
    wall: ProbedWall,
    echo: EchoParameters,
    calibration: Calibration,
    found: Disturbance,
    *,
    seed: int,
    key: ShotKey,
    noisy: bool,
) -> tuple[FloatArray, int]:
    """Simulate the mean of single records in V, shape (record_samples,); return also how many were clipped.

    Every record is cut off at the ends of the ADC's range before the mean, as in a receiver: with noise the
    mean then no longer shows it. Where no record can come that far, their noise is drawn once, as the mean's.
    Without ``noisy`` there is no noise.
    """
    low, high = calibration.full_scale_counts
    noise_v = echo.noise_rms_v if noisy else 0.0
    if found.bubbles:
        mean_v = simulate_disturbed_records(
            wall, echo, found, seed=seed, key=key, records=echo.averages
        ).mean(axis=0)
    else:
        mean_v = found.gain * wall.volts(echo)
    random = keyed_generator(seed, Purpose.ECHO_NOISE, key=key)
    reach_v = float(np.abs(mean_v).max()) + CLIPPING_SDS * noise_v
    if reach_v < calibration.volts(np.array([high - 1], dtype=np.int32))[0]:
        if noisy:
            # The mean of n records of white noise scatters by 1 / sqrt(n) of one record.
            mean_v = mean_v + noise_v / np.sqrt(echo.averages) * random.standard_normal(mean_v.size)
        return mean_v, 0
    ends_v = calibration.volts(np.array([low, high], dtype=np.int32))
    total_v, clipped = np.zeros_like(mean_v), 0
    for records in _split_into_batches(echo.averages):
        volts = mean_v + noise_v * random.standard_normal((records, mean_v.size))
        counts = quantise_volts(volts, calibration)
        clipped += int(np.count_nonzero((counts <= low + 1).any(axis=1) | (counts >= high).any(axis=1)))
        total_v += np.clip(volts, *ends_v).sum(axis=0)
    return total_v / echo.averages, clipped


def _split_into_batches(records: int) -> Iterator[int]:
    """Yield batch sizes of at most 64 that add up to a number of records."""
    for first in range(0, records, RECORDS_AT_ONCE):
        yield min(RECORDS_AT_ONCE, records - first)
