"""Begin a set, strike and read, keep each measurement, act between shots, and make the record of the set."""

from __future__ import annotations

import logging
import math
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field

from analysis.waves.features import ShotFeatures
from analysis.waves.quality_gate import SUPERSEDED, Attempt, RestrikeRule, decide_outcomes
from daq_service.acquisition.shot_features import FeaturesOf, choose_extraction
from daq_service.archive import PositionRecord, SetRecord
from daq_service.clock import WallClock, read_boot_id
from daq_service.commands.execution import CommandExecutor
from daq_service.recording.persistence import Persistence
from daq_service.recording.provenance import build_provenance
from daq_service.recording.resources import Resources
from daq_service.recording.resumed_time import CLOCK_STEP
from daq_service.recording.set_assessor import SetAssessor
from hardware_drivers.errors import InstrumentError
from hardware_drivers.measurement import DueSet, Measurement, MissedShot, PulseEchoRecord, Shot
from hardware_drivers.methods import SOLITARY_WAVE
from hardware_drivers.take_set import ProgressOfSet, SetPlan, take_set

log = logging.getLogger(__name__)


@dataclass(slots=True, kw_only=True, eq=False)
class TakenSet:
    """Records, misses and features of the current set, and the results of the quality check.

    Attributes
    ----------
    disabled
        Positions that were left out from the start, with the reason.
    features
        Features of each shot by its sequence.
    trouble
        Instrument error that ended the set; None: it was completed or stopped.
    """

    rule: RestrikeRule
    disabled: Mapping[str, str] = field(default_factory=dict)
    shots: list[Shot] = field(default_factory=list)
    echoes: list[PulseEchoRecord] = field(default_factory=list)
    missed: list[MissedShot] = field(default_factory=list)
    features: dict[int, ShotFeatures] = field(default_factory=dict)
    restrikes: Counter[str] = field(default_factory=Counter)
    trouble: InstrumentError | None = None
    started_ns: int = 0
    ended_ns: int = 0

    @property
    def tried(self) -> list[Measurement]:
        """Return every attempt, with or without a record, in order: shots, then echoes, then missed ones."""
        return [*self.shots, *self.echoes, *self.missed]

    def progress(self, struck: Collection[str]) -> ProgressOfSet:
        """Build the progress of the set: its start, the tried shots and the number of strikes.

        ``struck`` names the positions that have strikers: only there attempts are strikes.
        """
        keys = [item.key for item in self.tried]
        return ProgressOfSet(
            started_ns=self.started_ns,
            tried=frozenset((key.position, key.shot_index) for key in keys),
            n_strikes=sum(key.position in struck for key in keys),
        )

    def is_complete(self, planned: Mapping[str, int]) -> bool:
        """Return whether every planned shot was tried, with or without a record.

        ``planned`` has the number of shots by position; positions that were left out are ignored.
        """
        n_tried = Counter(position for position, _ in self.progress(()).tried)
        return all(n_tried[position] >= n for position, n in planned.items() if position not in self.disabled)

    def keep(self, measurement: Measurement) -> None:
        """Add a measurement to its list in memory, and log a missed one as a warning.

        A shot's features are added separately (`features`).
        """
        if isinstance(measurement, MissedShot):
            log.warning("%s: %s", measurement.key, measurement.cause)
            self.missed.append(measurement)
        elif isinstance(measurement, Shot):
            self.shots.append(measurement)
        else:
            self.echoes.append(measurement)

    def decide_restrike(self, taken: Shot | MissedShot) -> bool:
        """Return whether the quality check repeats a strike; if so, count and log the repetition.

        Raises KeyError for a shot whose features were not added.
        """
        position = taken.key.position
        flags = ("missed",) if isinstance(taken, MissedShot) else self.features[taken.sequence].flags
        granted = self.rule.wants(flags, attempt=taken.key.attempt, restrikes_so_far=self.restrikes[position])
        if granted:
            self.restrikes[position] += 1
            log.info("%s is %s: struck again", taken.key, ", ".join(flags))
        return granted

    @property
    def is_empty(self) -> bool:
        """Return whether the set has no record, neither a shot nor a pulse echo."""
        return not self.shots and not self.echoes

    def n_records(self, position: str) -> int:
        """Count the shots of a position that have a record, each once, or its pulse-echo records."""
        return len(
            {item.key.shot_index for item in (*self.shots, *self.echoes) if item.key.position == position}
        )

    def find_shortfall(self, position: str, n_planned: int, stop_reason: str) -> str:
        """Return why a position has fewer records than planned, as one text; empty if it has all.

        Parameters
        ----------
        stop_reason
            Why the set was ended without an instrument error.
        """
        if self.n_records(position) >= n_planned:
            return ""
        ended_by = stop_reason if self.trouble is None else str(self.trouble)
        missed = [item for item in self.missed if item.key.position == position]
        tried = {item.key.shot_index for item in self.tried if item.key.position == position}
        causes = [ended_by] if len(tried) < n_planned else []
        if missed and missed[0].cause not in causes:
            causes.append(f"{len(missed)} missed: {missed[0].cause}")
        return "; ".join(causes)

    def format_error(self) -> str:
        """Format the instrument error in the archive's form, ``class: message``; empty if there was none.

        The class is the one that all drivers share, not a driver's own.
        """
        if self.trouble is None:
            return ""
        # A driver may raise a subclass; the archive stores the class that all drivers share.
        kinds = (kind for kind in type(self.trouble).__mro__ if kind.__module__ == InstrumentError.__module__)
        return f"{next(kinds).__name__}: {self.trouble}"

    def find_superseded_shots(self) -> dict[int, str]:
        """Find the shots that a repetition replaces; return the outcome "superseded" by their sequence.

        Raises KeyError for a shot whose features were not added.
        """
        attempts = [
            Attempt(
                shot=(shot.key.position, shot.key.shot_index),
                attempt=shot.key.attempt,
                quality=self.features[shot.sequence].quality,
            )
            for shot in self.shots
        ]
        found = zip(self.shots, decide_outcomes(attempts), strict=True)
        return {shot.sequence: outcome for shot, outcome in found if outcome == SUPERSEDED}


