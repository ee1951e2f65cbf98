"""Values of the sources of variability that all shots of a set share.

Memory, wander, re-seats and age of each contact and bead (`processes`), and the temperatures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hardware_drivers.measurement import SetKey
from simulator.experiment.faults import HOURS_PER_YEAR
from simulator.experiment.processes import (
    compute_ar1_weights,
    draw_autocorrelated_values,
    draw_slow_drift,
    draw_values_after_reseats,
    evaluate_slow_drift,
    is_noisy_hour,
)
from simulator.numerics.arrays import FloatArray
from simulator.numerics.keyed_random import Purpose, keyed_generator
from simulator.parameters.chain import ChainParameters
from simulator.parameters.environmental_variability import NUISANCE, NuisanceParameters

LIQUID_LEVELS = 4
"""The level falls in so many steps: the plate is reduced once for each."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Climate:
    """Environment of all positions: temperature on top of `scatter.Temperature`, and the liquid."""

    parameters: NuisanceParameters
    warmest_hour_h: float
    season_rad: float
    process: tuple[FloatArray, FloatArray]
    refilled: float

    def room_k(self, hour_h: float) -> float:
        """Return the change of the room's temperature by day and season at an hour, in K."""
        day = math.cos(2.0 * math.pi * (hour_h - self.warmest_hour_h) / 24.0)
        season = math.cos(2.0 * math.pi * hour_h / HOURS_PER_YEAR - self.season_rad)
        return self.parameters.day_amplitude_k * day + self.parameters.season_amplitude_k * season

    def process_k(self, hour_h: float) -> float:
        """Return the temperature of the plate relative to the room at an hour, in K; drawn once per test."""
        return self.parameters.process_sd_k * float(evaluate_slow_drift(hour_h, self.process)[0])

    def liquid_factor(self, hour_h: float) -> float:
        """Return the depth of the liquid at an hour, as a fraction of the full depth.

        It falls through four values between two refills.
        """
        part = (hour_h / self.parameters.refill_h + self.refilled) % 1.0
        return list_liquid_factors(self.parameters)[int(LIQUID_LEVELS * part)]


def list_liquid_factors(parameters: NuisanceParameters) -> tuple[float, ...]:
    """List the four depths that the liquid can have, as fractions of the full depth, falling."""
    steps = [level / (LIQUID_LEVELS - 1) for level in range(LIQUID_LEVELS)]
    return tuple(1.0 - parameters.liquid_loss_fraction * step for step in steps)


