"""Seeded faults of the rig for one shot, a pure function of seed, key and hour.

`parameters.faults` says which faults a position has; here they are drawn, and strike and chain altered.
The altered shot takes the same way as a sound one: through the physics, the trigger and the ADC. Each
active fault leaves its truth with every record of its position, also where it did not act, so that
detectors can be assessed. A missed strike leaves no record: `draw_faults_of_shot` shows it again from the
seed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from hardware_drivers.measurement import ShotKey
from simulator.electronics.interference import Interference
from simulator.experiment.scatter import STEEPEST_TILT_RAD, Strike
from simulator.numerics.arrays import FloatArray
from simulator.numerics.keyed_random import Purpose, keyed_generator
from simulator.parameters.chain import ChainParameters
from simulator.parameters.electronics import AdcParameters, SensorParameters
from simulator.parameters.faults import FaultParameters, MainsHumFault, SpikesFault

HOURS_PER_YEAR = 8_766.0
"""Julian year."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotFaults:
    """Faults of one shot; the defaults are a sound one.

    Attributes
    ----------
    double_delay_s
        Time from the first to the second impact; None: there is one impact.
    double_height_fraction
        Drop height of the second impact over the first one's.
    gain_factor
        Product of all changes of gain but the tilt's own.
    radius_factor, contact_damping_factor
        Radius of curvature of all contacts and dashpot to the plate, over the nominal ones.
    truth
        Column by column of the active faults.
    """

    missed: bool = False
    double_delay_s: float | None = None
    double_height_fraction: float = 1.0
    tilt_rad: float = 0.0
    temperature_k: float = 0.0
    gain_factor: float = 1.0
    radius_factor: float = 1.0
    contact_damping_factor: float = 1.0
    truth: dict[str, float] = field(default_factory=dict)


NO_FAULTS = ShotFaults()
"""A sound shot."""
SOUND = FaultParameters()
"""A position without faults."""


def draw_faults_of_shot(faults: FaultParameters, *, seed: int, key: ShotKey, hour_h: float) -> ShotFaults:
    """Draw the faults of a strike, of its chain and of its sensor at an hour of the test.

    Hum and spikes are drawn by `draw_interference`, since they need the record's length.
    The result depends only on seed, key and hour.
    """
    truth: dict[str, float] = {}
    missed, gain_factor = False, 1.0
    if faults.missed.probability > 0.0:
        missed = hour_h >= faults.missed.onset_h and bool(
            keyed_generator(seed, Purpose.MISSED_STRIKE, key=key).random() < faults.missed.probability
        )
        truth["fault_missed"] = float(missed)
    delay_s, height_fraction = None, 1.0
    if faults.double.probability > 0.0:
        if hour_h >= faults.double.onset_h:
            delay_s, height_fraction = _draw_second_strike(faults, seed, key)
        truth["fault_double_delay_s"] = math.nan if delay_s is None else delay_s
        truth["fault_double_height_fraction"] = math.nan if delay_s is None else height_fraction
    tilt_rad = faults.tilt.tilt_rad * _fault_size_fraction(faults.tilt.onset_h, faults.tilt.ramp_h, hour_h)
    if faults.tilt.tilt_rad > 0.0:
        truth["fault_tilt_rad"] = tilt_rad
    wear = faults.bead_wear
    radius_factor = 1.0 + wear.radius_growth_fraction * _fault_size_fraction(
        wear.onset_h, wear.ramp_h, hour_h
    )
    if wear.radius_growth_fraction > 0.0:
        truth["fault_bead_wear_radius_factor"] = radius_factor
    if faults.pzt_ageing.loss_fraction_per_year > 0.0:
        years = max(hour_h - faults.pzt_ageing.onset_h, 0.0) / HOURS_PER_YEAR
        truth["fault_pzt_ageing_gain_factor"] = (1.0 - faults.pzt_ageing.loss_fraction_per_year) ** years
        gain_factor *= truth["fault_pzt_ageing_gain_factor"]
    damping_factor = 1.0
    if faults.loose_contact.probability > 0.0:
        loose = hour_h >= faults.loose_contact.onset_h and bool(
            keyed_generator(seed, Purpose.LOOSE_CONTACT, key=key).random() < faults.loose_contact.probability
        )
        damping_factor = faults.loose_contact.damping_factor if loose else 1.0
        truth["fault_loose_contact_gain_factor"] = faults.loose_contact.gain_factor if loose else 1.0
        truth["fault_loose_contact_damping_factor"] = damping_factor
        gain_factor *= truth["fault_loose_contact_gain_factor"]
    warmer = faults.temperature
    temperature_k = warmer.change_k * _fault_size_fraction(warmer.onset_h, warmer.ramp_h, hour_h)
    if warmer.change_k != 0.0:
        truth["fault_temperature_k"] = temperature_k
    if faults.clipping.gain_factor > 1.0:
        stepped = hour_h >= faults.clipping.onset_h
        truth["fault_clipping_gain_factor"] = faults.clipping.gain_factor if stepped else 1.0
        gain_factor *= truth["fault_clipping_gain_factor"]
    return ShotFaults(
        missed=missed,
        double_delay_s=delay_s,
        double_height_fraction=height_fraction,
        tilt_rad=tilt_rad,
        temperature_k=temperature_k,
        gain_factor=gain_factor,
        radius_factor=radius_factor,
        contact_damping_factor=damping_factor,
        truth=truth,
    )


