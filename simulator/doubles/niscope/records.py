"""Records of a probe by an NI-SCOPE board: the twin's echo through the board's ADC."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware_drivers.measurement import Calibration, ShotKey
from simulator.doubles.chassis.description import ProbeWiring
from simulator.echo.records import Disturbance, draw_disturbance, simulate_disturbed_records
from simulator.electronics.transduction import quantise_volts
from simulator.numerics.keyed_random import Purpose, keyed_generator
from simulator.specimen import Specimen


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordShape:
    """Recording settings of a board for one probe."""

    sample_rate_hz: float
    samples: int
    records: int
    trigger_delay_s: float


def simulate_records(
    specimen: Specimen,
    probe: ProbeWiring,
    shape: RecordShape,
    calibration: Calibration,
    key: ShotKey,
    hour_h: float,
) -> NDArray[np.int32]:
    """Simulate the unpadded codes of each record of an acquisition, shape (records, samples).

    The echo is the twin's own (`Specimen.echo`) at the board's rate and length. Each record carries the
    noise of a single one, drawn for this key: their mean scatters by the square root of their number, as
    the twin's averaged record does, but from other draws. With the noise off all records are equal, and
    neither couplant nor bubbles disturb them.
    """
    twin = specimen.twin
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
        found = draw_disturbance(echo, seed=twin.seed, key=key)[0] if twin.noise.enabled else Disturbance()
        wall = specimen.probed_wall(key.position, hour_h)
        volts += simulate_disturbed_records(wall, echo, found, seed=twin.seed, key=key, records=shape.records)
    if twin.noise.enabled:
        random = keyed_generator(twin.seed, Purpose.ECHO_NOISE, key=key)
        volts += twin.echo.noise_rms_v * random.standard_normal(volts.shape)
    return quantise_volts(volts, calibration).astype(np.int32)
