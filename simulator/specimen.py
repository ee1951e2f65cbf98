"""What the twin would measure: a pure function of the shot's key and the hour of the experiment.

`instruments` decides when something is struck and read; here it is computed. Nothing is remembered
between shots, so any shot can be computed at any time, ahead or again, with the same result.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hardware_drivers.instruments import Acquired, Echo
from hardware_drivers.measurement import Calibration, ShotKey, Waveform
from simulator.corrosion import Wall, WallHistory, held_hour_h, wall_history
from simulator.coupled_model import ShotForce
from simulator.keyed_random import Purpose, generator
from simulator.parameters import ChainParameters
from simulator.pulse_summary import summarise
from simulator.scatter import Strike, Temperature, scattered_strike, temperature
from simulator.scenario import ThinningParameters, TwinParameters
from simulator.transduction import adc_calibration, counts_of, triggered_record
from simulator.ultrasonic_echo import echo_calibration, echo_volts, travel_time_s


class SolitaryWaveModel(Protocol):
    """Physics of one transducer on its plate (`simulator.coupled_model.ShotModel`)."""

    def shot(self, *, depth_fraction: float, drop_height_m: float, tilt_rad: float) -> ShotForce:
        """Force at the sensor after a strike on a wall of this depth."""
        ...

    def shot_at_hole(self, *, drop_height_m: float, tilt_rad: float) -> ShotForce:
        """Force at the sensor when nothing holds the chain's end."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Transducer:
    """One solitary-wave transducer: its nominal chain and its physics."""

    chain: ChainParameters
    model: SolitaryWaveModel


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Specimen:
    """Plate, transducers, probes and room.

    Attributes
    ----------
    transducers
        By position: the solitary-wave transducers.
    probed_thickness_m
        By position: pristine thickness under each ultrasonic probe.
    walls
        By position: thinning of every position above.
    """

    twin: TwinParameters
    transducers: Mapping[str, Transducer]
    probed_thickness_m: Mapping[str, float]
    walls: Mapping[str, WallHistory]
    room: Temperature
    adc_calibration: Calibration
    echo_calibration: Calibration

    def hour_h(self, elapsed_ns: int) -> float:
        """Hour whose depth and temperature hold now (`TwinParameters.update_interval_s`)."""
        return held_hour_h(elapsed_ns, self.twin.update_interval_s)

    def strike(self, key: ShotKey, hour_h: float) -> Strike:
        """Drop height, tilt and sensitivity of one shot."""
        return scattered_strike(
            key,
            seed=self.twin.seed,
            chain=self.transducers[key.position].chain,
            scatter=self.twin.scatter,
            drift=self.twin.drift,
            sensor=self.twin.sensor,
            temperature_c=self.room.at(hour_h),
        )

    def force(self, wall: Wall, strike: Strike, position: str) -> ShotForce:
        """Physics of one shot at its own depth, drop height and tilt."""
        model = self.transducers[position].model
        if wall.is_hole:
            return model.shot_at_hole(drop_height_m=strike.drop_height_m, tilt_rad=strike.tilt_rad)
        return model.shot(
            depth_fraction=wall.depth_fraction, drop_height_m=strike.drop_height_m, tilt_rad=strike.tilt_rad
        )

    def solitary_wave(self, key: ShotKey, hour_h: float) -> Acquired | None:
        """Record of one strike, or None if it does not reach the trigger level."""
        seed, adc = self.twin.seed, self.twin.adc
        wall = self.walls[key.position].at(hour_h)
        strike = self.strike(key, hour_h)
        force = self.force(wall, strike, key.position)
        record = triggered_record(
            # The grid's step, which may be several steps of the integration.
            force_step_s=float(force.time_s[-1]) / (force.time_s.size - 1),
            dynamic_force_n=force.force_n - force.preload_n,
            sensor_gain_v_per_n=strike.sensor_gain_v_per_n,
            adc=adc,
            calibration=self.adc_calibration,
            # The sample clock runs free: where it stands when the wave comes is anybody's guess.
            sampling_phase=float(generator(seed, Purpose.SAMPLING_PHASE, key=key).random()),
            noise=self.twin.noise,
            random=generator(seed, Purpose.NOISE, key=key),
        )
        if record is None:
            return None
        waveform = Waveform(
            counts=record.counts,
            sample_rate_hz=adc.sample_rate_hz,
            pretrigger_samples=adc.pretrigger_samples,
            calibration=self.adc_calibration,
        )
        truth = _shot_truth(wall, strike, force)
        truth |= {"temperature_c": self.room.at(hour_h), "trigger_time_s": record.trigger_time_s}
        return Acquired(waveform=waveform, truth=truth)

    def echo(self, key: ShotKey, hour_h: float) -> Echo:
        """Averaged pulse-echo record of one position."""
        echo = self.twin.echo
        wall = self.walls[key.position].at(hour_h)
        thickness_m = self.probed_thickness_m[key.position] * (1.0 - wall.depth_fraction)
        volts = echo_volts(thickness_m, echo)
        if self.twin.noise.enabled:
            random = generator(self.twin.seed, Purpose.ECHO_NOISE, key=key)
            # The mean of n records of white noise scatters by 1 / sqrt(n) of one record.
            volts += echo.noise_rms_v / np.sqrt(echo.averages) * random.standard_normal(volts.size)
        waveform = Waveform(
            counts=counts_of(volts, self.echo_calibration),
            sample_rate_hz=echo.sample_rate_hz,
            pretrigger_samples=0,
            calibration=self.echo_calibration,
        )
        truth = {
            "thickness_m": thickness_m,
            "travel_time_s": travel_time_s(thickness_m, echo),
            "temperature_c": self.room.at(hour_h),
        }
        return Echo(waveform=waveform, truth=truth, gain_db=echo.gain_db, averages=echo.averages)


