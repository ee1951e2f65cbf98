"""What an NI-SCOPE board records of a probe: the twin's echo through the board's ADC."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware_drivers.measurement import Calibration, ShotKey
from simulator.doubles.description import ProbeWiring
from simulator.keyed_random import Purpose, generator
from simulator.specimen import Specimen
from simulator.transduction import counts_of
from simulator.ultrasonic_echo import echo_volts


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordShape:
    """How the board has been told to record one probe."""

    sample_rate_hz: float
    samples: int
    records: int
    trigger_delay_s: float


def single_records(
    specimen: Specimen,
    probe: ProbeWiring,
    shape: RecordShape,
    calibration: Calibration,
    key: ShotKey,
    hour_h: float,
) -> NDArray[np.int32]:
    """Codes of each record of one acquisition, unpadded, shape (records, samples).

    The echo is the twin's own (`Specimen.echo`) at the board's rate and length. Each record carries the
    noise of a single one, drawn for this key: their mean scatters by the square root of their number, as
    the twin's averaged record does, but from other draws. With the noise off all records are equal.
    """
    twin = specimen.twin
    wall = specimen.walls[key.position].at(hour_h)
    thickness_m = specimen.probed_thickness_m[key.position] * (1.0 - wall.depth_fraction)
    # A record that starts later than the firing pulse shows everything earlier.
    delay_s = twin.echo.delay_s + (probe.sync_to_firing_s - shape.trigger_delay_s)
    volts = np.zeros((shape.records, shape.samples))
    if delay_s >= 0.0:
        echo = dataclasses.replace(
            twin.echo,
            sample_rate_hz=shape.sample_rate_hz,
            record_samples=shape.samples,
            delay_s=delay_s,
        )
        volts += echo_volts(thickness_m, echo)
    if twin.noise.enabled:
        random = generator(twin.seed, Purpose.ECHO_NOISE, key=key)
        volts += twin.echo.noise_rms_v * random.standard_normal(volts.shape)
    return counts_of(volts, calibration).astype(np.int32)
