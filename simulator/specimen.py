"""Specimen of the twin: records as a pure function of the shot's key and the hour of the test.

`instruments` decides when something is struck and read; here it is computed. Nothing is remembered
between shots, so any shot can be computed at any time, ahead or again, with the same result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from hardware_drivers.instruments import Acquired, Echo
from hardware_drivers.measurement import Calibration, ShotKey, Waveform
from simulator.echo.far_wall import RoughSpot, draw_rough_spot
from simulator.echo.pulse import build_echo_calibration
from simulator.echo.records import Disturbance, ProbedWall, build_wall, draw_disturbance, simulate_record
from simulator.electronics.transduction import make_adc_calibration, quantise_volts, simulate_triggered_record
from simulator.errors import SpecimenError
from simulator.experiment.corrosion import Wall, WallHistory, draw_wall_history, round_down_hour_h
from simulator.experiment.environmental_variability import (
    ShotNuisance,
    TransducerNuisance,
    disturb_strike,
    scale_noise,
)
from simulator.experiment.faults import (
    NO_FAULTS,
    SOUND,
    ShotFaults,
    apply_chain_faults,
    apply_strike_faults,
    draw_faults_of_shot,
    draw_interference,
)
from simulator.experiment.scatter import Strike, Temperature, draw_room_temperature, draw_scattered_strike
from simulator.experiment.seating import Climate, draw_climate, list_liquid_factors
from simulator.numerics.arrays import FloatArray
from simulator.numerics.keyed_random import Purpose, keyed_generator
from simulator.parameters.chain import ChainParameters
from simulator.parameters.experiment import ThinningParameters, TwinParameters
from simulator.shot.model import Impact, ShotForce, ShotModel
from simulator.shot.pulse_summary import summarise_pulses

Stray = Callable[[float, float, int], FloatArray]
"""Voltage that no strike made: of the first sample's time from the striker's contact in s, the rate, the
number of samples."""


class SolitaryWaveModel(Protocol):
    """Physics of one transducer on its plate (`simulator.shot.model.ShotModel`)."""

    def shot(
        self, *, depth_fraction: float, drop_height_m: float, tilt_rad: float, through_hole: bool
    ) -> ShotForce:
        """Simulate the force at the sensor after a strike on a thinned wall, or above a hole."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Transducer:
    """Solitary-wave transducer: its nominal chain and its physics."""

    chain: ChainParameters
    model: SolitaryWaveModel


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _DrawnStrike:
    """Strike as drawn, for the chain."""

    key: ShotKey
    hour_h: float
    wall: Wall
    faults: ShotFaults
    nuisance: ShotNuisance | None
    strike: Strike

    def impact(self) -> Impact:
        """Return the striker's first impact as input of the shot model; a second one is left out."""
        found = self.nuisance
        return Impact(
            depth_fraction=self.wall.patch_depth_fraction,
            drop_height_m=self.strike.drop_height_m,
            tilt_rad=self.strike.tilt_rad,
            through_hole=self.wall.is_hole,
            contacts=None if found is None else found.contacts,
            plate_modulus_factor=1.0 if found is None else found.plate_modulus_factor,
        )

    def impacts(self) -> Impact:
        """Return the impact with the striker's second touch, if it bounced, as input of the shot model."""
        return replace(
            self.impact(),
            second_delay_s=self.faults.double_delay_s,
            second_drop_height_m=self.strike.drop_height_m * self.faults.double_height_fraction,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Specimen:
    """Specimen of plate, transducers, probes and room.

    Attributes
    ----------
    transducers
        By position: the solitary-wave transducers.
    probed_thickness_m
        By position: pristine thickness under each ultrasonic probe.
    walls
        By position: thinning of every position above.
    spots
        By position: the far wall as each ultrasonic probe sees it, None where it stays smooth.
    climate, nuisances
        Of the level of nuisance: None and empty where there is none; one a transducer.
    wet
        By position of a wet plate and by the liquid's depth over the full one: the transducer there.
    stray
        Added at the digitizer's input, which the trigger sees too.
    """

    twin: TwinParameters
    transducers: Mapping[str, Transducer]
    probed_thickness_m: Mapping[str, float]
    walls: Mapping[str, WallHistory]
    spots: Mapping[str, RoughSpot | None]
    room: Temperature
    adc_calibration: Calibration
    echo_calibration: Calibration
    climate: Climate | None
    nuisances: Mapping[str, TransducerNuisance]
    wet: Mapping[str, Mapping[float, Transducer]]
    stray: Stray | None = None

    def hour_h(self, elapsed_ns: int) -> float:
        """Return the hour of the test whose depth and temperature apply at an elapsed time.

        It advances in steps of `TwinParameters.update_interval_s`.
        """
        return round_down_hour_h(elapsed_ns, self.twin.update_interval_s)

    def faults(self, key: ShotKey, hour_h: float) -> ShotFaults:
        """Draw the faults of one strike, its chain and its gain; hum and spikes are drawn with the record."""
        faults = self.twin.faults.get(key.position)
        if faults is None:
            return NO_FAULTS
        return draw_faults_of_shot(faults, seed=self.twin.seed, key=key, hour_h=hour_h)

    def nuisance(self, key: ShotKey, hour_h: float, faults: ShotFaults) -> ShotNuisance | None:
        """Draw the environmental variability of a strike; None if it is not enabled."""
        found = self.nuisances.get(key.position)
        if found is None:
            return None
        return found.at(
            key, hour_h, self.room.at(hour_h) - self.room.drift.mean_temperature_c + faults.temperature_k
        )

    def strike(self, key: ShotKey, hour_h: float) -> Strike:
        """Draw drop height, tilt and sensitivity of one shot, with scatter, variability and faults.

        The result depends only on the twin, key and hour. Raise KeyError for a position without a transducer.
        """
        faults = self.faults(key, hour_h)
        return self._draw_complete_strike(key, hour_h, faults, self.nuisance(key, hour_h, faults))

    def _draw_complete_strike(
        self, key: ShotKey, hour_h: float, faults: ShotFaults, found: ShotNuisance | None
    ) -> Strike:
        """Draw a shot's strike with scatter, the given variability (or None) and the given faults.

        The result depends only on the twin, key, hour and these. Raise KeyError for a position without a
        transducer.
        """
        chain, sensor = self.transducers[key.position].chain, self.twin.sensor
        strike = draw_scattered_strike(
            key,
            seed=self.twin.seed,
            chain=chain,
            scatter=self.twin.scatter,
            drift=self.twin.drift,
            sensor=sensor,
            temperature_c=self._temperature_c(hour_h, faults, found),
        )
        if found is not None:
            strike = disturb_strike(strike, found, chain, sensor)
        return strike if faults is NO_FAULTS else apply_strike_faults(strike, faults, sensor)

    def _temperature_c(self, hour_h: float, faults: ShotFaults, found: ShotNuisance | None) -> float:
        """Return the temperature of a transducer's chain at an hour in degrees Celsius, faults included."""
        if found is None:
            return self.room.at(hour_h) + faults.temperature_k
        return self.room.drift.mean_temperature_c + found.chain_warmer_k

    def force(self, wall: Wall, strike: Strike, position: str, faults: ShotFaults = NO_FAULTS) -> ShotForce:
        """Simulate the force at the sensor for one impact; above a through hole nothing is reflected.

        A second impact and variability are not included. Raise SpecimenError if a fault changes the chain of
        a model that is no ShotModel, and errors of `ShotModel.shot`.
        """
        model = _select_shot_model(self.transducers[position], faults)
        return model.shot(
            depth_fraction=wall.patch_depth_fraction,
            drop_height_m=strike.drop_height_m,
            tilt_rad=strike.tilt_rad,
            through_hole=wall.is_hole,
        )

    def simulate_wave(self, key: ShotKey, hour_h: float) -> Acquired | None:
        """Simulate the record of one strike; None if it is missed or does not reach the trigger level.

        Raise errors as `simulate_waves`.
        """
        (acquired,) = self.simulate_waves([(key, hour_h)])
        return acquired

    def simulate_waves(self, strikes: Sequence[tuple[ShotKey, float]]) -> list[Acquired | None]:
        """Simulate the records of strikes at their hours, bit-identical to those of `simulate_wave`.

        Strikes of one transducer on a wall of one depth cost half as much together as one after the other.
        Raise SimulatorError or ValueError if a shot cannot be computed.
        """
        blows = [self._draw_strike_and_wall(key, hour_h) for key, hour_h in strikes]
        forces = self._compute_forces([blow for blow in blows if blow is not None])
        return [None if blow is None else self._digitize_force(blow, *next(forces)) for blow in blows]

    def _draw_strike_and_wall(self, key: ShotKey, hour_h: float) -> _DrawnStrike | None:
        """Draw a strike with its wall, faults and variability; None if the strike is missed."""
        faults = self.faults(key, hour_h)
        if faults.missed:
            return None
        found = self.nuisance(key, hour_h, faults)
        return _DrawnStrike(
            key=key,
            hour_h=hour_h,
            wall=self.walls[key.position].at(hour_h),
            faults=faults,
            nuisance=found,
            strike=self._draw_complete_strike(key, hour_h, faults, found),
        )

    def _compute_forces(self, blows: Sequence[_DrawnStrike]) -> Iterator[tuple[ShotForce, ShotForce]]:
        """Compute all forces; return an iterator over pairs: force of the first impact, force of all impacts.

        Pairs have the order of ``blows``. Raise errors as `simulate_waves`.
        """
        alike: dict[tuple[str, float, float, float], list[int]] = {}
        for number, blow in enumerate(blows):
            faults, liquid = blow.faults, 1.0 if blow.nuisance is None else blow.nuisance.liquid_factor
            chain = blow.key.position, liquid, faults.radius_factor, faults.contact_damping_factor
            alike.setdefault(chain, []).append(number)
        forces: dict[int, tuple[ShotForce, ShotForce]] = {}
        for (position, liquid, *_), numbers in alike.items():
            of_chain = [blows[number] for number in numbers]
            transducer = self.wet.get(position, {}).get(liquid, self.transducers[position])
            model = _select_shot_model(transducer, of_chain[0].faults)
            if isinstance(model, ShotModel):
                found = _simulate_strikes(model, of_chain)
            else:
                found = [self._simulate_force(model, blow) for blow in of_chain]
            forces.update(zip(numbers, found, strict=True))
        return (forces[number] for number in range(len(blows)))

    def _simulate_force(self, model: SolitaryWaveModel, blow: _DrawnStrike) -> tuple[ShotForce, ShotForce]:
        """Simulate the force of one shot of a model that computes shots singly; return the same force twice.

        Raise SpecimenError for a second impact or variability, which such a model does not have.
        """
        if blow.faults.double_delay_s is not None:
            raise SpecimenError(
                f"double is a second impact on the chain of a ShotModel; this one is a "
                f"{type(model).__name__}: take it out of the faults"
            )
        if blow.nuisance is not None:
            raise SpecimenError(
                f"nuisance re-seats the chain of a ShotModel; this one is a {type(model).__name__}: set "
                "nuisance to 'none'"
            )
        force = self.force(blow.wall, blow.strike, blow.key.position, blow.faults)
        return force, force

    def _digitize_force(
        self, blow: _DrawnStrike, force: ShotForce, every_impact: ShotForce
    ) -> Acquired | None:
        """Digitize the force of all impacts; return record and true values, None without a trigger.

        The true values are those of the first impact, ``force``. Raise ValueError if the force ends before
        the record, NoSolitaryWaveError if it holds no incident wave.
        """
        seed, adc, key, hour_h = self.twin.seed, self.twin.adc, blow.key, blow.hour_h
        interference, electrical_truth = draw_interference(
            self.twin.faults.get(key.position, SOUND), seed=seed, key=key, hour_h=hour_h, adc=adc
        )
        noise, found = self.twin.noise, blow.nuisance
        if found is not None:
            noise = scale_noise(noise, found.noise_factor)
        record = simulate_triggered_record(
            force_step_s=float(force.time_s[-1]) / (force.time_s.size - 1),
            dynamic_force_n=every_impact.force_n - every_impact.preload_n,
            sensor_gain_v_per_n=blow.strike.sensor_gain_v_per_n,
            adc=adc,
            calibration=self.adc_calibration,
            # The sample clock runs free: where it stands when the wave comes is anybody's guess.
            sampling_phase=float(keyed_generator(seed, Purpose.SAMPLING_PHASE, key=key).random()),
            noise=noise,
            random=keyed_generator(seed, Purpose.NOISE, key=key),
            interference=interference,
            stray=self._combine_stray_volts(blow.nuisance),
        )
        if record is None:
            return None
        waveform = Waveform(
            counts=record.counts,
            sample_rate_hz=adc.sample_rate_hz,
            pretrigger_samples=adc.pretrigger_samples,
            calibration=self.adc_calibration,
        )
        truth = _collect_true_values(blow.wall, blow.strike, force)
        temperature_c = self._temperature_c(hour_h, blow.faults, found)
        truth |= {"temperature_c": temperature_c, "trigger_time_s": record.trigger_time_s}
        truth |= blow.faults.truth | electrical_truth
        return Acquired(waveform=waveform, truth=truth if found is None else truth | found.truth())

    def _combine_stray_volts(self, found: ShotNuisance | None) -> Stray | None:
        """Return a function of all voltages that no strike causes, ringing included; None without any."""
        if found is None or not found.rings:
            return self.stray
        strays: list[Stray] = [ring.volts for ring in found.rings]
        if self.stray is not None:
            strays.append(self.stray)
        return lambda first_s, rate_hz, n: np.sum([one(first_s, rate_hz, n) for one in strays], axis=0)

    def _plate_temperature_c(self, hour_h: float) -> float:
        """Return the temperature of the plate at an hour in degrees Celsius; the room's without a climate."""
        if self.climate is None:
            return self.room.at(hour_h)
        return self.room.at(hour_h) + self.climate.room_k(hour_h) + self.climate.process_k(hour_h)

    def probed_wall(self, position: str, hour_h: float) -> ProbedWall:
        """Return the wall under the ultrasonic probe of a position at an hour of the test.

        Raise KeyError for a position without a probe.
        """
        return build_wall(
            self.probed_thickness_m[position],
            self.walls[position].at(hour_h).depth_fraction,
            self.spots[position],
            self._plate_temperature_c(hour_h) - self.twin.drift.mean_temperature_c,
        )

    def echo(self, key: ShotKey, hour_h: float) -> Echo:
        """Simulate the averaged pulse-echo record of one position, with its true values.

        Noise, couplant and bubbles are drawn from the seed; there are none if noise is disabled. Raise
        KeyError for a position without a probe.
        """
        echo, seed, noisy = self.twin.echo, self.twin.seed, self.twin.noise.enabled
        wall = self.probed_wall(key.position, hour_h)
        found, disturbed = draw_disturbance(echo, seed=seed, key=key) if noisy else (Disturbance(), {})
        volts, clipped = simulate_record(
            wall, echo, self.echo_calibration, found, seed=seed, key=key, noisy=noisy
        )
        waveform = Waveform(
            counts=quantise_volts(volts, self.echo_calibration),
            sample_rate_hz=echo.sample_rate_hz,
            pretrigger_samples=0,
            calibration=self.echo_calibration,
        )
        return Echo(
            waveform=waveform,
            truth=wall.truth(echo) | {"temperature_c": self._plate_temperature_c(hour_h)} | disturbed,
            gain_db=echo.gain_db,
            averages=echo.averages,
            settings={"clipped_records": float(clipped)},
        )


def _select_shot_model(transducer: Transducer, faults: ShotFaults) -> SolitaryWaveModel:
    """Return the model of a transducer, with a changed chain if a fault changed its contacts.

    Raise SpecimenError if the model cannot change its chain.
    """
    if faults.radius_factor == 1.0 and faults.contact_damping_factor == 1.0:
        return transducer.model
    if not isinstance(transducer.model, ShotModel):
        raise SpecimenError(
            f"bead_wear and loose_contact change the chain of a ShotModel; this one is a "
            f"{type(transducer.model).__name__}: take the two out of the faults"
        )
    return transducer.model.with_chain(apply_chain_faults(transducer.chain, faults))


def _simulate_strikes(model: ShotModel, blows: Sequence[_DrawnStrike]) -> list[tuple[ShotForce, ShotForce]]:
    """Simulate strikes on one chain side by side; return each one's first impact and complete force.

    Both are the same force without a second impact. Raise errors as `ShotModel.shots`.
    """
    bounced = [blow for blow in blows if blow.faults.double_delay_s is not None]
    found = iter(model.shots([*(blow.impact() for blow in blows), *(blow.impacts() for blow in bounced)]))
    first = [next(found) for _ in blows]
    return [
        (force, force if blow.faults.double_delay_s is None else next(found))
        for blow, force in zip(blows, first, strict=True)
    ]


def _collect_true_values(wall: Wall, strike: Strike, force: ShotForce) -> dict[str, float]:
    """Return the true values of a shot, by column name; NaN for a wave that is missing.

    The values of its force are those of ``solimon simulate``. Raise NoSolitaryWaveError without an incident
    wave.
    """
    pulses = summarise_pulses(force)
    return {
        "depth_fraction": wall.depth_fraction,
        "pit_depth_fraction": wall.pit_depth_fraction,
        "drop_height_m": strike.drop_height_m,
        "tilt_rad": strike.tilt_rad,
        "sensor_gain_v_per_n": strike.sensor_gain_v_per_n,
        "isw_peak_n": pulses.isw_peak_n,
        "isw_time_s": _to_si_or_nan(pulses.isw_time_us, 1e-6),
        "psw_peak_n": _to_si_or_nan(pulses.psw_peak_n),
        "psw_time_s": _to_si_or_nan(pulses.psw_time_us, 1e-6),
        "tof_s": _to_si_or_nan(pulses.tof_us, 1e-6),
        "amplitude_ratio": _to_si_or_nan(pulses.amplitude_ratio),
        "dynamic_amplitude_ratio": _to_si_or_nan(pulses.dynamic_amplitude_ratio),
        "energy_residual": force.energy_residual,
    }


def _to_si_or_nan(value: float | None, unit: float = 1.0) -> float:
    """Multiply a value by the unit's size in SI; NaN if it is None because no wave was reflected."""
    return math.nan if value is None else unit * value


def build_specimen(
    twin: TwinParameters, *, transducers: Mapping[str, Transducer], probed_thickness_m: Mapping[str, float]
) -> Specimen:
    """Draw the constants of a test (corrosion, far walls, climate) and build the specimen.

    With variability, the plate is prepared for each depth of its liquid. Raise SpecimenError if the mean
    depth at the hour of a hole leaves no room for the pits.
    """
    walls = {
        position: draw_wall_history(
            twin.thinning.get(position, ThinningParameters()), seed=twin.seed, position=position
        )
        for position in (*transducers, *probed_thickness_m)
    }
    weather = None
    nuisances: dict[str, TransducerNuisance] = {}
    wet: dict[str, dict[float, Transducer]] = {}
    if twin.nuisance != "none":
        weather = draw_climate(twin.nuisance, seed=twin.seed, warmest_hour_h=twin.drift.warmest_hour_h)
        for name, place in transducers.items():
            nuisances[name] = TransducerNuisance(
                level=twin.nuisance, seed=twin.seed, chain=place.chain, climate=weather
            )
            wet[name] = _build_wet_transducers(place, list_liquid_factors(weather.parameters))
    return Specimen(
        twin=twin,
        transducers=dict(transducers),
        probed_thickness_m=dict(probed_thickness_m),
        walls=walls,
        spots={
            name: draw_rough_spot(twin.echo, seed=twin.seed, position=name) for name in probed_thickness_m
        },
        room=draw_room_temperature(twin.drift, seed=twin.seed),
        adc_calibration=make_adc_calibration(twin.adc),
        echo_calibration=build_echo_calibration(twin.echo),
        climate=weather,
        nuisances=nuisances,
        wet=wet,
    )


def _build_wet_transducers(place: Transducer, factors: Sequence[float]) -> dict[float, Transducer]:
    """Return the transducer for each depth of the liquid over the full depth; empty for a dry plate."""
    if not isinstance(place.model, ShotModel):
        return {}
    models = {factor: place.model if factor == 1.0 else place.model.with_liquid(factor) for factor in factors}
    return {factor: replace(place, model=model) for factor, model in models.items() if model is not None}
