"""Begin or resume a set, strike and read, keep each measurement, and make the record of the set."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator

from analysis.waves.features import ShotFeatures
from analysis.waves.quality_gate import RestrikeRule
from daq_service.acquisition.schedule import DueSet
from daq_service.acquisition.shot_features import features_of_a_rehearsal
from daq_service.acquisition.take_set import Measurement, MissedShot, SetPlan, TakenSet, take_set
from daq_service.archive import OpenSet, PositionRecord, SetRecord
from daq_service.clock import boot_id
from daq_service.commands.execution import CommandExecutor
from daq_service.recording.persistence import Persistence
from daq_service.recording.provenance import provenance
from daq_service.recording.resources import Resources
from daq_service.recording.set_assessor import SetAssessor
from hardware_drivers.errors import InstrumentError
from hardware_drivers.measurement import Shot
from hardware_drivers.methods import SOLITARY_WAVE

log = logging.getLogger(__name__)

FeaturesOf = Callable[[Shot], ShotFeatures]


class SetAcquisition:
    """Takes sets, one at a time.

    Attributes
    ----------
    provenance
        What each file states of its origin.
    next_sequence
        Id of the next shot (`Shot.sequence`).
    """

    def __init__(
        self,
        resources: Resources,
        assessor: SetAssessor,
        persistence: Persistence,
        features_of: FeaturesOf,
        commands: CommandExecutor,
    ) -> None:
        self._settings, self._rig = resources.settings, resources.rig
        self._archive, self._live = resources.archive, resources.live
        self._set_assessor, self._persistence = assessor, persistence
        self._commands, self._struck = commands, self._settings.names_of(SOLITARY_WAVE)
        self.features_of = features_of_a_rehearsal if self._rig.dry_run else features_of
        # Simulated time has one frame on every computer.
        self._in_real_time = resources.in_real_time
        self._boot_id = boot_id() if self._in_real_time else "simulated"
        self.provenance = provenance(
            self._settings, self._rig, experiment=resources.catalogue.experiment_row()
        )
        self.next_sequence = 0

    # Before the first strike ----------------------------------------------------------------------

    def begin(self, due: DueSet) -> TakenSet:
        """Open a set in the journal."""
        left_out = {
            name: f"a confirmation set of {due.position}"
            for name in self._settings.positions
            if due.position not in (None, name)
        }
        taken = TakenSet(
            rule=self._restrike_rule(),
            # As of now: a command during the set changes what is struck, not what was planned.
            disabled=self._set_assessor.disabled() | left_out,
            started_ns=self._rig.clock.utc_ns(),
        )
        self._archive.begin_set(
            due.set_key,
            due_utc_ns=due.due_utc_ns,
            started_utc_ns=taken.started_ns,
            disabled=taken.disabled,
        )
        return taken

    def resume(self, opened: OpenSet) -> TakenSet:
        """Continue a set that the last recorder left open in the journal."""
        self._archive.resume_set(opened)
        return self.restored(opened)

    def restored(self, opened: OpenSet) -> TakenSet:
        """Return what an earlier recorder took of a set."""
        taken = TakenSet(
            rule=self._restrike_rule(), disabled=dict(opened.disabled), started_ns=opened.started_utc_ns
        )
        taken.restore(opened)
        taken.features.update({shot.sequence: self.features_of(shot) for shot in taken.shots})
        taken.ended_ns = opened.last_utc_ns
        self._persistence.were_acknowledged(item.sequence for item in opened.records)
        log.warning("set %s goes on: %d records of it are there", opened.set_key, len(opened.records))
        return taken

    def _restrike_rule(self) -> RestrikeRule:
        quality = self._settings.quality
        restrikes = 0 if self._rig.dry_run else quality.restrikes_per_set
        return RestrikeRule(flags=quality.restrike_flags, restrikes_per_set=restrikes)

    # Strike by strike -----------------------------------------------------------------------------

    def measurements(self, due: DueSet, taken: TakenSet, idle: Callable[[], bool]) -> Iterator[Measurement]:
        """Strike and read; an error of the instruments ends the set, and what came before it is kept."""
        schedule = self._settings.schedule
        set_plan = SetPlan(
            due=due,
            positions={
                name: place.method
                for name, place in self._settings.positions.items()
                if name not in taken.disabled
            },
            shots_per_set=schedule.shots_per_set,
            shot_interval_s=schedule.shot_interval_s,
            read_timeout_s=self._settings.rig.read_timeout_s,
        )
        measurements = take_set(
            self._rig,
            set_plan,
            progress=taken.progress(self._struck) if taken.progress(()).tried else None,
            first_sequence=self.next_sequence,
            boot_id=self._boot_id,
            idle=lambda: idle() and not self._commands.paused,
            wants_restrike=taken.wants_restrike,
            may_strike=lambda position: position not in self._set_assessor.disabled(),
        )
        try:
            yield from measurements
        except InstrumentError as error:
            log.exception("set %s: the rig failed", due.set_key)
            taken.trouble = error
        taken.ended_ns = self._rig.clock.utc_ns()

    def keep(self, measurement: Measurement, taken: TakenSet) -> None:
        """Append a measurement to the journal, and acknowledge it."""
        taken.keep(measurement)
        if isinstance(measurement, MissedShot):
            self._archive.append(taken.missed_records()[-1], self._rig.clock.utc_ns())
            return
        self._archive.append(measurement, measurement.stamp.utc_ns)
        if self._in_real_time:  # simulated time has no crash between two shots
            self._persistence.acknowledge()

    def extract(self, measurement: Measurement, due: DueSet, taken: TakenSet) -> None:
        """Extract the features of a shot, and show the waveform in the live figure."""
        if isinstance(measurement, MissedShot):
            return
        if isinstance(measurement, Shot):
            taken.features[measurement.sequence] = self.features_of(measurement)
        if self._live.due(measurement.key.position):
            features = taken.features.get(measurement.sequence)
            self._live.show(measurement, due_h=due.due_h, features=features)

    # After the last strike ------------------------------------------------------------------------

    def is_complete(self, taken: TakenSet) -> bool:
        """Return whether every planned shot was tried."""
        return taken.is_complete(self._set_assessor.n_planned)

    def shortfall(self, position: str, taken: TakenSet, cut_short_reason: str = "") -> str:
        """Return the reason why a position has fewer records than planned; empty if it has all."""
        end_reason = (
            cut_short_reason
            or self._set_assessor.disabled().get(position)
            or self._commands.paused
            or "the recorder was told to stop"
        )
        return taken.shortfall(position, self._set_assessor.n_planned[position], end_reason)

    def record_of(self, due: DueSet, taken: TakenSet, cut_short_reason: str) -> SetRecord:
        """Make the record of a set that is to be stored."""
        positions = [
            PositionRecord(
                position=name,
                method=place.method,
                n_planned=self._set_assessor.n_planned[name],
                cause=self.shortfall(name, taken, cut_short_reason),
                label=place.label,
                serial_number=place.serial_number,
            )
            for name, place in self._settings.positions.items()
            if name not in taken.disabled
        ]
        return SetRecord(
            set_index=due.set_index,
            unscheduled_index=due.unscheduled_index,
            due_utc_ns=due.due_utc_ns,
            due_h=due.due_h,
            started_utc_ns=taken.started_ns,
            ended_utc_ns=taken.ended_ns,
            rig_kind=self._rig.kind,
            positions=positions,
            shots=taken.shots,
            echoes=taken.echoes,
            missed=taken.missed_records(),
            outcomes=taken.superseded(),
            trouble=taken.instrument_error(),
            environment={} if self._set_assessor.drive is None else self._set_assessor.drive.summary(),
            provenance=self.provenance,
        )

    def number_after(self, record: SetRecord) -> None:
        """Set the next shot number above those of a record."""
        self.next_sequence = max([self.next_sequence, *(item.sequence + 1 for item in record.records)])
