"""Make shots and sets durable, acknowledge them and retry what the disk refuses; report all trouble."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from typing import Any

from daq_service.alarms.data_trouble import damage_condition, space_condition, storage_condition
from daq_service.alarms.process_trouble import web_condition
from daq_service.alarms.states import Condition
from daq_service.archive import SetRecord, StoredSet
from daq_service.assessment.transaction import Transaction
from daq_service.background.task import BackgroundTask
from daq_service.background.write_retry_queue import PASSING, Trouble, WriteRetryQueue
from daq_service.processes.disk_policy import DiskSpace
from daq_service.recording.resources import Resources
from daq_service.recording.set_assessor import SetAssessor
from hardware_drivers.measurement import SetKey

log = logging.getLogger(__name__)

OVERSLEPT = "its time went by while the recorder ran: the computer slept, or what came before took too long"

DISK_SPACE = "disk_space"
"""Event at each change of how much of the volume is free (`disk_policy.LEVELS`)."""


class Persistence:
    """Where the recorder leaves what it has taken, and the list of background tasks.

    Attributes
    ----------
    on_trouble
        Called when the disk starts or stops to refuse.
    """

    def __init__(self, resources: Resources, assessor: SetAssessor) -> None:
        self._archive, self._catalogue, self._set_assessor = resources.archive, resources.catalogue, assessor
        self._finalizer, self._verification = resources.finalizer, resources.verification
        self._disk, self._web = resources.disk, resources.web
        self._acknowledged = resources.options.acknowledged
        self._stop, self._moment, self._host = resources.stop, resources.moment, resources.host
        self._web_is_missing: bool | None = None
        self._reported_ids: set[int] = set()
        self._reported_corruption: dict[str, str] = {}
        self._reported_trouble = self._reported_finalizing = ""
        self._trouble_until_ns = -1
        self._retry_queue = WriteRetryQueue(
            limit_bytes=resources.settings.storage.memory_mb * 10**6,
            on_change=self._report_trouble,
            refusal=self._refusal,
            mono_s=self._host.mono_s,
        )
        self._tasks: list[BackgroundTask] = [self._retry_queue, *resources.tasks]
        if self._disk is not None:
            self._disk.on_change = self._report_space
        self.on_trouble: Callable[[], None] = lambda: None

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
        self, build: Callable[[], Transaction], *then: Callable[[Transaction], None], n_bytes: int = 0
    ) -> None:
        """Build a transaction once and pass it on, in order; repeat the latter until the disk takes it."""
        built: list[Transaction] = []

        def job() -> None:
            if not built:
                built.append(build())
            for pass_on in then:
                pass_on(built[0])

        self._retry_queue.put(job, n_bytes=n_bytes)

    def after_set(self, set_key: SetKey) -> None:
        """Let the background tasks know of a set whose rows are stored, so that it gets its file."""
        for task in self._tasks:
            task.after_set(set_key)

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

    def run_for(self, seconds: float) -> None:
        """Run each background task; while the disk takes nothing, none that can wait.

        Parameters
        ----------
        seconds
            Time until the next set is due.
        """
        for task in self._tasks:
            task.run_for(seconds if self.trouble is None else 0.0)
        if self._finalizer is not None:
            self._report_finalizing(self._finalizer.trouble)
        if self.trouble is None:
            self._report_corruption()

    def watch(self) -> None:
        """Watch the volume and the web service, also between shots."""
        if self._disk is not None:
            self._disk.run_for(0.0)
        is_missing = None if self._web is None else self._web.is_missing()
        if is_missing in (None, self._web_is_missing):
            return
        moment = self._moment()
        with suppress(*PASSING):  # the next look stores it
            self._set_assessor.update_alarm(web_condition(moment.due_h, present=is_missing), moment)
            self._web_is_missing = is_missing

    def start_verification(self) -> None:
        """Find stored sets that are missing; report them and the files in quarantine."""
        if self._verification is not None:
            alarm = self._set_assessor.alarms.get((None, "data_corrupt"))
            stands = alarm is not None and alarm.state in ("unacknowledged", "acknowledged")
            self._verification.begin(alarm.evidence.get("damaged", {}) if alarm and stands else {})
        self._report_corruption(at_the_start=True)

    def use_reserve(self) -> None:
        """Store what waits in the space that is reserved for a stop; what no disk takes is lost."""
        if self.trouble is not None and self._disk is not None:
            self._disk.free_reserve()
            self._retry_queue.run_all()
        if self.trouble is not None:
            log.error("%d jobs are lost that no disk took: %s", len(self._retry_queue), self.trouble.message)

    # Reports of trouble ---------------------------------------------------------------------------

    def _refusal(self) -> str:
        """Why nothing is stored though the disk would take it; a stop may use the space that is left."""
        return "" if self._disk is None or self._stop.is_set() else self._disk.refusal

    def _report_space(self, space: DiskSpace) -> None:
        """Report the level of the volume: an event at each change, an alarm at the last two."""
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
        self.on_trouble()

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
            self.say("data_corrupt", {"file": file, "description": description})
        aside = [file for file in self._archive.quarantined() if file not in damaged]
        condition = damage_condition(aside, damaged)
        self._retry_queue.put(partial(self._set_assessor.update_alarm, condition, self._moment()))