class Activity:
    """What the recorder does, as its heartbeat shows it, and what it looks at between two shots.

    Attributes
    ----------
    doing
        What the recorder does; the next beat shows it.
    request
        What an instrument asks a person to do now; empty: nothing.
    looks
        Called a few times a second, such as for commands.
    """

    def __init__(self, resources: Resources, assessor: SetAssessor, persistence: Persistence) -> None:
        """Start with the activity "starting", without a request and without ``looks``."""
        self._resources, self._set_assessor, self._persistence = resources, assessor, persistence
        self.doing, self.request, self._look_again_s = "starting", "", -math.inf
        self.looks: Sequence[Callable[[], None]] = ()

    def beat(self, *, at_once: bool = False) -> None:
        """Write the heartbeat: activity, request to a person, and jobs that wait for the disk.

        ``at_once`` True writes it even if the last beat is recent.
        """
        waits, trouble = "", self._persistence.trouble
        if trouble is not None:
            waits = f"{len(self._persistence)} jobs wait in memory for the disk: {trouble.message}"
        parts = (self.doing, self.request, waits)
        self._resources.heartbeat.beat("; ".join(filter(None, parts)), at_once=at_once)

    def announce(self, doing: str) -> None:
        """Set the activity and write it to the heartbeat, which names it if the recorder hangs."""
        self.doing = doing
        self.beat()

    def run_between_shots(self) -> bool:
        """Write the heartbeat, check clock, disk, supply and requests; return False if the recorder stops.

        Steps of the clock are logged and stored as events; ``looks`` are called at most every
        ``Host.listen_every_s`` (0.2 s).
        """
        clock, disk, drive = self._resources.rig.clock, self._resources.disk, self._set_assessor.drive
        if isinstance(clock, WallClock):
            for clock_step in clock.steps():
                log.warning("%s", clock_step.message)
                self._persistence.say(CLOCK_STEP, asdict(clock_step))
        if disk is not None:
            disk.run_for(0.0)
        self.beat()
        now_s = time.monotonic()
        if now_s >= self._look_again_s:
            self._look_again_s = now_s + self._resources.host.listen_every_s
            for look in self.looks:
                look()
        if drive is not None:
            drive.tick(self._resources.moment().due_h)
        return not self._resources.stop.is_set()


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
        features_of: FeaturesOf | None,
        commands: CommandExecutor,
        activity: Activity,
    ) -> None:
        """Keep the parts of the recorder and build the provenance of its sets.

        Raises CatalogueError if the experiment cannot be read.
        """
        self._settings, self._rig = resources.settings, resources.rig
        self._archive, self._live = resources.archive, resources.live
        self._set_assessor, self._persistence = assessor, persistence
        self._commands, self._activity = commands, activity
        self._struck = self._settings.list_positions(SOLITARY_WAVE)
        self.features_of = choose_extraction(
            self._settings.positions, rehearsal=self._rig.dry_run, given=features_of
        )
        # Simulated time has one frame on every computer.
        self._in_real_time = resources.in_real_time
        self._boot_id = read_boot_id() if self._in_real_time else "simulated"
        self.provenance = build_provenance(
            self._settings, self._rig, experiment=resources.catalogue.read_experiment()
        )
        self.next_sequence = 0

    # Before the first strike ----------------------------------------------------------------------

    def begin(self, due: DueSet) -> TakenSet:
        """Start a set now and add its start to the journal, durable with the next sync; return the empty set.

        Disabled positions are left out, of a confirmation set also all positions but its own.
        """
        left_out = {
            name: f"a confirmation set of {due.position}"
            for name in self._settings.positions
            if due.position not in (None, name)
        }
        taken = TakenSet(
            rule=self.select_restrike_rule(),
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

    def select_restrike_rule(self) -> RestrikeRule:
        """Build the rule by which the quality check repeats shots; a rehearsal repeats none."""
        quality = self._settings.quality
        restrikes = 0 if self._rig.dry_run else quality.restrikes_per_set
        return RestrikeRule(flags=quality.restrike_flags, restrikes_per_set=restrikes)

    # Strike by strike -----------------------------------------------------------------------------

    def acquire_measurements(self, due: DueSet, taken: TakenSet) -> Iterator[Measurement]:
        """Strike and read; yield each measurement of a set, and nothing more after a stop or a pause.

        An instrument error ends the set: it is logged and kept as ``taken.trouble``. The end time is set
        then.
        """
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
            progress=taken.progress(self._struck) if taken.tried else None,
            first_sequence=self.next_sequence,
            boot_id=self._boot_id,
            idle=lambda: self._activity.run_between_shots() and not self._commands.paused,
            wants_restrike=taken.decide_restrike,
            may_strike=lambda position: position not in self._set_assessor.disabled(),
        )
        try:
            yield from measurements
        except InstrumentError as error:
            log.exception("set %s: the rig failed", due.set_key)
            taken.trouble = error
        taken.ended_ns = self._rig.clock.utc_ns()

    def keep(self, measurement: Measurement, taken: TakenSet) -> None:
        """Add a measurement to the set and the journal; in real time also acknowledge it.

        A refusing disk is not raised: the acknowledgement is retried later.
        """
        taken.keep(measurement)
        if isinstance(measurement, MissedShot):
            self._archive.append(measurement, self._rig.clock.utc_ns())
            return
        self._archive.append(measurement, measurement.stamp.utc_ns)
        if self._in_real_time:  # simulated time has no crash between two shots
            self._persistence.acknowledge()

    def extract(self, measurement: Measurement, due: DueSet, taken: TakenSet) -> None:
        """Extract and add the features of a shot; show its waveform in the live figure, if it is due there.

        A missed record is ignored.
        """
        if isinstance(measurement, MissedShot):
            return
        if isinstance(measurement, Shot):
            taken.features[measurement.sequence] = self.features_of(measurement)
        if self._live.due(measurement.key.position):
            features = taken.features.get(measurement.sequence)
            self._live.show(measurement, due_h=due.due_h, features=features)

    # After the last strike ------------------------------------------------------------------------

    def find_shortfall(self, position: str, taken: TakenSet, cut_short_reason: str = "") -> str:
        """Return why a position has fewer records than planned, as one text; empty if it has all.

        An instrument error is named first. Else it is ``cut_short_reason``, or if that is empty a disabled
        position, a pause, or the stop of the recorder; missed records are added.
        """
        end_reason = (
            cut_short_reason
            or self._set_assessor.disabled().get(position)
            or self._commands.paused
            or "the recorder received a stop request"
        )
        return taken.find_shortfall(position, self._set_assessor.n_planned[position], end_reason)

    def find_shortfalls(self, due: DueSet, taken: TakenSet) -> dict[str, str]:
        """Return by position why a set has fewer records than planned there; "" if it has all."""
        return {name: self.find_shortfall(name, taken) for name in self._set_assessor.list_set_positions(due)}

    def record_of(self, due: DueSet, taken: TakenSet, cut_short_reason: str) -> SetRecord:
        """Build the record of a set that is to be stored, without the positions that were left out.

        ``cut_short_reason`` explains missing records; if it is empty, the state of position, test and
        recorder does. Reads the supply and climate values of the drive, if there is one.
        """
        positions = [
            PositionRecord(
                position=name,
                method=place.method,
                n_planned=self._set_assessor.n_planned[name],
                cause=self.find_shortfall(name, taken, cut_short_reason),
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
            missed=taken.missed,
            outcomes=taken.find_superseded_shots(),
            trouble=taken.format_error(),
            environment={}
            if self._set_assessor.drive is None
            else self._set_assessor.drive.summarise_readings(),
            provenance=self.provenance,
        )

    def advance_next_shot_number(self, record: SetRecord) -> None:
        """Raise the sequence number for the next shot above those of a record; it never decreases."""
        self.next_sequence = max([self.next_sequence, *(item.sequence + 1 for item in record.records)])
