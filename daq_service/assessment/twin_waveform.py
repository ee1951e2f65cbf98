"""Waveform of the twin at a wall loss, on a curve of the bank."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.errors import InvalidInputError
from analysis.waves.features import extract_from_volts
from analysis.waves.record_reduction import ExtractionSettings, FloatArray
from daq_service.assessment.wall_bank import RECORDER, compute_mean_loss, list_members, make_impact
from daq_service.processes.installation import require_extras
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import PlateParameters


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedShot:
    """Dynamic force at the sensor from first touch on, without noise, and time and height of its ISW."""

    step_s: float
    force_n: FloatArray
    isw_time_s: float
    isw_amplitude_n: float

    def to_volts(self, time_s: FloatArray, isw_time_s: float, isw_amplitude_v: float) -> FloatArray:
        """Return the voltage at times from the trigger, with this time and amplitude of the ISW."""
        grid_s = self.step_s * np.arange(self.force_n.size) + (isw_time_s - self.isw_time_s)
        force_n = np.interp(time_s, grid_s, self.force_n, left=0.0, right=0.0)
        return np.asarray(force_n * (isw_amplitude_v / self.isw_amplitude_n))


def simulate_curve_shot(
    chain: ChainParameters, plate: PlateParameters, extraction: ExtractionSettings, curve: str, loss: float
) -> SimulatedShot:
    """Simulate a shot on the wall of a curve of the bank, at a loss averaged over the estimand's disc.

    Its ISW is found with the extraction settings of the position.

    Raises
    ------
    MissingExtraError
        The extra `twin` is not installed.
    InvalidInputError
        There is no such curve, or it does not reach this loss.
    SimulatorError
        The twin does not simulate it.
    """
    require_extras("twin")
    from simulator.shot.model import ShotModel

    member = next((one for one in list_members(plate) if one.name == curve), None)
    if member is None:
        raise InvalidInputError(f"curve {curve!r} is none of this plate: another version wrote it")
    if not 0.0 <= (depth := max(loss, 0.0) / compute_mean_loss(member.patch)) < 1.0:
        raise InvalidInputError(f"curve {curve!r} has no loss of {loss:.0%} of the wall")
    shot = ShotModel(chain, member.plate, member.patch).shots([make_impact(chain, member, depth)])[0]
    simulated = SimulatedShot(
        step_s=float(shot.time_s[-1]) / (shot.time_s.size - 1),
        force_n=shot.force_n - shot.preload_n,
        isw_time_s=0.0,
        isw_amplitude_n=1.0,
    )
    rate_hz, before = RECORDER.adc.sample_rate_hz, RECORDER.adc.pretrigger_samples
    time_s = np.arange(-before, RECORDER.adc.record_samples) / rate_hz
    found = extract_from_volts(simulated.to_volts(time_s, 0.0, 1.0), rate_hz, before, settings=extraction)
    return replace(simulated, isw_time_s=found.isw_time_s, isw_amplitude_n=found.isw_amplitude_v)
