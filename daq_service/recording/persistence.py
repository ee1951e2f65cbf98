"""Make shots and sets durable, acknowledge them and retry what the disk refuses; report all trouble."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from daq_service.alarms.data_trouble import damage_condition, space_condition, storage_condition
from daq_service.alarms.process_trouble import web_condition
from daq_service.alarms.states import Condition, Moment
from daq_service.archive import Archive, SetRecord, StoredSet
from daq_service.assessment.transaction import Transaction
from daq_service.background.finalize_sets import SetFinalizer
from daq_service.background.live_figure import LiveFigure
from daq_service.background.tiles import TileMaker
from daq_service.background.verification import IdleVerification
from daq_service.background.write_retry_queue import PASSING, Trouble, WriteRetryQueue
from daq_service.catalogue import RecorderCatalogue
from daq_service.catalogue.history import HistoryFollower
from daq_service.corrosion_drive.remote import RemoteDrive
from daq_service.processes.disk_policy import DiskWatch
from daq_service.processes.heartbeat import Heartbeat, WebWatch
from daq_service.recording.computer_load import ComputerLoadWatch
from daq_service.recording.host import Host
from daq_service.recording.set_assessor import SetAssessor

log = logging.getLogger(__name__)

WAIT_FOR_FILES_S = 60.0
"""A file takes some hundredths of a second; where it takes this long, the journal keeps its set."""
MOST_UNDER_WAY = 40
"""Whole sets whose files are being made: two segments of the journal."""
OVERSLEPT = "its time went by while the recorder ran: the computer slept, or what came before took too long"

DISK_SPACE = "disk_space"
"""Event at each change of how much of the volume is free (`disk_policy.LEVELS`)."""

Idle = Callable[[], bool]
"""Beats, listens to the operator and lets what waits be stored; False when the recorder shall stop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stores:
    """What the recorder writes to in its data folder."""

    archive: Archive
    catalogue: RecorderCatalogue
    live: LiveFigure
    heartbeat: Heartbeat


@dataclass(frozen=True, slots=True, kw_only=True)
class Helpers:
    """Work between sets; each part is optional.

    Attributes
    ----------
    compaction
        Gives sets of the journal their files.
    idle_check
        Reads stored sets while nothing is due.
    tiling
        Adds sets to the tiles of the waterfall.
    history
        Follows the catalogue, so that it can be made again.
    disk
        Watches the volume.
    machine
        Reads with each set what the test costs its computer.
    web
        Watches the web service of the folder.
    remote_drive
        The supply in a process of its own; None: the rig's supply, where it has one, is driven here.
    acknowledged
        Called with the id of each shot (`Shot.sequence`) once it is durable.
    """

    compaction: SetFinalizer | None = None
    idle_check: IdleVerification | None = None
    tiling: TileMaker | None = None
    history: HistoryFollower | None = None
    disk: DiskWatch | None = None
    machine: ComputerLoadWatch | None = None
    web: WebWatch | None = None
    remote_drive: RemoteDrive | None = None
    acknowledged: Callable[[int], None] = lambda shot_id: None


