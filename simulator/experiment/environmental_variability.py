"""Environmental and operational variability of one shot, a pure function of seed, key and hour.

`parameters.nuisance` has the sizes, `seating` what the shots of a set share. `TransducerNuisance` says how
each strike of one transducer finds the chain: contacts, drop height, tilt, gain, temperatures, noise. The
altered shot takes the same way as a plain one, through the physics, the trigger and the ADC, and leaves what
was drawn with its record, as columns ``nuisance_...`` of its truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from hardware_drivers.measurement import ShotKey
from simulator.chain.spheres import Contacts
from simulator.electronics.interference import Ringing
from simulator.experiment.processes import draw_unit_t
from simulator.experiment.scatter import HIGHEST_DROP_M, LOWEST_DROP_FRACTION, STEEPEST_TILT_RAD, Strike
from simulator.experiment.seating import Climate, Seat, draw_seat_of_set
from simulator.numerics.arrays import FloatArray
from simulator.numerics.keyed_random import Purpose, keyed_generator
from simulator.parameters.chain import ChainParameters
from simulator.parameters.electronics import NoiseParameters, SensorParameters
from simulator.parameters.environmental_variability import NUISANCE

FARTHEST_LOG = np.log([2.0, 10.0, 10.0, 2.0])
"""A contact stays within a factor of two of its stiffness and of ten of its dashpot, the drop height within
ten and the gain within two: tails of a logarithm would otherwise reach what no chain has (assumption)."""

SHOTS_A_BLOCK = 16
"""Shots of a set that are drawn together; part of every seed's meaning."""

KNOCK_HZ, KNOCK_DECAY_S = (2e3, 12e3), (0.3e-3, 1e-3)
"""A blow on a structure rings in this range (assumption)."""
BURST_HZ, BURST_DECAY_S = (1e5, 1e6), (5e-6, 50e-6)
"""A switched motor rings in this range (assumption)."""
RINGS_FROM_S, RINGS_TO_S = -0.3e-3, 1.2e-3
"""Such a ring begins evenly somewhere here, from the striker's contact on."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShotNuisance:
    """Deviations of one strike from one without variability.

    Attributes
    ----------
    reseats
        How many there were so far.
    rogue
        One contact is badly seated, and the striker lost height.
    wear_factor, drop_factor, gain_factor, noise_factor
        Of radii of curvature, drop height, sensitivity and electronic noise.
    tilt_rad
        Of the sensor disk, on top of its own; either sign.
    chain_warmer_k, plate_warmer_k
        Temperature of chain and guide, and of the plate, over `DriftParameters.mean_temperature_c`.
    contacts, plate_modulus_factor
        With all that acts on them, temperature included.
    liquid_factor
        Depth of the liquid on the plate over the full one; it does nothing to a dry plate.
    knock, burst
        Ringing that the record contains; None without.
    """

    reseats: int
    rogue: bool
    wear_factor: float
    drop_factor: float
    gain_factor: float
    noise_factor: float
    tilt_rad: float
    chain_warmer_k: float
    plate_warmer_k: float
    contacts: Contacts
    plate_modulus_factor: float
    liquid_factor: float
    knock: Ringing | None
    burst: Ringing | None

    @property
    def rings(self) -> list[Ringing]:
        """Return the knock and the burst of the record, in this order; empty without either."""
        return [ring for ring in (self.knock, self.burst) if ring is not None]

    def truth(self) -> dict[str, float]:
        """Return the true values of the variability that are stored with the record, by column name.

        The columns begin with ``nuisance_``; ``temperature_c`` and those of the strike hold the rest.
        """
        contacts = self.contacts
        values = (
            float(self.reseats),
            float(self.rogue),
            self.wear_factor,
            self.drop_factor,
            self.gain_factor,
            self.noise_factor,
            self.tilt_rad,
            self.plate_warmer_k,
            self.plate_modulus_factor,
            self.liquid_factor,
            0.0 if self.knock is None else self.knock.height_v,
            0.0 if self.burst is None else self.burst.height_v,
            *contacts.stiffness_factor.tolist(),
            *contacts.damping_factor.tolist(),
        )
        return dict(zip(_truth_column_names(contacts.stiffness_factor.size), values, strict=True))


@lru_cache(maxsize=16)
def _truth_column_names(bodies: int) -> tuple[str, ...]:
    """Return the names of the variability's true values for a chain, in their order."""
    alone = (
        *("reseats", "rogue", "wear_radius_factor", "drop_factor", "gain_factor", "noise_factor", "tilt_rad"),
        *("plate_warmer_k", "plate_modulus_factor", "liquid_factor", "knock_v", "burst_v"),
    )
    each = (f"{name}_factor_{contact}" for name in ("stiffness", "damping") for contact in range(bodies))
    return tuple(f"nuisance_{name}" for name in (*alone, *each))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Block:
    """Several shots of one set, drawn together because that costs little more than one.

    Attributes
    ----------
    factors
        Shape (SHOTS_A_BLOCK, 2 n + 2): of A and gamma of each contact, drop height and gain.
    tilt_rad, even, normal
        Shape (SHOTS_A_BLOCK,), (SHOTS_A_BLOCK, 11) and (SHOTS_A_BLOCK, 4).
    """

    seat: Seat
    factors: FloatArray
    tilt_rad: FloatArray
    even: FloatArray
    normal: FloatArray


