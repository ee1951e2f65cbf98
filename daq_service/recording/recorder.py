"""The line from strike to alarm: plan, acquire, persist, extract, assess, commit, publish.

`Recorder` has one method for each stage, in this order, and no stage calls an earlier one. A shot is
acknowledged only when it is durable. Rows, alarms and events of a set are stored in one transaction; its
events are what every other process learns.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from analysis.waves.features import ShotFeatures
from daq_service.acquisition.shot_features import features_of
from daq_service.alarms.states import Moment
from daq_service.archive import SetRecord
from daq_service.catalogue import SetCommit
from daq_service.errors import RigError, StorageError
from daq_service.recording.acquire_set import FeaturesOf, SetAcquisition, TakenSet
from daq_service.recording.carried_over import CarriedOver
from daq_service.recording.clock_doubt import until_clock_is_believed
from daq_service.recording.computer_load import MACHINE_READ
from daq_service.recording.cost import Cost
from daq_service.recording.due_sets import DueSets
from daq_service.recording.empty_set import nothing_taken
from daq_service.recording.opening import Opening, is_transient
from daq_service.recording.operators import command_executor, listen_to_instruments
from daq_service.recording.persistence import Persistence
from daq_service.recording.resources import Resources
from daq_service.recording.set_assessor import SetAssessor
from daq_service.recording.storage_alarms import StorageAlarms
from daq_service.recording.waiting import Waiting
from hardware_drivers.measurement import DueSet, Measurement, SetKey

log = logging.getLogger(__name__)


class Recorder:
    """Takes the sets of a test, one after the other."""

    def __init__(self, resources: Resources, *, features_of: FeaturesOf = features_of) -> None:
        self._resources, self._stop, self._cost = resources, resources.stop, Cost()
        self._set_assessor = assessor = SetAssessor(
            resources.settings,
            resources.archive,
            resources.catalogue,
            resources.rig,
            resources.options.remote_drive,
            news=resources.report,
        )
        self._persistence = persistence = Persistence(resources)
        storage = StorageAlarms(resources, assessor, persistence)
        self.waiting = waiting = Waiting(resources, assessor, persistence, storage)
        self._commands = waiting.commands = command_executor(resources, assessor, waiting)
        self._acquisition = SetAcquisition(resources, assessor, persistence, features_of, self._commands)
        self._carried_over = CarriedOver(resources, assessor, persistence, self._acquisition)
        self._due_sets = DueSets(
            resources, assessor, persistence, self._carried_over, waiting, self._record_gap
        )
        listen_to_instruments(resources, persistence, waiting)

    def run(self, *, not_running_reason: str, opening: Opening | None = None) -> bool:
        """Take every set that is still due; return False when ``stop`` came first.

        Parameters
        ----------
        opening
            What this recorder did before, while other sets may have fallen due.
        """
        resources, persistence, waiting = self._resources, self._persistence, self.waiting
        rig, done = resources.rig, resources.catalogue.committed_sets()
        persistence.do(self._commands.begin)
        started = {
            "rig": rig.kind,
            "dry_run": rig.dry_run,
            "rig_identity": dict(rig.identity),
            "sets_done": len(done),
            "before": not_running_reason,
            "versions": self._acquisition.provenance["versions"],
        }
        persistence.say("recorder_started", started)
        self._carried_over.quarantine_corrupt_files()
        waiting.storage.start_verification()
        resources.report("begun")
        absences = until_clock_is_believed(
            resources, self._set_assessor, persistence, waiting, not_running_reason, opening
        )
        for due in self.plan(done, absences):
            self._take(due)
        waiting.until_stored()
        waiting.for_files()
        return self._end()

    def _take(self, due: DueSet) -> None:
        """Acquire a set and pass it through all stages."""
        if hindrance := self._hindrance(due):
            self._record_gap(due, hindrance)
            return
        self.waiting.attempt(self._set_assessor.adopt)
        self.waiting.announce(f"taking {_name_of(due)}")
        if due.position is None:
            self.waiting.next_set = due.set_index + 1
        opened = self._carried_over.open_sets.pop(due.set_key, None)
        taken = self._acquisition.begin(due) if opened is None else self._carried_over.resume(opened)
        for measurement in self.acquire(due, taken):
            self.persist(measurement, taken)
            self.extract(measurement, due, taken)
        if self._stays_open(taken):
            return
        if not taken.is_empty:
            self._finish(due, taken)
        elif not self._stop.is_set():
            positions = self._set_assessor.positions_of(due)
            reasons = {name: self._acquisition.shortfall(name, taken) for name in positions}
            self._record_nothing(due, reasons, utc_ns=taken.ended_ns, tried=taken)
            self._resources.archive.settle(due.set_key)
        # else: the set is still due after a restart
        if taken.trouble is not None and not is_transient(taken.trouble, proven=self._set_assessor.proven):
            raise RigError(
                f"set {due.set_key} ended early: {taken.trouble}; the {len(taken.shots)} shots before it "
                "are stored"
            ) from taken.trouble

    def _finish(self, due: DueSet, taken: TakenSet, *, cut_short_reason: str = "") -> None:
        """Pass acquired records through the stages that write to disk; they wait while the disk refuses."""
        self.waiting.announce(f"storing {_name_of(due)}")
        reason = self._carried_over.corruption_of.get(due.set_key, cut_short_reason)
        record = self._acquisition.record_of(due, taken, reason)
        self._acquisition.number_after(record)
        # Now, and not when the disk takes the set.
        watch = self._resources.computer_load
        load = None if watch is None else watch.read(self._cost.seconds)
        self._persistence.post(
            partial(self.assess, due, record, taken.features, load),
            self.commit,
            partial(self.publish, due),
            n_bytes=sum(item.waveform.counts.nbytes for item in record.records),
        )

    # The stages -----------------------------------------------------------------------------------

    def plan(self, done: Collection[SetKey], absences: Sequence[tuple[int, str]]) -> Iterator[DueSet]:
        """Yield each set without rows when it is due; close those whose time is over (`DueSets.follow`)."""
        return self._due_sets.follow(done, absences)

    def acquire(self, due: DueSet, taken: TakenSet) -> Iterator[Measurement]:
        """Strike and read, measurement by measurement."""
        measurements = self._acquisition.measurements(due, taken, self.waiting.within_set)
        while True:
            with self._cost.of("strike_and_read_s"):
                measurement = next(measurements, None)
            if measurement is None:
                return
            yield measurement

    def persist(self, measurement: Measurement, taken: TakenSet) -> None:
        """Append a measurement to the journal, and acknowledge it when it is durable."""
        self._acquisition.keep(measurement, taken)

    def extract(self, measurement: Measurement, due: DueSet, taken: TakenSet) -> None:
        """Extract the features of a shot, which decide whether it is repeated; show the waveform."""
        with self._cost.of("extract_s"):
            self._acquisition.extract(measurement, due, taken)

    def assess(
        self,
        due: DueSet,
        record: SetRecord,
        features: Mapping[int, ShotFeatures],
        load: Mapping[str, Any] | None,
    ) -> SetCommit:
        """Write the set durably, then assess it; return rows, alarms and events as one transaction."""
        stored = self._persistence.store(record)
        self._cost.add_set(asdict(stored.timings))
        self.waiting.doing = f"assessing {_name_of(due)}"
        with self._cost.of("judge_s"):
            transaction = self._set_assessor.assessed(due, record, stored.file, features)
        if load is not None and due.position is None:
            moment = Moment(utc_ns=record.ended_utc_ns, due_h=due.due_h, **due.set_key._asdict())
            transaction.events.append(moment.event("machine", MACHINE_READ, load))
        return transaction

    def commit(self, transaction: SetCommit) -> None:
        """Store the rows, alarms and events of a set in one transaction."""
        with self._cost.of("commit_s"):
            self._set_assessor.store(transaction)

    def publish(self, due: DueSet, transaction: SetCommit) -> None:
        """Report alarms and gaps, and have the set get its file."""
        self._set_assessor.publish(transaction)
        self._persistence.after_set(due.set_key)

    def _hindrance(self, due: DueSet) -> str:
        """Return the reason why a due set is not acquired; empty if it is."""
        if reason := self._due_sets.hindrance(due):
            return reason
        if self._commands.paused or self._persistence.trouble is None or self._persistence.has_room:
            return self._commands.paused
        return f"the memory for what waits is full: {self._persistence.trouble.message}"

    def _record_gap(self, due: DueSet, reason: str) -> None:
        """Record a set without a strike: store the records of an open set, or else rows of a gap."""
        opened = self._carried_over.open_sets.pop(due.set_key, None)
        if opened is not None and opened.records:
            self._finish(due, self._carried_over.resume(opened), cut_short_reason=reason)
            return
        reason = self._carried_over.corruption_of.get(due.set_key, reason)
        reasons = dict.fromkeys(self._set_assessor.positions_of(due), reason)
        self._resources.archive.settle(due.set_key)
        self._record_nothing(due, reasons, self._resources.rig.clock.utc_ns())

    def _record_nothing(
        self, due: DueSet, reasons: Mapping[str, str], utc_ns: int, tried: TakenSet | None = None
    ) -> None:
        rows = partial(nothing_taken, self._set_assessor, due, reasons, utc_ns=utc_ns, tried=tried)
        self._persistence.post(rows, self._set_assessor.commit)

    def _stays_open(self, taken: TakenSet) -> bool:
        """Leave a set that a stop cut short to the next recorder; the journal keeps its shots."""
        cut = self._stop.is_set() and not self._commands.paused and taken.trouble is None
        return cut and not self._acquisition.is_complete(taken) and self._persistence.acknowledge()

    def _end(self) -> bool:
        finished, is_unsupervised = not self._stop.is_set(), self._resources.options.unsupervised.is_set()
        # A supervisor that was killed is no end of the test: the drive's process watches the supply.
        drive = None if is_unsupervised else self._set_assessor.drive
        supply = "" if drive is None else drive.end()
        farewell = {"cost": self._cost.as_row(), **({"supply": supply} if supply else {})}
        stopped = "recorder_left_alone" if is_unsupervised else "recorder_stopped"
        self.waiting.end()
        self._persistence.say("schedule_done" if finished else stopped, farewell)
        if finished:
            self.waiting.until_stored()
        return finished

    def leave(self) -> None:
        """Answer commands that were not started: this recorder does not execute them."""
        try:
            self._commands.close("the recorder has ended")
        except (StorageError, OSError) as error:
            log.warning("open orders are not answered; the next recorder does it: %s", error)


def _name_of(due: DueSet) -> str:
    return f"set {due.set_index}" if due.position is None else f"a confirmation set at {due.position}"
