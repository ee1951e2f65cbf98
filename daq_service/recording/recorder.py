"""The line from strike to alarm: plan, acquire, persist, extract, assess, commit, publish.

`Recorder` has one method for each stage, in this order, and no stage calls an earlier one. A shot is
acknowledged only when it is durable. Rows, alarms and events of a set are stored in one transaction; its
events are what every other process learns.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from typing import Any

from analysis.waves.features import ShotFeatures
from daq_service.acquisition.shot_features import FeaturesOf
from daq_service.alarms.states import Moment
from daq_service.archive import SetRecord
from daq_service.catalogue import SetCommit
from daq_service.recording.acquire_set import Activity, SetAcquisition, TakenSet
from daq_service.recording.carried_over import CarriedOver
from daq_service.recording.clock_doubt import wait_for_verified_clock
from daq_service.recording.computer_load import MACHINE_READ
from daq_service.recording.due_sets import DueSets
from daq_service.recording.empty_set import store_empty_set
from daq_service.recording.opening import Opening, build_started_payload, raise_if_permanent
from daq_service.recording.operators import build_command_executor, listen_to_instruments
from daq_service.recording.persistence import Persistence
from daq_service.recording.resources import Resources
from daq_service.recording.set_assessor import SetAssessor
from daq_service.recording.storage_alarms import StorageAlarms
from daq_service.recording.waiting import Waiting
from hardware_drivers.measurement import DueSet, Measurement, SetKey

STAGES = (
    *("strike_and_read_s", "extract_s", "image_s", "write_s"),
    *("fsync_s", "directory_fsync_s", "judge_s", "commit_s"),
)


class Cost:
    """Seconds of wall time by stage, printed at the end of a run and stored with its last event."""

    def __init__(self, clock_s: Callable[[], float] = time.perf_counter) -> None:
        """Start at zero seconds for each stage, and the elapsed time now."""
        self.sets = 0
        self._clock_s, self._started_s = clock_s, clock_s()
        self.seconds = dict.fromkeys(STAGES, 0.0)

    @contextmanager
    def of(self, stage: str) -> Iterator[None]:
        """Add the wall time in s of the block, even if it raises, to a stage; KeyError if unknown."""
        start = self._clock_s()
        try:
            yield
        finally:
            self.seconds[stage] += self._clock_s() - start

    def add_set(self, seconds: Mapping[str, float]) -> None:
        """Count a stored set and add the seconds of its stages; KeyError for an unknown stage."""
        self.sets += 1
        for stage, value in seconds.items():
            self.seconds[stage] += value

    def as_row(self) -> dict[str, float]:
        """Return number of sets and seconds by stage, to 1 ms; ``other_s`` is the remaining elapsed time."""
        other_s = self._clock_s() - self._started_s - sum(self.seconds.values())
        seconds = {**self.seconds, "other_s": other_s}
        return {"sets": self.sets, **{stage: round(value, 3) for stage, value in seconds.items()}}


class Recorder:
    """Takes the sets of a test, one after the other."""

    def __init__(self, resources: Resources, *, features_of: FeaturesOf | None = None) -> None:
        """Build and connect the parts; read open sets and states of the test, or raise StorageError."""
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
        self._activity = activity = Activity(resources, assessor, persistence)
        storage = StorageAlarms(resources, assessor, persistence)
        self.waiting = waiting = Waiting(resources, assessor, persistence, storage, activity)
        self.commands = commands = build_command_executor(resources, assessor, waiting)
        activity.looks = (storage.check_web, partial(persistence.attempt, commands.execute_open_commands))
        self._acquisition = SetAcquisition(resources, assessor, persistence, features_of, commands, activity)
        self._carried_over = CarriedOver(resources, assessor, persistence, self._acquisition)
        self._due_sets = DueSets(
            resources, assessor, persistence, self._carried_over, waiting, self._record_gap, commands
        )
        listen_to_instruments(resources, persistence, activity)

    def run(self, *, not_running_reason: str, opening: Opening | None = None) -> bool:
        """Take every set that is still due, then wait for their files; return False when ``stop`` came first.

        ``opening`` is what this recorder did before. Raises RigError after a lasting error of an instrument.
        """
        resources, persistence, waiting = self._resources, self._persistence, self.waiting
        done = resources.catalogue.list_committed_sets()
        persistence.do(self.commands.close_earlier_commands)
        origin = self._acquisition.provenance
        started = build_started_payload(resources.rig, not_running_reason, len(done), origin)
        persistence.say("recorder_started", started)
        self._carried_over.quarantine_corrupt_files()
        waiting.storage.start_verification()
        resources.report("begun")
        absences = wait_for_verified_clock(
            resources, self._set_assessor, persistence, waiting, not_running_reason, opening
        )
        for due in self.plan(done, absences):
            self._process_set(due)
        waiting.wait_until_stored()
        waiting.wait_for_files()
        return self._finish_run()

    def _process_set(self, due: DueSet) -> None:
        """Acquire a set and pass it through all stages, or record a gap; RigError after a lasting error."""
        if hindrance := self._due_sets.find_skip_reason(due):
            self._record_gap(due, hindrance)
            return
        self._persistence.attempt(self._set_assessor.adopt)
        self._activity.announce(f"taking {due}")
        if due.position is None:
            self.waiting.next_set = due.set_index + 1
        opened = self._carried_over.open_sets.pop(due.set_key, None)
        taken = self._acquisition.begin(due) if opened is None else self._carried_over.resume(opened)
        for measurement in self.acquire(due, taken):
            self.persist(measurement, taken)
            self.extract(measurement, due, taken)
        if self._leave_set_open(taken):
            return
        if not taken.is_empty:
            self._process_acquired_set(due, taken)
        elif not self._stop.is_set():
            reasons = self._acquisition.find_shortfalls(due, taken)
            store_empty_set(
                self._set_assessor, self._persistence, due, reasons, utc_ns=taken.ended_ns, tried=taken
            )
            self._resources.archive.settle(due.set_key)
        # else: the set is still due after a restart
        if taken.trouble is not None:
            raise_if_permanent(taken.trouble, due, n_shots=len(taken.shots), proven=self._set_assessor.proven)

    def _process_acquired_set(self, due: DueSet, taken: TakenSet, *, cut_short_reason: str = "") -> None:
        """Queue the stages that write acquired records; they wait in memory while the disk refuses."""
        self._activity.announce(f"storing {due}")
        reason = self._carried_over.corruption_of.get(due.set_key, cut_short_reason)
        record = self._acquisition.record_of(due, taken, reason)
        self._acquisition.advance_next_shot_number(record)
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
        """Block until each set without rows is due and yield it; close overdue ones (`DueSets.follow`)."""
        return self._due_sets.follow(done, absences)

    def acquire(self, due: DueSet, taken: TakenSet) -> Iterator[Measurement]:
        """Strike and read; yield each measurement before the next strike, timed; an error ends the set."""
        measurements = self._acquisition.acquire_measurements(due, taken)
        while True:
            with self._cost.of("strike_and_read_s"):
                measurement = next(measurements, None)
            if measurement is None:
                return
            yield measurement

    def persist(self, measurement: Measurement, taken: TakenSet) -> None:
        """Add a measurement to set and journal; in real time also make it durable and acknowledge it."""
        self._acquisition.keep(measurement, taken)

    def extract(self, measurement: Measurement, due: DueSet, taken: TakenSet) -> None:
        """Extract the features of a shot, which decide whether it is repeated; show its waveform if due."""
        with self._cost.of("extract_s"):
            self._acquisition.extract(measurement, due, taken)

    def assess(
        self,
        due: DueSet,
        record: SetRecord,
        features: Mapping[int, ShotFeatures],
        load: Mapping[str, Any] | None,
    ) -> SetCommit:
        """Store the set durably, then assess it; return its rows and events; ArchiveError if refused."""
        stored = self._persistence.store(record)
        self._cost.add_set(asdict(stored.timings))
        self._activity.doing = f"assessing {due}"
        with self._cost.of("judge_s"):
            transaction = self._set_assessor.assessed(due, record, stored.file, features)
        if load is not None and due.position is None:
            moment = Moment.of_set(due, record.ended_utc_ns)
            transaction.events.append(moment.event("machine", MACHINE_READ, load))
        return transaction

    def commit(self, transaction: SetCommit) -> None:
        """Store the rows, alarms and events of a set in one transaction; CatalogueError if refused."""
        with self._cost.of("commit_s"):
            self._set_assessor.store(transaction)

    def publish(self, due: DueSet, transaction: SetCommit) -> None:
        """Report alarms and gaps of a stored set, and notify the background tasks, which write its file."""
        self._set_assessor.publish(transaction)
        self._persistence.after_set(due.set_key)

    def _record_gap(self, due: DueSet, reason: str) -> None:
        """Queue a set that is not acquired: records of an open set, or rows of a gap with the reason."""
        opened = self._carried_over.open_sets.pop(due.set_key, None)
        if opened is not None and opened.records:
            self._process_acquired_set(due, self._carried_over.resume(opened), cut_short_reason=reason)
            return
        reason = self._carried_over.corruption_of.get(due.set_key, reason)
        reasons = dict.fromkeys(self._set_assessor.list_set_positions(due), reason)
        self._resources.archive.settle(due.set_key)
        now_ns = self._resources.rig.clock.utc_ns()
        store_empty_set(self._set_assessor, self._persistence, due, reasons, utc_ns=now_ns)

    def _leave_set_open(self, taken: TakenSet) -> bool:
        """Return whether a set that a stop cut short is left to the next recorder, its shots durable."""
        cut = self._stop.is_set() and not self.commands.paused and taken.trouble is None
        return cut and not taken.is_complete(self._set_assessor.n_planned) and self._persistence.acknowledge()

    def _finish_run(self) -> bool:
        """Store the run's end and cost; if supervised, switch the supply off; return False after a stop."""
        finished, is_unsupervised = not self._stop.is_set(), self._resources.options.unsupervised.is_set()
        # A supervisor that was killed is no end of the test: the drive's process watches the supply.
        drive = None if is_unsupervised else self._set_assessor.drive
        supply = "" if drive is None else drive.switch_off_at_end()
        farewell = {"cost": self._cost.as_row(), **({"supply": supply} if supply else {})}
        stopped = "recorder_left_alone" if is_unsupervised else "recorder_stopped"
        self.waiting.end()
        self._persistence.say("schedule_done" if finished else stopped, farewell)
        if finished:
            self.waiting.wait_until_stored()
        return finished