@lru_cache(maxsize=64)
def _draw_shot_block(
    level: str,
    seed: int,
    chain: ChainParameters,
    weather: Climate,
    first: ShotKey,
    hour_h: float,
    warmer_k: float,
) -> _Block:
    """Draw the deviations of 16 shots of a set; the shot index of ``first`` is the number of the block.

    ``level`` is a key of `NUISANCE`; ``warmer_k`` is the temperature over the mean one without the climate,
    in K. Cached; the factors are read-only.
    """
    parameters, n = NUISANCE[level], chain.bodies
    seat = draw_seat_of_set(
        level,
        seed,
        first.position,
        chain,
        weather,
        set_key=first.set_key,
        hour_h=hour_h,
        warmer_k=warmer_k,
    )
    random = keyed_generator(seed, Purpose.SEATING_OF_SHOT, key=first)
    drawn = draw_unit_t(random, parameters.tail_dof, (SHOTS_A_BLOCK, 1, seat.shot_effect.shape[1]))
    # As many numbers for every shot, so that no nuisance moves the digits of another.
    even, normal = random.random((SHOTS_A_BLOCK, 11)), random.standard_normal((SHOTS_A_BLOCK, 4))
    # Not a product of matrices: BLAS would round as the machine likes.
    logs = seat.place + (seat.shot_effect * drawn).sum(axis=-1)
    for row in np.flatnonzero(even[:, 0] < parameters.rogue_probability):
        contact = int(even[row, 1] * n)
        logs[row, contact] += parameters.rogue_stiffness_sd * normal[row, 0]
        logs[row, n + contact] += parameters.rogue_stiffness_sd * abs(normal[row, 1])
        logs[row, 2 * n] += math.log1p(-parameters.rogue_drop_loss * even[row, 2])
    farthest = np.repeat(FARTHEST_LOG, (n, n, 1, 1))
    factors = np.exp(np.clip(logs[:, :-1], -farthest, farthest))
    factors.flags.writeable = False  # contacts of shots are views of it
    return _Block(
        seat=seat,
        factors=factors,
        tilt_rad=logs[:, -1],
        even=even,
        normal=normal,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TransducerNuisance:
    """Environmental and operational variability of one transducer."""

    level: str
    seed: int
    chain: ChainParameters
    climate: Climate

    def at(self, key: ShotKey, hour_h: float, warmer_k: float) -> ShotNuisance:
        """Return the environmental deviations of one strike at an hour of the test, drawn from the seed.

        Parameters
        ----------
        warmer_k
            Temperature of the transducer over the mean one without the climate.
        """
        parameters, n = NUISANCE[self.level], self.chain.bodies
        block, row = divmod(key.shot_index, SHOTS_A_BLOCK)
        first = replace(key, shot_index=block)
        shots = _draw_shot_block(self.level, self.seed, self.chain, self.climate, first, hour_h, warmer_k)
        seat, even, normal = shots.seat, shots.even[row], shots.normal[row]
        factors = shots.factors[row]
        knocked = even[3] < parameters.knock_probability
        burst = seat.noisy and even[7] < parameters.burst_probability
        return ShotNuisance(
            reseats=seat.reseats,
            rogue=bool(even[0] < parameters.rogue_probability),
            wear_factor=seat.wear_factor,
            drop_factor=float(factors[-2]),
            gain_factor=float(factors[-1]),
            noise_factor=parameters.noisy_factor if seat.noisy else 1.0,
            tilt_rad=float(shots.tilt_rad[row]),
            chain_warmer_k=seat.chain_warmer_k,
            plate_warmer_k=seat.plate_warmer_k,
            contacts=Contacts(stiffness_factor=factors[:n], damping_factor=factors[n : 2 * n]),
            plate_modulus_factor=seat.plate_modulus_factor,
            liquid_factor=seat.liquid_factor,
            knock=_build_ringing(parameters.knock_v * normal[2], KNOCK_HZ, KNOCK_DECAY_S, even[4:7])
            if knocked
            else None,
            burst=_build_ringing(parameters.burst_v * normal[3], BURST_HZ, BURST_DECAY_S, even[8:11])
            if burst
            else None,
        )


def _build_ringing(
    height_v: float, range_hz: tuple[float, float], decay_s: tuple[float, float], even: FloatArray
) -> Ringing:
    """Build a ringing from three uniform numbers: start, and log-uniform frequency and decay."""
    return Ringing(
        start_s=RINGS_FROM_S + (RINGS_TO_S - RINGS_FROM_S) * float(even[0]),
        height_v=float(height_v),
        frequency_hz=range_hz[0] * (range_hz[1] / range_hz[0]) ** float(even[1]),
        decay_s=decay_s[0] * (decay_s[1] / decay_s[0]) ** float(even[2]),
    )


def disturb_strike(
    strike: Strike, found: ShotNuisance, chain: ChainParameters, sensor: SensorParameters
) -> Strike:
    """Return a strike with the variability applied: drop height, tilt with its loss of gain, and gain.

    The drop height is limited to 0.01 times the nominal one and 1 m, the tilt to 0.2 rad.
    """
    # A disk tilted past upright leans to the other side, which for the wave is the same tilt.
    tilt_rad = min(abs(strike.tilt_rad + found.tilt_rad), STEEPEST_TILT_RAD)
    tilt_loss = math.exp(-sensor.tilt_loss_per_rad * (tilt_rad - strike.tilt_rad))
    lowest_m = LOWEST_DROP_FRACTION * chain.drop_height_m
    return Strike(
        drop_height_m=min(max(strike.drop_height_m * found.drop_factor, lowest_m), HIGHEST_DROP_M),
        tilt_rad=tilt_rad,
        sensor_gain_v_per_n=strike.sensor_gain_v_per_n * tilt_loss * found.gain_factor,
    )


@lru_cache(maxsize=16)
def scale_noise(noise: NoiseParameters, factor: float) -> NoiseParameters:
    """Return the noise with its RMS values scaled by the factor of an hour; disabled noise stays disabled."""
    if factor == 1.0:
        return noise
    return replace(noise, rms_v=noise.rms_v * factor, slow_rms_v=noise.slow_rms_v * factor)
