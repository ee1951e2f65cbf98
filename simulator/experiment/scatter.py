"""Scatter between shots on the same wall: drop height, tilt, temperature, sensitivity."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hardware_drivers.measurement import ShotKey
from simulator.experiment.processes import draw_slow_drift, evaluate_slow_drift
from simulator.numerics.arrays import FloatArray
from simulator.numerics.keyed_random import Purpose, keyed_generator
from simulator.parameters.chain import ChainParameters
from simulator.parameters.electronics import SensorParameters
from simulator.parameters.experiment import DriftParameters, ScatterParameters

STEEPEST_TILT_RAD = 0.2
"""Bound of `ChainParameters.tilt_rad`; a disk tilted further has left the chain."""
HIGHEST_DROP_M = 1.0
"""Bound of `ChainParameters.drop_height_m`."""
LOWEST_DROP_FRACTION = 0.01
"""Floor of the drop height over its nominal one: a guide never shrinks the drop to nothing."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Temperature:
    """Room temperature over time: day and night, and a slow seeded drift (`processes.draw_slow_drift`)."""

    drift: DriftParameters
    drawn: tuple[FloatArray, FloatArray]

    def at(self, hour_h: float) -> float:
        """Return the temperature in degrees Celsius at an hour of the test; the mean if drift is disabled."""
        return _compute_temperature_c(self, hour_h) if self.drift.enabled else self.drift.mean_temperature_c


@lru_cache(maxsize=256)
def _compute_temperature_c(room: Temperature, hour_h: float) -> float:
    """Compute the temperature of a drifting room in degrees Celsius, cached: all shots of an hour need it."""
    drift = room.drift
    day = drift.diurnal_amplitude_k * np.cos(2.0 * np.pi * (hour_h - drift.warmest_hour_h) / 24.0)
    wander_k = drift.wander_sd_k * evaluate_slow_drift(hour_h, room.drawn)[0]
    return float(drift.mean_temperature_c + day + wander_k)


def draw_room_temperature(drift: DriftParameters, *, seed: int) -> Temperature:
    """Draw the slow temperature drift of the room, the same for all positions."""
    drawn = draw_slow_drift(Purpose.TEMPERATURE, seed, "", 1, drift.shortest_wander_h, drift.longest_wander_h)
    return Temperature(drift=drift, drawn=drawn)


@dataclass(frozen=True, slots=True, kw_only=True)
class Strike:
    """Deviations of one strike and its sensor from the nominal ones."""

    drop_height_m: float
    tilt_rad: float
    sensor_gain_v_per_n: float


def draw_scattered_strike(
    key: ShotKey,
    *,
    seed: int,
    chain: ChainParameters,
    scatter: ScatterParameters,
    drift: DriftParameters,
    sensor: SensorParameters,
    temperature_c: float,
) -> Strike:
    """Draw drop height, tilt and sensitivity of one shot with its random scatter.

    The logarithm of the drop height is normal: it stays positive, and time of flight and amplitude, powers of
    it, scatter evenly to both sides. The tilt is uniform: the disk is somewhere in the play of its guide, and
    nowhere beyond. The set's part is drawn from the set alone, so all its shots share it. The drop height is
    limited to 0.01 times the nominal one and 1 m, the tilt to 0.2 rad.
    """
    set_part = _draw_set_scatter(seed, ShotKey.from_set(key.set_key, key.position, 0))
    shot_part = _draw_unit_scatter(keyed_generator(seed, Purpose.SHOT_SCATTER, key=key))
    warmer_k = temperature_c - drift.mean_temperature_c

    log_drop = scatter.scale * float(
        scatter.set_drop_height_sd_fraction * set_part[0]
        + scatter.shot_drop_height_sd_fraction * shot_part[0]
    )
    growth_m = drift.guide_length_m * drift.guide_expansion_per_k * warmer_k
    drop_height_m = chain.drop_height_m * np.exp(log_drop) + growth_m
    tilt_rad = (
        chain.tilt_rad
        + scatter.mean_tilt_rad
        + scatter.scale
        * float(scatter.set_tilt_sd_rad * set_part[1] + scatter.shot_tilt_sd_rad * shot_part[1])
    )
    # A disk tilted past upright leans to the other side, which for the wave is the same tilt.
    tilt_rad = min(abs(tilt_rad), STEEPEST_TILT_RAD)
    return Strike(
        drop_height_m=float(
            min(max(drop_height_m, LOWEST_DROP_FRACTION * chain.drop_height_m), HIGHEST_DROP_M)
        ),
        tilt_rad=tilt_rad,
        sensor_gain_v_per_n=float(
            sensor.sensitivity_v_per_n
            * np.exp(drift.sensitivity_per_k * warmer_k - sensor.tilt_loss_per_rad * tilt_rad)
        ),
    )


@lru_cache(maxsize=256)
def _draw_set_scatter(seed: int, set_key: ShotKey) -> tuple[float, float]:
    """Draw the two numbers of variance 1 that all shots of a set share, for drop height and tilt."""
    return _draw_unit_scatter(keyed_generator(seed, Purpose.SET_SCATTER, key=set_key))


def _draw_unit_scatter(random: np.random.Generator) -> tuple[float, float]:
    """Draw a normal and a uniform number, of mean 0 and variance 1, for drop height and tilt."""
    half_width = np.sqrt(3.0)
    return float(random.standard_normal()), float(random.uniform(-half_width, half_width))