def _shot_truth(wall: Wall, strike: Strike, force: ShotForce) -> dict[str, float]:
    """Collect what the twin knows of a shot; the force's numbers are those of ``solimon simulate``."""
    pulses = summarise(force)
    return {
        "depth_fraction": wall.depth_fraction,
        "pit_depth_fraction": wall.pit_depth_fraction,
        "drop_height_m": strike.drop_height_m,
        "tilt_rad": strike.tilt_rad,
        "sensor_gain_v_per_n": strike.sensor_gain_v_per_n,
        "isw_peak_n": pulses.isw_peak_n,
        "isw_time_s": _si(pulses.isw_time_us, 1e-6),
        "psw_peak_n": _si(pulses.psw_peak_n),
        "psw_time_s": _si(pulses.psw_time_us, 1e-6),
        "tof_s": _si(pulses.tof_us, 1e-6),
        "amplitude_ratio": _si(pulses.amplitude_ratio),
        "energy_residual": force.energy_residual,
    }


def _si(value: float | None, unit: float = 1.0) -> float:
    """Return the value in SI, NaN where nothing came back."""
    return math.nan if value is None else unit * value


def build_specimen(
    twin: TwinParameters, *, transducers: Mapping[str, Transducer], probed_thickness_m: Mapping[str, float]
) -> Specimen:
    """Draw what is drawn once an experiment (thinning, weather) and put the specimen together."""
    walls = {
        position: wall_history(
            twin.thinning.get(position, ThinningParameters()), seed=twin.seed, position=position
        )
        for position in (*transducers, *probed_thickness_m)
    }
    return Specimen(
        twin=twin,
        transducers=dict(transducers),
        probed_thickness_m=dict(probed_thickness_m),
        walls=walls,
        room=temperature(twin.drift, seed=twin.seed),
        adc_calibration=adc_calibration(twin.adc),
        echo_calibration=echo_calibration(twin.echo),
    )