def draw_climate(level: str, *, seed: int, warmest_hour_h: float) -> Climate:
    """Draw season, process temperature and refill times of a test from the seed.

    ``level`` is a key of `NUISANCE`, ``warmest_hour_h`` the hour of the day's highest temperature.
    """
    parameters = NUISANCE[level]
    return Climate(
        parameters=parameters,
        warmest_hour_h=warmest_hour_h,
        season_rad=float(keyed_generator(seed, Purpose.SEASON).uniform(0.0, 2.0 * math.pi)),
        process=draw_slow_drift(
            Purpose.PROCESS, seed, "", 1, parameters.shortest_process_h, parameters.longest_process_h
        ),
        refilled=float(keyed_generator(seed, Purpose.REFILLS).random()),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sources:
    """Sources of a level at a chain of n bodies, one number for each contact, sphere or transducer.

    Attributes
    ----------
    set_sd, shot_sd, wander_sd, reseat_sd
        Shape (n_sources,).
    memory
        `processes.compute_ar1_weights` of the sources.
    effect
        Shape (2 n + 3, n_sources): what they add to ln A and ln gamma of the contacts below each body, to ln
        drop height, ln gain and tilt.
    flattening
        Shape (n,): change of ln A by the ln R of all beads alike.
    """

    set_sd: FloatArray
    memory: FloatArray
    shot_sd: FloatArray
    wander_sd: FloatArray
    reseat_sd: FloatArray
    effect: FloatArray
    flattening: FloatArray


@lru_cache(maxsize=64)
def compute_source_effects(level: str, chain: ChainParameters) -> Sources:
    """Return sizes and effects of all sources of variability on a chain.

    ``level`` is a key of `NUISANCE`. Cached: the arrays must not be written.
    """
    n = chain.bodies
    of_stiffness, of_damping, last = np.eye(n), np.zeros((n, n)), np.eye(2 * n + 3)[:, 2 * n :]
    curvature = _contact_radius_exponent(chain)
    effects = {
        "contact_stiffness": np.vstack([of_stiffness, of_damping])[:, :-1],
        "plate_stiffness": np.vstack([of_stiffness, of_damping])[:, -1:],
        "contact_damping": np.vstack([of_damping, of_stiffness])[:, :-1],
        "plate_damping": np.vstack([of_damping, of_stiffness])[:, -1:],
        "bead_radius": np.vstack([curvature, of_damping]),
        "rubbing": np.vstack([np.zeros((n, 1)), np.ones((n, 1))]),
        "drop_height": last[:, :1],
        "gain": last[:, 1:2],
        "tilt_rad": last[:, 2:],
    }
    whole = [np.vstack([part, np.zeros((2 * n + 3 - len(part), part.shape[1]))]) for part in effects.values()]
    sizes = [getattr(NUISANCE[level], name) for name, part in effects.items() for _ in range(part.shape[1])]

    def get_column(name: str) -> FloatArray:
        """Return one field of all sources' sizes as an array."""
        return np.array([getattr(size, name) for size in sizes])

    return Sources(
        set_sd=get_column("set_sd"),
        memory=compute_ar1_weights(get_column("memory")),
        shot_sd=get_column("shot_sd"),
        wander_sd=get_column("wander_sd"),
        reseat_sd=get_column("reseat_sd"),
        effect=np.hstack(whole),
        flattening=curvature.sum(axis=1),
    )


def _contact_radius_exponent(chain: ChainParameters) -> FloatArray:
    """Compute d ln A / d ln R of each contact's stiffness for each body's radius, shape (n, n).

    A is proportional to the root of the joint radius of curvature.
    """
    bent = np.array([1.0 / chain.body(index).radius_m for index in range(chain.bodies)] + [0.0])
    change = np.zeros((chain.bodies, chain.bodies + 1))
    for contact in range(chain.bodies):
        pair = bent[contact : contact + 2]
        change[contact, contact : contact + 2] = 0.5 * pair / pair.sum()
    return change[:, :-1]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seat:
    """Values that the shots of one set share.

    Attributes
    ----------
    place
        Shape (2 n + 3,): rows as of `Sources.effect`, with wear, friction, ageing and temperature.
    shot_effect
        Shape (2 n + 3, n_sources): `Sources.effect` times the SDs of a shot at this hour.
    """

    reseats: int
    place: FloatArray
    shot_effect: FloatArray
    wear_factor: float
    chain_warmer_k: float
    plate_warmer_k: float
    plate_modulus_factor: float
    liquid_factor: float
    noisy: bool


def draw_seat_of_set(
    level: str,
    seed: int,
    position: str,
    chain: ChainParameters,
    weather: Climate,
    *,
    set_key: SetKey,
    hour_h: float,
    warmer_k: float,
) -> Seat:
    """Draw the state of a transducer that all shots of a set share: seat, wear, temperatures, liquid.

    Parameters
    ----------
    level, weather
        Key of `NUISANCE`, and the climate of the test.
    warmer_k
        Temperature of the transducer over the mean one without the climate, K.
    """
    parameters, sources = NUISANCE[level], compute_source_effects(level, chain)
    size, n = sources.set_sd.size, chain.bodies
    slow = draw_slow_drift(
        Purpose.SEATING_WANDER,
        seed,
        position,
        size,
        parameters.shortest_wander_h,
        parameters.longest_wander_h,
    )
    reseats, place = draw_values_after_reseats(
        hour_h, parameters.reseats_per_1000_h / 1_000.0, seed=seed, position=position, size=size
    )
    moved = draw_autocorrelated_values(
        sources.memory, parameters.tail_dof, seed=seed, position=position, set_key=set_key
    )
    thousands = hour_h / 1_000.0
    growth = 1.0 + parameters.scatter_growth_per_1000_h * thousands
    stands = growth * sources.set_sd * moved
    stands = stands + sources.wander_sd * evaluate_slow_drift(hour_h, slow) + sources.reseat_sd * place
    logs = (sources.effect * stands).sum(axis=1)  # BLAS would round as the machine likes

    wear = math.log1p(parameters.wear_per_1000_h * thousands)
    warmer_k += weather.room_k(hour_h)
    process_k = weather.process_k(hour_h)
    chain_k, plate_k = warmer_k + parameters.chain_share * process_k, warmer_k + process_k
    chain_modulus = 1.0 + parameters.modulus_change_per_k * chain_k
    plate_modulus = 1.0 + parameters.modulus_change_per_k * plate_k
    logs[:n] += sources.flattening * wear
    logs[: n - 1] += math.log(chain_modulus)
    # Sphere and plate of alike steels: each gives half of their contact's compliance.
    logs[n - 1] -= math.log(0.5 * (1.0 / chain_modulus + 1.0 / plate_modulus))
    logs[2 * n] += parameters.friction_per_k * chain_k - parameters.friction_per_1000_h * thousands
    logs[2 * n + 1] -= parameters.ageing_per_decade * math.log10(
        1.0 + hour_h / parameters.hours_since_poling_h
    )
    return Seat(
        reseats=reseats,
        place=logs,
        shot_effect=sources.effect * (growth * sources.shot_sd),
        wear_factor=math.exp(wear),
        chain_warmer_k=chain_k,
        plate_warmer_k=plate_k,
        plate_modulus_factor=plate_modulus,
        liquid_factor=weather.liquid_factor(hour_h),
        noisy=is_noisy_hour(seed, int(hour_h), parameters.noisy_hour_probability),
    )