def _fault_size_fraction(onset_h: float, ramp_h: float, hour_h: float) -> float:
    """Return the fraction of a gradual fault's full size: 0 before its onset, 1 after its ramp.

    It rises linearly in between; a ramp of 0 h is a step.
    """
    if hour_h < onset_h:
        return 0.0
    return min((hour_h - onset_h) / ramp_h, 1.0) if ramp_h > 0.0 else 1.0


def _draw_second_strike(faults: FaultParameters, seed: int, key: ShotKey) -> tuple[float | None, float]:
    """Draw delay in s and relative height of the striker's second impact; ``(None, 1.0)`` without one."""
    random = keyed_generator(seed, Purpose.DOUBLE_STRIKE, key=key)
    if random.random() >= faults.double.probability:
        return None, 1.0
    delay_s = float(random.uniform(faults.double.shortest_delay_s, faults.double.longest_delay_s))
    return delay_s, float(random.uniform(faults.double.lowest_height_fraction, 1.0))


def apply_strike_faults(strike: Strike, faults: ShotFaults, sensor: SensorParameters) -> Strike:
    """Return a strike with faults applied: tilt (at most 0.2 rad) with its loss of gain, and gain."""
    tilt_rad = min(strike.tilt_rad + faults.tilt_rad, STEEPEST_TILT_RAD)
    tilt_loss = math.exp(-sensor.tilt_loss_per_rad * (tilt_rad - strike.tilt_rad))
    return replace(
        strike,
        tilt_rad=tilt_rad,
        sensor_gain_v_per_n=strike.sensor_gain_v_per_n * tilt_loss * faults.gain_factor,
    )


def apply_chain_faults(chain: ChainParameters, faults: ShotFaults) -> ChainParameters:
    """Return a chain with faults applied: worn contacts, and another dashpot to the plate.

    Masses and geometry stay.
    """
    return replace(
        chain.with_worn_contacts(faults.radius_factor),
        contact_damping_n_s_per_m=chain.contact_damping_n_s_per_m * faults.contact_damping_factor,
    )


def draw_interference(
    faults: FaultParameters, *, seed: int, key: ShotKey, hour_h: float, adc: AdcParameters
) -> tuple[Interference | None, dict[str, float]]:
    """Draw hum and spikes around one strike, with their true values; None where a position has neither.

    Spikes come evenly from the arming to the end of the record. The truth counts those inside a record
    that the wave itself triggers.
    """
    truth: dict[str, float] = {}
    hum, spikes = faults.mains_hum, faults.spikes
    if hum.amplitude_v == 0.0 and spikes.rate_hz == 0.0:
        return None, truth
    phase_rad = _draw_hum_phase_rad(hum, seed, key)
    hum_v = hum.amplitude_v if hour_h >= hum.onset_h else 0.0
    if hum.amplitude_v > 0.0:
        truth |= {"fault_mains_hum_v": hum_v, "fault_mains_hum_phase_rad": phase_rad}
    time_s, height_v = _draw_spikes(spikes, seed, key, hour_h, adc)
    found = Interference(
        hum_v=hum_v,
        hum_frequency_hz=hum.frequency_hz,
        hum_phase_rad=phase_rad,
        spike_time_s=time_s,
        spike_v=height_v,
        spike_fwhm_s=spikes.fwhm_s,
    )
    if spikes.rate_hz > 0.0:
        inside = time_s >= -adc.pretrigger_samples / adc.sample_rate_hz
        truth["fault_spikes"] = float(np.count_nonzero(inside))
        truth["fault_spike_v"] = spikes.height_v
        truth["fault_false_triggers"] = float(found.find_false_triggers_s(adc.trigger_level_v).size)
    return found, truth


def _draw_hum_phase_rad(hum: MainsHumFault, seed: int, key: ShotKey) -> float:
    """Draw the phase of the mains hum at a strike in rad; 0 without hum."""
    if hum.amplitude_v == 0.0:
        return 0.0
    return float(keyed_generator(seed, Purpose.MAINS_HUM, key=key).uniform(0.0, 2.0 * math.pi))


def _draw_spikes(
    spikes: SpikesFault, seed: int, key: ShotKey, hour_h: float, adc: AdcParameters
) -> tuple[FloatArray, FloatArray]:
    """Draw times in s and heights in V of random spikes from arming to the record's end.

    They are a Poisson process; both arrays are empty before its onset.
    """
    if spikes.rate_hz == 0.0 or hour_h < spikes.onset_h:
        return np.empty(0), np.empty(0)
    random = keyed_generator(seed, Purpose.SPIKES, key=key)
    before_s = max(spikes.armed_s, adc.pretrigger_samples / adc.sample_rate_hz)
    after_s = (adc.record_samples - adc.pretrigger_samples) / adc.sample_rate_hz
    count = int(random.poisson(spikes.rate_hz * (before_s + after_s)))
    time_s = np.sort(random.uniform(-before_s, after_s, count))
    height_v: FloatArray = spikes.height_v * random.choice(np.array([-1.0, 1.0]), count)
    return time_s, height_v
