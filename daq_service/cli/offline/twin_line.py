"""Run the twin's experiment from shot to assessment without recorder, archive and clock.

For studies over many seeds. Shots, features, quality check, mean of the set and assessment use the functions
of the recorder, so results are equal to the last bit; nothing is stored. Strikes are tried once, and a
transducer that would be disabled ends its run.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from daq_service.acquisition.schedule import plan_sets
from daq_service.acquisition.shot_features import derive_extraction_settings, extract_features_of_shots
from daq_service.assessment.assessor import PositionResult
from daq_service.assessment.baseline_lifecycle import get_baseline_range
from daq_service.assessment.solitary_wave import SolitaryWaveAssessor
from daq_service.clock import parse_utc
from daq_service.rig.twin import build_transducers
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import DueSet, Shot, ShotKey, Stamp
from simulator.specimen import Specimen, build_specimen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AssessedSet:
    """One set of one transducer.

    Attributes
    ----------
    hour_h
        Whose wall and weather it met.
    shots
        The records, with what the twin knows of each.
    """

    due: DueSet
    hour_h: float
    shots: tuple[Shot, ...]
    position_result: PositionResult

    @property
    def raised(self) -> frozenset[str]:
        """Return the kinds of the active alarms after this set; empty if there are none."""
        return frozenset(one.kind for one in self.position_result.conditions if one.present)


def build_twin(settings: Settings) -> Specimen:
    """Build the twin of a configuration; `simulate_assessed_sets` of multiple positions can share it."""
    return build_specimen(settings.twin, transducers=build_transducers(settings), probed_thickness_m={})


def simulate_assessed_sets(
    settings: Settings, position: str, specimen: Specimen | None = None
) -> Iterator[AssessedSet]:
    """Strike and assess each scheduled set of a transducer and yield it.

    Ends with the schedule, or after a set that raises "no_reflection" or disables the transducer. A specimen
    is built if None.

    Raises
    ------
    SimulatorError
        The twin cannot compute a shot.
    """
    specimen = specimen or build_twin(settings)
    epoch_ns, by_position = parse_utc(settings.clock.epoch), derive_extraction_settings(settings.positions)
    assessor = SolitaryWaveAssessor(position, settings, baseline=get_baseline_range(position, settings, None))
    for due in plan_sets(settings.schedule.phases, epoch_ns, end_h=settings.schedule.end_h):
        hour_h = specimen.hour_h(due.due_utc_ns - epoch_ns)
        stamp = Stamp(utc_ns=due.due_utc_ns, mono_ns=due.due_utc_ns, boot_id="simulated")
        keys = [
            ShotKey(position=position, set_index=due.set_index, shot_index=index)
            for index in range(settings.schedule.shots_per_set)
        ]
        records = specimen.simulate_waves([(key, hour_h) for key in keys])
        shots = tuple(
            Shot(
                sequence=key.shot_index + 1,
                key=key,
                stamp=stamp,
                waveform=record.waveform,
                truth=record.truth,
            )
            for key, record in zip(keys, records, strict=True)
            if record is not None
        )
        position_result = assessor.assess(
            due, shots, extract_features_of_shots(shots, by_position), n_tried=len(keys)
        )
        found = AssessedSet(due=due, hour_h=hour_h, shots=shots, position_result=position_result)
        yield found
        if found.raised & {"no_reflection", "transducer_disabled"}:
            return