class Persistence:
    """Where the recorder leaves what it has taken.

    Parameters
    ----------
    limit_bytes
        Memory that sets may take while no disk takes them.
    moment
        Now, for alarms and events.
    on_trouble
        Called when the disk begins or ceases to refuse.
    """

    def __init__(
        self,
        stores: Stores,
        assessor: SetAssessor,
        helpers: Helpers,
        *,
        limit_bytes: int,
        stop: threading.Event,
        moment: Callable[[], Moment],
        on_trouble: Callable[[], None],
        host: Host,
    ) -> None:
        self._archive, self._catalogue, self._set_assessor = stores.archive, stores.catalogue, assessor
        self._finalizer, self._verification = helpers.compaction, helpers.idle_check
        self._tiles = helpers.tiling
        self._history, self._disk, self._acknowledged = helpers.history, helpers.disk, helpers.acknowledged
        self._stop, self._moment, self._mono_s = stop, moment, host.mono_s
        self._notify_trouble, self._look_every_s = on_trouble, host.look_every_s
        self._web = helpers.web
        self._web_is_missing: bool | None = None
        self._reported_ids: set[int] = set()
        self._reported_corruption: dict[str, str] = {}
        self._reported_trouble = self._reported_finalizing = ""
        self._trouble_until_ns = -1
        self._retry_queue = WriteRetryQueue(
            limit_bytes=limit_bytes,
            on_change=self._report_trouble,
            refusal=self._refusal,
            mono_s=host.mono_s,
        )

    @property
    def trouble(self) -> Trouble | None:
        """Why the disk takes nothing; None: it does."""
        return self._retry_queue.trouble

    @property
    def has_room(self) -> bool:
        """Whether another set may be taken."""
        return self._retry_queue.has_room

    @property
    def waiting(self) -> str:
        """What waits for the disk, in words; empty: nothing."""
        if self.trouble is None:
            return ""
        return f"{len(self._retry_queue)} jobs wait in memory for the disk: {self.trouble.message}"

    def overdue_reason(self, due_utc_ns: int) -> str:
        """State why the time of a set went by: the disk or the catalogue refused, or the computer slept."""
        is_over = self.trouble is None and self._trouble_until_ns < due_utc_ns
        return OVERSLEPT if is_over else f"the recorder waited for the disk: {self._reported_trouble}"

    # Shots and sets -------------------------------------------------------------------------------

    def acknowledge(self) -> bool:
        """Make shots durable and report their ids; if the disk refuses, report that and retry."""
        if self._refusal():
            return False
        try:
            self._sync()
        except PASSING as error:
            log.warning("not acknowledged yet: %s", error)
            if self.trouble is None:  # the retry must not wait for the end of the set
                self._retry_queue.put(self._sync)
            return False
        return True

    def _sync(self) -> None:
        self._report_ids(self._archive.sync())

    def _report_ids(self, shot_ids: Iterable[int]) -> None:
        for shot_id in shot_ids:
            if shot_id not in self._reported_ids:
                self._reported_ids.add(shot_id)
                self._acknowledged(shot_id)

    def were_acknowledged(self, shot_ids: Iterable[int]) -> None:
        """Skip the report of shots that an earlier recorder has acknowledged."""
        self._reported_ids.update(shot_ids)

    def store(self, record: SetRecord) -> StoredSet:
        """Make a complete set durable and report the ids of its shots."""
        stored = self._archive.store_set(record)
        self._report_ids(stored.crc32)
        self._reported_ids.difference_update(stored.crc32)
        return stored

    def post(
        self,
        build: Callable[[], Transaction],
        *then: Callable[[Transaction], None],
        n_bytes: int = 0,
    ) -> None:
        """Build a transaction once and pass it on, in order; repeat the latter until the disk takes it."""
        built: list[Transaction] = []

        def job() -> None:
            if not built:
                built.append(build())
            for pass_on in then:
                pass_on(built[0])

        self._retry_queue.put(job, n_bytes=n_bytes)

    def file(self, set_index: int) -> None:
        """Have a whole set of the journal get its file."""
        if self._finalizer is not None:
            self._finalizer.put(set_index)

    def do(self, job: Callable[[], None]) -> None:
        """Do something that the disk may refuse, when all before it is done."""
        self._retry_queue.put(job)

    def say(self, kind: str, payload: Mapping[str, Any]) -> None:
        """Append an event of the service."""
        utc_ns = self._moment().utc_ns

        def job() -> None:
            self._catalogue.add_event(utc_ns=utc_ns, topic="service", kind=kind, payload=payload)

        self._retry_queue.put(job)

    # While the line is idle -----------------------------------------------------------------------

    def work(self, free_s: float) -> None:
        """Store what waits, make files, follow the history, and read stored sets if there is time.

        Parameters
        ----------
        free_s
            Time until the next set is due.
        """
        self._retry_queue.work()
        if self._finalizer is not None:
            self._finalizer.work()
            self._report_finalizing(self._finalizer.trouble)
        if self._history is not None:
            self._history.follow()
        if self._verification is not None and self.trouble is None:
            self._verification.work(free_s)
        if self.trouble is None:
            self._report_corruption()
        if self._tiles is not None:
            self._tiles.work(free_s)

    def start_verification(self) -> None:
        """Find stored sets that are missing; report them and the files in quarantine."""
        if self._verification is not None:
            alarm = self._set_assessor.alarms.get((None, "data_damaged"))
            stands = alarm is not None and alarm.state in ("unacknowledged", "acknowledged")
            self._verification.begin(alarm.proof.get("damaged", {}) if alarm and stands else {})
        self._report_corruption(at_the_start=True)

    def wait_for_the_disk(self, idle: Idle) -> None:
        """Let nothing go on before everything is stored, but a stop."""
        while self.trouble is not None and idle():
            self._stop.wait(self._look_every_s)
        if self.trouble is not None and self._disk is not None:
            self._disk.free_reserve()
            self._retry_queue.work(at_once=True)
        if self.trouble is not None:
            log.error("%d jobs are lost that no disk took: %s", len(self._retry_queue), self.trouble.message)

    def wait_for_the_worker(self, idle: Idle) -> None:
        """Let no simulated time outrun the files: journal and memory would grow with the test."""
        while self._finalizer is not None and self._finalizer.n_under_way > MOST_UNDER_WAY and idle():
            self._stop.wait(self._look_every_s / 10.0)

    def wait_for_the_files(self, idle: Idle) -> None:
        """At the end of a test its last sets get their files; after a stop the next recorder sees to that."""
        if self._finalizer is None or self._stop.is_set():
            return
        until_s = self._mono_s() + WAIT_FOR_FILES_S
        while idle() and self._mono_s() < until_s:
            if not self._finalizer.waits:
                break
            self._finalizer.try_again()
            self._stop.wait(self._look_every_s)

    def leave(self) -> None:
        """Let the history know the end."""
        if self._history is not None:
            self._history.follow(now=True)

    # Reports of trouble ---------------------------------------------------------------------------

    def _refusal(self) -> str:
        """Why nothing is stored though the disk would take it; a stop may use the space that is left."""
        return "" if self._disk is None or self._stop.is_set() else self._disk.refusal

    def watch_disk(self) -> None:
        """Tell how much room there is when that changes: an event at each level, an alarm at the last two."""
        space = None if self._disk is None else self._disk.check()
        if space is None:
            return
        log.warning("%s: level %s", space.description, space.level)
        self.say(DISK_SPACE, asdict(space))
        condition = space_condition(
            space.description, present=space.level in ("alarm", "stop"), stops=space.level == "stop"
        )
        self._store_alarm(condition)

    def _store_alarm(self, condition: Condition) -> None:
        """Store an alarm now, or as soon as the catalogue takes it."""
        job = partial(self._set_assessor.update_alarm, condition, self._moment())
        try:
            job()
        except PASSING as error:
            log.warning("the alarm is stored later: %s", error)
            self._retry_queue.put(job)

    def watch_web(self) -> None:
        """Raise the alarm of a web service that is missing, and clear it when it responds."""
        is_missing = None if self._web is None else self._web.is_missing()
        if is_missing in (None, self._web_is_missing):
            return
        moment = self._moment()
        with suppress(*PASSING):  # the next look stores it
            self._set_assessor.update_alarm(web_condition(moment.due_h, present=is_missing), moment)
            self._web_is_missing = is_missing

    def _report_trouble(self, trouble: Trouble | None) -> None:
        """Raise or clear the alarm if the catalogue accepts it; the heartbeat always reports the trouble."""
        self._trouble_until_ns = self._moment().utc_ns
        if trouble is not None:
            self._reported_trouble = trouble.message
            try:
                self._set_assessor.update_alarm(
                    storage_condition(trouble.message, present=True), self._moment()
                )
            except PASSING as error:
                log.warning("the alarm is not stored: %s", error)
        else:  # on record even if the catalogue itself was what took nothing
            self._store_alarm(storage_condition(self._reported_trouble, present=True))
            self._store_alarm(storage_condition(self._reported_trouble, present=False))
            self._reported_finalizing = ""  # what still has no file is reported again
        self._notify_trouble()

    def _report_finalizing(self, trouble: str) -> None:
        """Raise or clear the alarm of sets that get no file; nothing of them is at risk."""
        if bool(trouble) == bool(self._reported_finalizing) or self.trouble is not None:
            return
        message = trouble or self._reported_finalizing
        self._reported_finalizing = trouble
        self._store_alarm(storage_condition(message, present=bool(trouble), waits_in="journal"))

    def _report_corruption(self, *, at_the_start: bool = False) -> None:
        """Raise or clear the alarm of corrupt or missing sets, and report each new one."""
        damaged = dict(self._archive.journal_damage.files)
        for helper in (self._finalizer, self._verification):
            damaged |= {} if helper is None else helper.damaged
        if damaged == self._reported_corruption and not at_the_start:
            return
        new = {
            file: description
            for file, description in damaged.items()
            if file not in self._reported_corruption
        }
        self._reported_corruption = damaged
        for file, description in new.items():
            log.error("%s: %s", file, description)
            self.say("data_damaged", {"file": file, "told": description})
        aside = [file for file in self._archive.quarantined() if file not in damaged]
        condition = damage_condition(aside, damaged)
        self._retry_queue.put(partial(self._set_assessor.update_alarm, condition, self._moment()))
