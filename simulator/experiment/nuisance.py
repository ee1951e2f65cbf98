"""What a level of nuisance does to one shot, a pure function of seed, key and hour.

`parameters.nuisance` has the sizes, `processes` the random processes. `TransducerNuisance` says how each
strike of one transducer finds the chain: contacts, drop height, tilt, gain, temperatures, noise. The altered
shot takes the same way as a plain one, through the physics, the trigger and the ADC, and leaves what was
drawn with its record, as columns ``nuisance_...`` of its truth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from hardware_drivers.measurement import ShotKey
from simulator.chain.spheres import Contacts
from simulator.electronics.interference import Ringing
from simulator.experiment.faults import HOURS_PER_YEAR
from simulator.experiment.processes import (
    noisy,
    place_after_reseats,
    remembering,
    unit_t,
    wander,
    wandering,
)
from simulator.experiment.scatter import HIGHEST_DROP_M, LOWEST_DROP_FRACTION, STEEPEST_TILT_RAD, Strike
from simulator.numerics.arrays import FloatArray
from simulator.numerics.keyed_random import Purpose, generator
from simulator.parameters.chain import ChainParameters
from simulator.parameters.electronics import NoiseParameters, SensorParameters
from simulator.parameters.nuisance import NUISANCE, NuisanceParameters

FARTHEST_LOG = {"stiffness": math.log(2.0), "damping": math.log(10.0), "gain": math.log(2.0)}
"""A contact stays within a factor of two of its stiffness and of ten of its dashpot, and the gain of two:
tails of a logarithm would otherwise reach dashpots that no contact has (assumption)."""

KNOCK_HZ, KNOCK_DECAY_S = (2e3, 12e3), (0.3e-3, 1e-3)
"""A blow on a structure rings in this range (assumption)."""
BURST_HZ, BURST_DECAY_S = (1e5, 1e6), (5e-6, 50e-6)
"""A switched motor rings in this range (assumption)."""
RINGS_FROM_S, RINGS_TO_S = -0.3e-3, 1.2e-3
"""Such a ring begins evenly somewhere here, from the striker's contact on."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Climate:
    """Temperature of the surroundings on top of `scatter.Temperature`, the same for all positions."""

    parameters: NuisanceParameters
    warmest_hour_h: float
    season_rad: float
    process: tuple[FloatArray, FloatArray]

    def room_k(self, hour_h: float) -> float:
        """Day and season."""
        day = math.cos(2.0 * math.pi * (hour_h - self.warmest_hour_h) / 24.0)
        season = math.cos(2.0 * math.pi * hour_h / HOURS_PER_YEAR - self.season_rad)
        return self.parameters.day_amplitude_k * day + self.parameters.season_amplitude_k * season

    def process_k(self, hour_h: float) -> float:
        """Plate over room."""
        return self.parameters.process_sd_k * float(wandering(hour_h, self.process)[0])


