"""The recorder: the complete line from strike to alarm, in reading order.

`schedule` gives the due sets; `take_set` strikes and reads; the archive makes the set durable (only now is it
acknowledged); the set assessor assesses it and updates the alarms; one transaction stores all of it, and its
events are published. No stage calls an earlier one.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial

from analysis.waves.features import ShotFeatures
from analysis.waves.quality_gate import RestrikeRule
from daq_service.acquisition.schedule import DueSet, plan
from daq_service.acquisition.take_set import Measurement, MissedShot, SetPlan, take_set
from daq_service.acquisition.taken_set import (
    TakenSet,
    features_of,
    features_of_a_rehearsal,
)
from daq_service.alarms.clock_trouble import doubt_condition
from daq_service.alarms.states import Moment
from daq_service.archive import Archive, CorruptArchiveError, OpenSet, PositionRecord, SetRecord
from daq_service.assessment.confirmation import overlap_reason
from daq_service.assessment.transaction import Transaction
from daq_service.background.live_figure import LiveFigure
from daq_service.background.write_retry_queue import PASSING
from daq_service.catalogue import RecorderCatalogue
from daq_service.catalogue.rows import AnnotationRow, SetRow
from daq_service.clock import WallClock, boot_id
from daq_service.commands.execution import LISTEN_EVERY_S, CommandExecutor
from daq_service.commands.running_test import RunningTest
from daq_service.corrosion_drive.remote import RemoteDrive
from daq_service.errors import RigError, StorageError
from daq_service.processes.heartbeat import Heartbeat
from daq_service.recording.computer_load import MACHINE_READ
from daq_service.recording.cost import Cost
from daq_service.recording.experiment import foreign_reason, refuse_foreign, refuse_foreign_open_set
from daq_service.recording.opening import Opening
from daq_service.recording.persistence import LOOK_EVERY_S, Helpers, Persistence
from daq_service.recording.provenance import provenance
from daq_service.recording.resumed_time import CLOCK_BELIEVED, CLOCK_STEP
from daq_service.recording.set_assessor import SetAssessor
from daq_service.settings.tree import Settings
from hardware_drivers.errors import BusyError, ConnectionLostError, InstrumentError
from hardware_drivers.instruments import Rig
from hardware_drivers.measurement import Shot, ShotKey, in_order, purpose_of
from hardware_drivers.methods import SOLITARY_WAVE
from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S

log = logging.getLogger(__name__)

SELF_CALIBRATION_TAKES_NS = 180 * NS_PER_S
"""A board's self-calibration takes up to two minutes: it is begun only when there is time for it. The first
one comes at once, since it is unknown how long the boards have been warm."""

OVERSLEPT = "its time went by while the recorder ran: the computer slept, or what came before took too long"

Reporter = Callable[..., None]
FeaturesOf = Callable[[Shot], ShotFeatures]
NO_HELPERS = Helpers()

ASKED, ASKED_OVER = "asked", "asked_over"
"""Events: a person is asked to do something now; that is done, or too late."""


class Recorder:
    """Owns the line while a test runs."""

    def __init__(
        self,
        settings: Settings,
        archive: Archive,
        catalogue: RecorderCatalogue,
        rig: Rig,
        epoch_ns: int,
        *,
        live: LiveFigure,
        heartbeat: Heartbeat,
        stop: threading.Event,
        report: Reporter,
        features_of: FeaturesOf = features_of,
        unsupervised: threading.Event | None = None,
        helpers: Helpers = NO_HELPERS,
        mono_s: Callable[[], float] = time.monotonic,
        look_every_s: float = LOOK_EVERY_S,
        listen_every_s: float = LISTEN_EVERY_S,
        remote_drive: RemoteDrive | None = None,
    ) -> None:
        self._settings = settings
        self._catalogue = catalogue
        self._rig = rig
        self._epoch_ns = epoch_ns
        self._heartbeat = heartbeat
        self._stop = stop
        self._look_every_s = look_every_s
        self._report = report
        self._unsupervised = unsupervised or threading.Event()
        self._doing, self._request = "starting", ""
        self._newest: DueSet | None = None
        self._started_unscheduled: set[int] = set()
        self._calibrated_ns: int | None = None
        self._features_of = features_of_a_rehearsal if rig.dry_run else features_of
        self._archive = archive
        self._live = live
        # Simulated time has one frame on every computer.
        self._boot_id = "simulated" if settings.clock.kind == "simulated" else boot_id()
        self._plan = plan(settings.schedule.phases, epoch_ns, end_h=settings.schedule.end_h)
        self._provenance = provenance(settings, rig, experiment=catalogue.experiment_row())
        self._free_until_ns: float = -math.inf
        done = catalogue.committed_sets()
        self._open = dict(archive.open_sets())
        self._rowless_files = {
            index: file
            for index, file in archive.sets().items()
            if index not in done and index not in self._open
        }
        for opened in self._open.values():
            if opened.is_dated:
                refuse_foreign_open_set(opened, self._plan, archive.name)
        self._cost, self._machine = Cost(), helpers.machine
        self._set_assessor = SetAssessor(
            settings, archive, catalogue, rig, self._cost, remote_drive, news=report
        )
        self._persistence = Persistence(
            archive,
            catalogue,
            self._set_assessor,
            helpers,
            limit_bytes=settings.storage.memory_mb * 10**6,
            stop=stop,
            moment=self._moment,
            on_trouble=lambda: heartbeat.beat(self._doing_now()),
            look_every_s=look_every_s,
            mono_s=mono_s,
        )
        damage = archive.journal_damage
        where = f"its part of the journal was damaged: {', '.join(damage.files)}"
        self._corruption_of = dict.fromkeys(damage.sets, where)
        self._open = {
            index: opened if opened.is_dated else self._dated(opened) for index, opened in self._open.items()
        }
        for index in done & self._open.keys():
            opened = self._open.pop(index)
            if not opened.records:
                archive.settle(index)
            elif index in damage.sets:
                self._persistence.do(partial(self._end_again, opened))
            else:
                self._persistence.file(index)  # a corrupt frame is reported, the others stay
        sequences = [item.sequence + 1 for opened in self._open.values() for item in opened.records]
        known = [catalogue.next_sequence(), damage.next_sequence, *sequences]
        self._next_sequence = max(known) + damage.n_lost
        self._next_set = 0
        drive = self._set_assessor.drive
        test = RunningTest(
            clock=rig.clock,
            moment=self._moment,
            stop=stop,
            alarms=self._set_assessor.alarms,
            annotations=lambda: catalogue.rows(AnnotationRow),
            store=self._set_assessor.commit,
            reinstated=self._set_assessor.reinstated,
            confirmation=self._request_confirmation,
            settings=settings,
            next_set=lambda: self._next_set,
            baseline=catalogue.baseline,
            renewed=self._set_assessor.renewed,
            positions=settings.names_of(SOLITARY_WAVE),
            supply=drive if drive is not None and drive.has_supply else None,
        )
        adopt = self._set_assessor.adopt
        self._commands = CommandExecutor(catalogue, test, listen_every_s=listen_every_s, adopt=adopt)
        rig.asking.listen(self._report_request)

    def run(self, *, not_running_reason: str, opening: Opening | None = None) -> bool:
        """Take every set that is still due; return False after a stop.

        Parameters
        ----------
        opening
            What this recorder did before, while other sets may have fallen due.
        """
        done = self._catalogue.committed_sets()
        started = {
            "rig": self._rig.kind,
            "dry_run": self._rig.dry_run,
            "rig_identity": dict(self._rig.identity),
            "sets_done": len(done),
            "before": not_running_reason,
            "versions": self._provenance["versions"],
        }
        self._persistence.do(self._commands.begin)
        self._persistence.say("recorder_started", started)
        self._quarantine_corrupt_files()
        self._report("begun")
        absences = self._wait_for_a_set_clock(not_running_reason, opening)
        for number, due in enumerate(self._plan):
            if due.set_index in done:
                self._newest = due
                continue
            self._take_unscheduled(before=due)
            self._next_set = due.set_index + (
                due.set_index in self._open or due.set_index in self._rowless_files
            )
            if not (self._adopt_stored_set(due) or self._close_overdue(due, absences)):
                self._take_when_due(due)
            self._newest = due
            if not self._stop.is_set() and not self._in_real_time:
                self._persistence.wait_for_the_disk(self._idle)
                self._persistence.wait_for_the_worker(self._idle)
            if self._stop.is_set():
                break
            self._report("progress", done=number + 1, planned=len(self._plan), due_h=due.due_h)
        self._take_unscheduled()
        self._newest = None
        self._persistence.wait_for_the_disk(self._idle)
        self._persistence.wait_for_the_files(self._idle)
        finished = not self._stop.is_set()
        # A supervisor that was killed is no end of the test: the drive's process watches the supply.
        drive = None if self._unsupervised.is_set() else self._set_assessor.drive
        supply = "" if drive is None else drive.end()
        farewell = {"cost": self._cost.as_row(), **({"supply": supply} if supply else {})}
        stopped = "recorder_left_alone" if self._unsupervised.is_set() else "recorder_stopped"
        self._heartbeat.stage = "ended"
        self._doing = "leaving"
        self._heartbeat.beat(self._doing_now(), at_once=True)
        self._persistence.say("schedule_done" if finished else stopped, farewell)
        if finished:
            self._persistence.wait_for_the_disk(self._idle)
        return finished

    def linger(self) -> None:
        """Execute commands without striking until the stop."""
        self._doing = "waiting for orders; every set is taken"
        self._free_until_ns = math.inf
        while self._idle():
            self._stop.wait(self._look_every_s)

    def leave(self) -> None:
        """Answer the commands that were not started: the recorder has ended."""
        try:
            self._commands.close("the recorder has ended")
        except (StorageError, OSError) as error:
            log.warning("open orders are not answered; the next recorder does it: %s", error)
        self._persistence.leave()

    # One set -----------------------------------------------------------------------------------

    def _take_when_due(self, due: DueSet) -> None:
        self._calibrate_before(due)
        self._doing = f"waiting for set {due.set_index}"
        # Simulated time has no idle hours: there files are checked after the last set.
        self._free_until_ns = due.due_utc_ns if self._in_real_time else -math.inf
        while not self._rig.clock.wait_until(due.due_utc_ns, self._idle_unless_asked):
            if self._stop.is_set():
                return
            self._take_unscheduled(before=due)
            self._doing = f"waiting for set {due.set_index}"
        if self._close_overdue(due):
            return
        self._newest = due
        self._take_now(due)

    def _take_now(self, due: DueSet) -> None:
        if self._commands.held:
            self._record_gap(due, self._commands.held)
            return
        if self._persistence.trouble is not None and not self._persistence.has_room:
            self._record_gap(due, f"the memory for what waits is full: {self._persistence.trouble.message}")
            return
        self._announce(f"taking {_name_of(due)}")
        if due.position is None:
            self._next_set = due.set_index + 1
        taken = self._started_set(due)
        self._take(due, taken)
        if self._stays_open(taken):
            return
        if not taken.is_empty:
            self._persist_and_assess(due, taken)
        elif not self._stop.is_set():
            causes = {name: self._shortfall(name, taken) for name in self._places(due)}
            self._persistence.post(
                partial(self._set_assessor.nothing_taken, due, causes, utc_ns=taken.ended_ns, tried=taken)
            )
            self._archive.settle(due.set_index)
        # else: the set is still due after a restart
        if taken.trouble is not None and not self._is_transient(taken.trouble):
            raise RigError(
                f"set {due.set_index} ended early: {taken.trouble}; the {len(taken.shots)} shots before it "
                "are stored"
            ) from taken.trouble

    # Beside the plan -----------------------------------------------------------------------------

    def _take_unscheduled(self, *, before: DueSet | None = None) -> None:
        """Take the requested unscheduled sets that fit between scheduled sets."""
        for due in self._requested_sets():
            planned, _ = in_order(due.set_index)
            if self._stop.is_set() or (before is not None and planned >= before.set_index):
                continue
            self._started_unscheduled.add(due.set_index)
            if self._adopt_stored_set(due):
                continue
            if cause := self._no_time_for(due, self._plan[planned]):
                self._record_gap(due, cause)
            else:
                self._take_now(due)

    def _requested_sets(self) -> list[DueSet]:
        """List what waits, in the order of the sets; what is taken up waits for the disk at most."""
        asked = {index: one.due for index, one in self._set_assessor.confirmations.waiting.items()}
        for index, opened in self._open.items():
            if purpose_of(index) != "planned":  # its catalogue was lost, and who asked for it with that
                (position,) = (name for name in self._settings.positions if name not in opened.retired)
                due_h = (opened.due_utc_ns - self._epoch_ns) / NS_PER_H
                due = DueSet(set_index=index, due_h=due_h, due_utc_ns=opened.due_utc_ns, position=position)
                asked.setdefault(index, due)
        return [asked[index] for index in sorted(asked.keys() - self._started_unscheduled, key=in_order)]

    def _no_time_for(self, due: DueSet, planned: DueSet) -> str:
        """Return why an unscheduled set cannot be taken: late or transducer disabled; empty: it can."""
        assert due.position is not None, "it is beside the plan"
        if retired := self._set_assessor.retired().get(due.position):
            return retired
        now_ns = self._rig.clock.utc_ns()
        if now_ns > due.due_utc_ns + NS_PER_H:
            return self._persistence.hindered(due.due_utc_ns) or OVERSLEPT
        confirmations = self._set_assessor.confirmations
        return overlap_reason(confirmations.room_ns(planned, now_ns), confirmations.set_ns)

    def _request_confirmation(self, position: str, author: str, note: str) -> Transaction:
        """Request an unscheduled set by a person's command; it is taken when the line is free.

        Raises
        ------
        ValueError
            It cannot be taken, and why.
        """
        if self._newest is None:
            raise ValueError(
                "no planned set was taken yet, or none is left: nothing is struck beside the plan"
            )
        return self._set_assessor.order_confirmation(self._newest, position, author, note, self._moment())

    def _places(self, due: DueSet) -> list[str]:
        return list(self._settings.positions) if due.position is None else [due.position]

    def _not_of(self, due: DueSet) -> dict[str, str]:
        """Return the positions that an unscheduled set leaves out, with the reason."""
        return {
            name: f"a confirmation set of {due.position}"
            for name in self._settings.positions
            if due.position not in (None, name)
        }

    def _idle_unless_asked(self) -> bool:
        return self._idle() and not self._requested_sets()

    def _started_set(self, due: DueSet) -> TakenSet:
        """Begin a set, or take up one that the last recorder left open."""
        opened = self._open.pop(due.set_index, None)
        if opened is not None:
            self._archive.resume_set(opened)
            return self._restored(opened)
        taken = TakenSet(
            rule=self._restrike_rule(),
            # As it stands now: an order during the set changes what is struck, not what was planned.
            retired=self._set_assessor.retired() | self._not_of(due),
            started_ns=self._rig.clock.utc_ns(),
        )
        self._archive.begin_set(
            due.set_index,
            due_utc_ns=due.due_utc_ns,
            started_utc_ns=taken.started_ns,
            retired=taken.retired,
        )
        return taken

    def _restored(self, opened: OpenSet) -> TakenSet:
        taken = TakenSet(
            rule=self._restrike_rule(), retired=dict(opened.retired), started_ns=opened.started_utc_ns
        )
        taken.restore(opened)
        taken.features.update({shot.sequence: self._features_of(shot) for shot in taken.shots})
        taken.ended_ns = opened.last_utc_ns
        self._persistence.were_acknowledged(item.sequence for item in opened.records)
        log.warning("set %d goes on: %d records of it are there", opened.set_index, len(opened.records))
        return taken

    def _dated(self, opened: OpenSet) -> OpenSet:
        """Complete a set with a corrupt first frame from its rows or the schedule."""
        index = opened.set_index
        rows = self._catalogue.rows(SetRow, first_set=index, last_set=index, purpose="any")
        known = [row.due_utc_ns for row in rows] + [due.due_utc_ns for due in self._plan[index : index + 1]]
        struck = {item.key.position for item in (*opened.records, *opened.missed)}
        planned = purpose_of(index) == "planned"
        left_out = (
            self._set_assessor.retired()
            if planned
            else dict.fromkeys(self._settings.positions, "not asked for")
        )
        return replace(
            opened,
            due_utc_ns=known[0] if known else opened.due_utc_ns,
            retired={name: why for name, why in left_out.items() if name not in struck},
        )

    def _end_again(self, opened: OpenSet) -> None:
        """Let what is sound of a stored set get its file, though its end or records of it are damaged."""
        file = self._archive.sets().get(opened.set_index)
        if file is not None:
            record = self._archive.read_set(file, skip_damaged=True)
        else:
            due_h = (opened.due_utc_ns - self._epoch_ns) / NS_PER_H
            due = DueSet(set_index=opened.set_index, due_h=due_h, due_utc_ns=opened.due_utc_ns)
            record = self._record_of(due, self._restored(opened), self._corruption_of[opened.set_index])
        self._archive.resume_set(opened)
        self._archive.store_set(record)
        self._persistence.file(opened.set_index)

    def _restrike_rule(self) -> RestrikeRule:
        quality = self._settings.quality
        restrikes = 0 if self._rig.dry_run else quality.restrikes_per_set
        return RestrikeRule(flags=quality.restrike_flags, restrikes_per_set=restrikes)

    def _stays_open(self, taken: TakenSet) -> bool:
        """Leave a set that a stop cut short to the next recorder, whose shots the journal keeps."""
        planned = {name: self._set_assessor.n_planned(name) for name in self._settings.positions}
        cut = self._stop.is_set() and not self._commands.held and taken.trouble is None
        if not cut or taken.is_complete(planned):
            return False
        return self._persistence.acknowledge()

    def _take(self, due: DueSet, taken: TakenSet) -> None:
        """Strike and read; every measurement before an error is kept."""
        set_plan = SetPlan(
            due=due,
            positions={
                name: place.method
                for name, place in self._settings.positions.items()
                if name not in taken.retired
            },
            shots_per_set=self._settings.schedule.shots_per_set,
            shot_interval_s=self._settings.schedule.shot_interval_s,
            read_timeout_s=self._settings.rig.read_timeout_s,
        )
        measurements = take_set(
            self._rig,
            set_plan,
            progress=taken.progress(self._settings.names_of(SOLITARY_WAVE))
            if taken.progress(()).tried
            else None,
            first_sequence=self._next_sequence,
            boot_id=self._boot_id,
            idle=self._idle_in_a_set,
            wants_restrike=taken.wants_restrike,
            may_strike=lambda position: position not in self._set_assessor.retired(),
        )
        try:
            while True:
                with self._cost.of("strike_and_read_s"):
                    measurement = next(measurements, None)
                if measurement is None:
                    break
                self._keep(measurement, taken, due)
        except InstrumentError as error:
            log.exception("set %d: the rig failed", due.set_index)
            taken.trouble = error
        taken.ended_ns = self._rig.clock.utc_ns()

    def _keep(self, measurement: Measurement, taken: TakenSet, due: DueSet) -> None:
        taken.keep(measurement)
        if isinstance(measurement, MissedShot):
            self._archive.append(taken.missed_records()[-1], self._rig.clock.utc_ns())
            return
        self._archive.append(measurement, measurement.stamp.utc_ns)
        if self._settings.clock.kind == "wall":  # simulated time has no crash between two shots
            self._persistence.acknowledge()
        if isinstance(measurement, Shot):
            with self._cost.of("extract_s"):
                taken.features[measurement.sequence] = self._features_of(measurement)
        if self._live.due(measurement.key.position):
            self._live.show(measurement, due_h=due.due_h, features=taken.features.get(measurement.sequence))

    def _persist_and_assess(self, due: DueSet, taken: TakenSet, *, cut_short_reason: str = "") -> None:
        """Make a set durable, then assess it: no shot is reported that a power cut could lose."""
        self._announce(f"storing {_name_of(due)}")
        record = self._record_of(due, taken, self._corruption_of.get(due.set_index, cut_short_reason))
        self._next_sequence = max(self._next_sequence, *(item.sequence + 1 for item in record.records))
        # Now, and not when the disk takes the set.
        machine = None if self._machine is None else self._machine.read(self._cost)

        def assess() -> Transaction:
            stored = self._persistence.store(record)
            self._cost.sets += 1
            for stage, seconds in asdict(stored.timings).items():
                self._cost.seconds[stage] += seconds
            self._doing = f"judging {_name_of(due)}"
            transaction = self._set_assessor.assessed(due, record, stored.file, taken.features)
            if machine is not None and due.position is None:
                moment = Moment(utc_ns=record.ended_utc_ns, due_h=due.due_h, set_index=due.set_index)
                transaction.add_event(MACHINE_READ, machine, moment, topic="machine")
            return transaction

        n_bytes = sum(item.waveform.counts.nbytes for item in record.records)
        self._persistence.post(assess, n_bytes=n_bytes, stored=due.set_index)

    def _record_of(self, due: DueSet, taken: TakenSet, cut_short_reason: str) -> SetRecord:
        return SetRecord(
            set_index=due.set_index,
            due_utc_ns=due.due_utc_ns,
            due_h=due.due_h,
            started_utc_ns=taken.started_ns,
            ended_utc_ns=taken.ended_ns,
            rig_kind=self._rig.kind,
            positions=self._position_records(taken, cut_short_reason),
            shots=taken.shots,
            echoes=taken.echoes,
            missed=taken.missed_records(),
            outcomes=taken.superseded(),
            trouble=taken.instrument_error(),
            environment={} if self._set_assessor.drive is None else self._set_assessor.drive.summary(),
            provenance=self._provenance,
        )

    def _calibrate_before(self, due: DueSet) -> None:
        """Let the boards calibrate themselves between sets, as often as configured."""
        self_calibrating, interval_h = self._rig.self_calibrating, self._rig.self_calibration_interval_h
        if self_calibrating is None or not interval_h:
            return
        now_ns = self._rig.clock.utc_ns()
        age_h = math.inf if self._calibrated_ns is None else (now_ns - self._calibrated_ns) / NS_PER_H
        has_time = due.due_utc_ns - now_ns > SELF_CALIBRATION_TAKES_NS or self._calibrated_ns is None
        if age_h < interval_h or not has_time:
            return
        self._announce(f"self-calibration before set {due.set_index}")
        try:
            result = self_calibrating.self_calibrate()
        except InstrumentError as error:
            if not self._is_transient(error):
                raise RigError(f"self-calibration before set {due.set_index} failed: {error}") from error
            log.warning("self-calibration before set %d failed: %s", due.set_index, error)
            result = {"failed": str(error)}
        self._calibrated_ns = now_ns
        self._persistence.say("self_calibrated", dict(result))

    def _position_records(self, taken: TakenSet, cut_short_reason: str) -> list[PositionRecord]:
        return [
            PositionRecord(
                position=name,
                method=place.method,
                n_planned=self._set_assessor.n_planned(name),
                cause=self._shortfall(name, taken, cut_short_reason),
                label=place.label,
                serial_number=place.serial_number,
            )
            for name, place in self._settings.positions.items()
            if name not in taken.retired
        ]

    def _shortfall(self, position: str, taken: TakenSet, cut_short_reason: str = "") -> str:
        no_more_reason = (
            cut_short_reason
            or self._set_assessor.retired().get(position)
            or self._commands.held
            or "the recorder was told to stop"
        )
        return taken.shortfall(position, self._set_assessor.n_planned(position), no_more_reason)

    def _is_transient(self, trouble: InstrumentError) -> bool:
        """Whether the next set may go better.

        A board that is busy or gone may be free or back by then; of one that has taken a whole set here
        nothing is believed for good.
        """
        return self._set_assessor.proven or isinstance(trouble, BusyError | ConnectionLostError)

    # Sets that were taken already, or cannot be taken any more -----------------------------------

    def _adopt_stored_set(self, due: DueSet) -> bool:
        """Take over a file without rows: the last recorder died between rename and commit."""
        file = self._rowless_files.get(due.set_index)
        if file is None:
            return False
        record = self._archive.read_set(file)
        features = {shot.sequence: self._features_of(shot) for shot in record.shots}
        sha256 = self._archive.digest(file)
        assess = partial(self._set_assessor.assessed, due, record, file, features, sha256=sha256)
        self._persistence.post(assess)
        if sha256 is None:  # it is still in the journal
            self._persistence.do(partial(self._persistence.file, due.set_index))
        self._next_sequence = max([self._next_sequence, *(item.sequence + 1 for item in record.records)])
        log.warning("set %d: rows made again from %s/%s", due.set_index, self._archive.name, file)
        # Simulated time goes on where that set ended; the wall clock is past it anyway.
        self._rig.clock.wait_until(record.ended_utc_ns, self._idle)
        return True

    def _quarantine_corrupt_files(self) -> None:
        """Let no damaged file without rows block the start: its set is due again, or missed."""
        for set_index, file in list(self._rowless_files.items()):
            try:
                why = foreign_reason(self._archive.read_set(file), self._catalogue.experiment_row())
                refuse_foreign([f"{file}: {why}"] if why else [], self._archive.name)
            except CorruptArchiveError as error:
                log.error("set %d is set aside: %s", set_index, error)
                self._archive.set_aside(file)
                del self._rowless_files[set_index]
                self._corruption_of[set_index] = f"its file was damaged and is set aside ({error})"
        self._persistence.start_verification()

    def _close_overdue(self, due: DueSet, absences: Sequence[tuple[int, str]] = ()) -> bool:
        """Close a set whose time is over, since the next one is due.

        Parameters
        ----------
        absences
            Until when (ns of UTC) sets were missed for what reason, in order.
        """
        following = self._plan[due.set_index + 1 : due.set_index + 2]
        over_ns = following[0].due_utc_ns if following else due.due_utc_ns + NS_PER_H
        if self._rig.clock.utc_ns() < over_ns:
            return False
        cause = next((why for until_ns, why in absences if due.due_utc_ns <= until_ns), "")
        self._record_gap(due, cause or self._persistence.hindered(due.due_utc_ns) or OVERSLEPT)
        return True

    def _record_gap(self, due: DueSet, cause: str) -> None:
        """Take no strike of a set: store what an open one holds, else write gap rows."""
        cause = self._corruption_of.get(due.set_index, cause)
        opened = self._open.pop(due.set_index, None)
        if opened is not None and opened.records:
            self._archive.resume_set(opened)
            self._persist_and_assess(due, self._restored(opened), cut_short_reason=cause)
            return
        self._archive.settle(due.set_index)
        causes = dict.fromkeys(self._places(due), cause)
        utc_ns = self._rig.clock.utc_ns()
        self._persistence.post(partial(self._set_assessor.nothing_taken, due, causes, utc_ns=utc_ns))

    # A clock that cannot be believed, or is set ---------------------------------------------------

    def _wait_for_a_set_clock(
        self, not_running_reason: str, opening: Opening | None
    ) -> list[tuple[int, str]]:
        """Let time stand still while it is doubted; why sets were missed until when (ns of UTC), in order."""
        clock, reasons = self._rig.clock, list[str]()
        if not isinstance(clock, WallClock):
            return [(clock.utc_ns(), not_running_reason)]

        def idle(reason: str) -> bool:
            if not reasons:
                log.error("waiting for a set clock: %s", reason)
                self._report_clock(reason)
            reasons.append(reason)
            self._doing = f"waiting for a set clock: {reason}"
            return self._idle()

        began_ns = clock.mono_ns()
        believed = clock.wait_while_doubted(idle)
        if self._stop.is_set():
            return []
        if believed is not None:
            log.warning("%s", believed.message)
            self._persistence.say(CLOCK_BELIEVED, asdict(believed))
        self._report_clock("")
        now_ns, waited = clock.utc_ns(), f"the recorder waited for a set clock: {''.join(reasons[:1])}"
        offset_ns = now_ns - clock.mono_ns()
        opened = [(offset_ns + began_ns, not_running_reason)]
        if opening is not None:
            opened = [(offset_ns + opening.since_mono_ns, not_running_reason), (opened[0][0], opening.text)]
        return [*opened, (now_ns, waited)]

    def _report_clock(self, doubt: str) -> None:
        self._persistence.do(partial(self._set_assessor.update_alarm, doubt_condition(doubt), self._moment()))

    def _report_clock_steps(self) -> None:
        if isinstance(self._rig.clock, WallClock):
            for step in self._rig.clock.steps():
                log.warning("%s", step.message)
                self._persistence.say(CLOCK_STEP, asdict(step))

    # A person who strikes ------------------------------------------------------------------------

    def _report_request(self, text: str, key: ShotKey | None) -> None:
        """Pass on what an instrument asks a person to do now; an empty text: nothing any more."""
        self._request = text and f"waiting for a person: {text}"
        # The record is waited for from here on, as long as the heartbeat's deadline allows.
        self._heartbeat.beat(self._doing_now(), at_once=True)
        if not text:
            self._persistence.say(ASKED_OVER, {})
            self._report(ASKED_OVER)
            return
        shot = {} if key is None else asdict(key)
        asked = {"text": text, **shot, "within_s": self._settings.rig.read_timeout_s}
        self._persistence.say(ASKED, asked)
        self._report(ASKED, **asked)

    # Operator and supervisor ---------------------------------------------------------------------

    @property
    def _in_real_time(self) -> bool:
        """Strike on while sets wait in memory: only real time goes on without us."""
        return self._settings.clock.kind == "wall"

    def _doing_now(self) -> str:
        return "; ".join(filter(None, (self._doing, self._request, self._persistence.waiting)))

    def _announce(self, doing: str) -> None:
        """Report an activity at once: if it hangs, the supervisor can name it."""
        self._doing = doing
        self._heartbeat.beat(self._doing_now())

    def _idle(self) -> bool:
        """Run the background work between sets."""
        self._persistence.work((self._free_until_ns - self._rig.clock.utc_ns()) / NS_PER_S)
        return self._beat_and_listen()

    def _idle_in_a_set(self) -> bool:
        """Between strikes: an operator's hold means hands in the rig, so the next strike must not come."""
        return self._beat_and_listen() and not self._commands.held

    def _beat_and_listen(self) -> bool:
        """Beat and listen, while waiting and between shots: nothing else advances the heartbeat."""
        self._report_clock_steps()
        self._persistence.watch_web()
        self._persistence.watch_disk()
        self._heartbeat.beat(self._doing_now())
        if self._persistence.trouble is None:
            self._persistence.do(self._listen)
        else:
            with suppress(*PASSING):  # the trouble is reported; a pause takes effect once it is readable
                self._listen()
        if self._set_assessor.drive is not None:
            self._set_assessor.drive.tick(self._hour())
        return not self._stop.is_set()

    def _listen(self) -> None:
        self._commands.listen()
        self._set_assessor.expire_shelves(self._moment())

    def _moment(self) -> Moment:
        return Moment(utc_ns=self._rig.clock.utc_ns(), due_h=self._hour(), set_index=None)

    def _hour(self) -> float:
        return (self._rig.clock.utc_ns() - self._epoch_ns) / NS_PER_H


def _name_of(due: DueSet) -> str:
    return f"set {due.set_index}" if due.position is None else f"a confirmation set at {due.position}"