def climate(level: str, *, seed: int, warmest_hour_h: float) -> Climate:
    """Draw season and process."""
    parameters = NUISANCE[level]
    return Climate(
        parameters=parameters,
        warmest_hour_h=warmest_hour_h,
        season_rad=float(generator(seed, Purpose.SEASON).uniform(0.0, 2.0 * math.pi)),
        process=wander(
            Purpose.PROCESS, seed, "", 1, parameters.shortest_process_h, parameters.longest_process_h
        ),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Sources:
    """The sources of a level, one number for each contact, bead or transducer.

    Attributes
    ----------
    parts
        By the source's name: where its numbers stand in the arrays below, shape (n,).
    """

    parts: Mapping[str, slice]
    set_sd: FloatArray
    memory: FloatArray
    shot_sd: FloatArray
    wander_sd: FloatArray
    reseat_sd: FloatArray


@lru_cache(maxsize=64)
def _sources(level: str, bodies: int) -> _Sources:
    counts = {
        "contact_stiffness": bodies - 1,
        "plate_stiffness": 1,
        "contact_damping": bodies - 1,
        "plate_damping": 1,
        "bead_radius": bodies,
        "rubbing": 1,
        "drop_height": 1,
        "tilt_rad": 1,
        "gain": 1,
    }
    ends = np.cumsum(list(counts.values())).tolist()
    sizes = [getattr(NUISANCE[level], name) for name, count in counts.items() for _ in range(count)]

    def column(name: str) -> FloatArray:
        return np.array([getattr(size, name) for size in sizes])

    return _Sources(
        parts={name: slice(end - counts[name], end) for name, end in zip(counts, ends, strict=True)},
        set_sd=column("set_sd"),
        memory=column("memory"),
        shot_sd=column("shot_sd"),
        wander_sd=column("wander_sd"),
        reseat_sd=column("reseat_sd"),
    )


@lru_cache(maxsize=256)
def _seat_of_set(
    level: str, seed: int, position: str, bodies: int, set_index: int, hour_h: float
) -> tuple[int, FloatArray]:
    """How many re-seats there were, and where every source stands about which the set's shots scatter."""
    parameters, sources = NUISANCE[level], _sources(level, bodies)
    size = sources.memory.size
    slow = wander(
        Purpose.SEATING_WANDER,
        seed,
        position,
        size,
        parameters.shortest_wander_h,
        parameters.longest_wander_h,
    )
    reseats, place = place_after_reseats(
        hour_h, parameters.reseats_per_1000_h / 1_000.0, seed=seed, position=position, size=size
    )
    moved = remembering(
        sources.memory, parameters.tail_dof, seed=seed, position=position, set_index=set_index
    )
    seat = _growth(parameters, hour_h) * sources.set_sd * moved
    seat = seat + sources.wander_sd * wandering(hour_h, slow) + sources.reseat_sd * place
    return reseats, seat


def _growth(parameters: NuisanceParameters, hour_h: float) -> float:
    return 1.0 + parameters.scatter_growth_per_1000_h * hour_h / 1_000.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShotNuisance:
    """How one strike differs from one without nuisance.

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
    knock, burst
        What else is heard.
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
    knock: Ringing | None
    burst: Ringing | None

    @property
    def rings(self) -> list[Ringing]:
        """What is heard."""
        return [ring for ring in (self.knock, self.burst) if ring is not None]

    def truth(self) -> dict[str, float]:
        """Columns stored with the record; ``temperature_c`` and those of the strike hold the rest."""
        found = {
            "nuisance_reseats": float(self.reseats),
            "nuisance_rogue": float(self.rogue),
            "nuisance_wear_radius_factor": self.wear_factor,
            "nuisance_drop_factor": self.drop_factor,
            "nuisance_gain_factor": self.gain_factor,
            "nuisance_noise_factor": self.noise_factor,
            "nuisance_tilt_rad": self.tilt_rad,
            "nuisance_plate_warmer_k": self.plate_warmer_k,
            "nuisance_plate_modulus_factor": self.plate_modulus_factor,
            "nuisance_knock_v": 0.0 if self.knock is None else self.knock.height_v,
            "nuisance_burst_v": 0.0 if self.burst is None else self.burst.height_v,
        }
        for contact, factor in enumerate(self.contacts.stiffness_factor.tolist()):
            found[f"nuisance_stiffness_factor_{contact}"] = factor
        for contact, factor in enumerate(self.contacts.damping_factor.tolist()):
            found[f"nuisance_damping_factor_{contact}"] = factor
        return found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TransducerNuisance:
    """Nuisance of one transducer.

    Attributes
    ----------
    curvature
        Shape (n_bodies, n_bodies): change of ln A of each contact by ln R of each bead.
    """

    level: str
    seed: int
    position: str
    climate: Climate
    curvature: FloatArray

    def at(self, key: ShotKey, hour_h: float, warmer_k: float) -> ShotNuisance:
        """Draw what disturbs a strike.

        Parameters
        ----------
        warmer_k
            Temperature of the transducer over the mean one without the climate.
        """
        parameters, bodies = NUISANCE[self.level], self.curvature.shape[0]
        sources = _sources(self.level, bodies)
        reseats, seat = _seat_of_set(self.level, self.seed, self.position, bodies, key.set_index, hour_h)
        random = generator(self.seed, Purpose.SEATING_OF_SHOT, key=key)
        drawn = unit_t(random, parameters.tail_dof, seat.size)
        # As many numbers for every shot, so that no nuisance moves the digits of another.
        even, normal = random.random(11), random.standard_normal(4)
        values = seat + _growth(parameters, hour_h) * sources.shot_sd * drawn
        of = {name: values[part] for name, part in sources.parts.items()}

        wear = math.log1p(parameters.wear_per_1000_h * hour_h / 1_000.0)
        log_stiffness = np.concatenate([of["contact_stiffness"], of["plate_stiffness"]])
        log_stiffness += self.curvature @ (of["bead_radius"] + wear)
        log_damping = np.concatenate([of["contact_damping"], of["plate_damping"]]) + of["rubbing"]
        log_drop = float(of["drop_height"][0]) - parameters.friction_per_1000_h * hour_h / 1_000.0
        rogue = bool(even[0] < parameters.rogue_probability)
        if rogue:
            contact = int(even[1] * bodies)
            log_stiffness[contact] += parameters.rogue_stiffness_sd * normal[0]
            log_damping[contact] += parameters.rogue_stiffness_sd * abs(normal[1])
            log_drop += math.log1p(-parameters.rogue_drop_loss * even[2])

        warmer_k += self.climate.room_k(hour_h)
        process_k = self.climate.process_k(hour_h)
        chain_k, plate_k = warmer_k + parameters.chain_share * process_k, warmer_k + process_k
        chain_modulus = 1.0 + parameters.modulus_change_per_k * chain_k
        plate_modulus = 1.0 + parameters.modulus_change_per_k * plate_k
        stiffness_factor = np.exp(_bounded("stiffness", log_stiffness))
        stiffness_factor[:-1] *= chain_modulus
        # Sphere and plate of alike steels: each gives half of their contact's compliance.
        stiffness_factor[-1] *= 2.0 / (1.0 / chain_modulus + 1.0 / plate_modulus)

        noisy_hour = noisy(self.seed, int(hour_h), parameters.noisy_hour_probability)
        knocked = even[3] < parameters.knock_probability
        hit = noisy_hour and even[7] < parameters.burst_probability
        decades = math.log10(1.0 + hour_h / parameters.hours_since_poling_h)
        return ShotNuisance(
            reseats=reseats,
            rogue=rogue,
            wear_factor=math.exp(wear),
            drop_factor=math.exp(log_drop + parameters.friction_per_k * chain_k),
            gain_factor=math.exp(
                float(_bounded("gain", of["gain"])[0]) - parameters.ageing_per_decade * decades
            ),
            noise_factor=parameters.noisy_factor if noisy_hour else 1.0,
            tilt_rad=float(of["tilt_rad"][0]),
            chain_warmer_k=chain_k,
            plate_warmer_k=plate_k,
            contacts=Contacts(
                stiffness_factor=stiffness_factor, damping_factor=np.exp(_bounded("damping", log_damping))
            ),
            plate_modulus_factor=plate_modulus,
            knock=_ring(parameters.knock_v * normal[2], KNOCK_HZ, KNOCK_DECAY_S, even[4:7])
            if knocked
            else None,
            burst=_ring(parameters.burst_v * normal[3], BURST_HZ, BURST_DECAY_S, even[8:11]) if hit else None,
        )


def _bounded(name: str, log_factor: FloatArray) -> FloatArray:
    return np.clip(log_factor, -FARTHEST_LOG[name], FARTHEST_LOG[name])


def transducer_nuisance(
    level: str, weather: Climate, *, seed: int, position: str, chain: ChainParameters
) -> TransducerNuisance:
    """Prepare the nuisance of one transducer."""
    curvature = _curvature(chain)
    return TransducerNuisance(level=level, seed=seed, position=position, climate=weather, curvature=curvature)


def _curvature(chain: ChainParameters) -> FloatArray:
    """``d ln A / d ln R_j = (1/2) (1/R_j) / (1/R_i + 1/R_j)``: A goes with the root of the joint radius."""
    bent = np.array([1.0 / chain.body(index).radius_m for index in range(chain.bodies)] + [0.0])
    change = np.zeros((chain.bodies, chain.bodies + 1))
    for contact in range(chain.bodies):
        pair = bent[contact : contact + 2]
        change[contact, contact : contact + 2] = 0.5 * pair / pair.sum()
    return change[:, :-1]


def _ring(
    height_v: float, range_hz: tuple[float, float], decay_s: tuple[float, float], even: FloatArray
) -> Ringing:
    """Frequency and decay are even in their logarithm."""
    return Ringing(
        start_s=RINGS_FROM_S + (RINGS_TO_S - RINGS_FROM_S) * float(even[0]),
        height_v=float(height_v),
        frequency_hz=range_hz[0] * (range_hz[1] / range_hz[0]) ** float(even[1]),
        decay_s=decay_s[0] * (decay_s[1] / decay_s[0]) ** float(even[2]),
    )


def disturbed_strike(
    strike: Strike, found: ShotNuisance, chain: ChainParameters, sensor: SensorParameters
) -> Strike:
    """Change height, tilt with its loss of gain, and gain."""
    # A disk tilted past upright leans to the other side, which for the wave is the same tilt.
    tilt_rad = min(abs(strike.tilt_rad + found.tilt_rad), STEEPEST_TILT_RAD)
    tilt_loss = math.exp(-sensor.tilt_loss_per_rad * (tilt_rad - strike.tilt_rad))
    lowest_m = LOWEST_DROP_FRACTION * chain.drop_height_m
    return replace(
        strike,
        drop_height_m=min(max(strike.drop_height_m * found.drop_factor, lowest_m), HIGHEST_DROP_M),
        tilt_rad=tilt_rad,
        sensor_gain_v_per_n=strike.sensor_gain_v_per_n * tilt_loss * found.gain_factor,
    )


def disturbed_noise(noise: NoiseParameters, factor: float) -> NoiseParameters:
    """Noise of an hour; what is off stays off."""
    if factor == 1.0:
        return noise
    return replace(noise, rms_v=noise.rms_v * factor, slow_rms_v=noise.slow_rms_v * factor)
