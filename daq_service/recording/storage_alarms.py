"""Alarms and events of the disk, of stored data and of the web service, while the recorder waits."""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import asdict
from functools import partial

from daq_service.alarms.data_trouble import build_data_condition, build_disk_condition, build_write_condition
from daq_service.alarms.process_trouble import build_web_condition
from daq_service.alarms.states import Condition
from daq_service.errors import PASSING
from daq_service.processes.disk_policy import DiskSpace
from daq_service.recording.persistence import Persistence, Trouble
from daq_service.recording.resources import Resources
from daq_service.recording.set_assessor import SetAssessor

log = logging.getLogger(__name__)

OVERSLEPT = "its time went by while the recorder ran: the computer slept, or what came before took too long"

DISK_SPACE = "disk_space"
"""Event at each change of how much of the volume is free (`disk_policy.LEVELS`)."""


class StorageAlarms:
    """Reports what storage and web service lack, and when it is over."""

    def __init__(self, resources: Resources, assessor: SetAssessor, persistence: Persistence) -> None:
        """Connect to the disk watch; nothing is reported yet."""
        self._archive, self._set_assessor, self._persistence = resources.archive, assessor, persistence
        self._finalizer, self._verification = resources.finalizer, resources.verification
        self._disk, self._web, self._moment = resources.disk, resources.web, resources.moment
        self._web_is_missing: bool | None = None
        self._reported_corruption: dict[str, str] = {}
        self._reported_trouble = self._reported_finalizing = ""
        self._trouble_until_ns = -1
        if self._disk is not None:
            self._disk.on_change = self._report_space

    def find_overdue_reason(self, due_utc_ns: int) -> str:
        """Return why the time of a set passed: trouble of the disk then, else sleep of the computer."""
        is_over = self._persistence.trouble is None and self._trouble_until_ns < due_utc_ns
        return OVERSLEPT if is_over else f"the recorder waited for the disk: {self._reported_trouble}"

    def check_web(self) -> None:
        """Raise or clear the alarm of a missing web service when that changes; the next call retries.

        Errors of the disk are not raised.
        """
        is_missing = None if self._web is None else self._web.is_missing()
        if is_missing in (None, self._web_is_missing):
            return
        moment = self._moment()
        with suppress(*PASSING):  # the next look stores it
            self._set_assessor.update_alarm(build_web_condition(present=is_missing), moment)
            self._web_is_missing = is_missing

    def start_verification(self) -> None:
        """Start the check of stored sets with the known corrupt ones; report corrupt and missing sets.

        Does not wait for the check.
        """
        if self._verification is not None:
            alarm = self._set_assessor.alarms.get((None, "data_corrupt"))
            stands = alarm is not None and alarm.state in ("unacknowledged", "acknowledged")
            self._verification.begin(alarm.evidence.get("damaged", {}) if alarm and stands else {})
        self._report_corruption(at_the_start=True)

    def store_in_reserve(self) -> None:
        """Run the queued jobs in the space that is reserved for a stop, if the disk has refused them.

        Jobs that are refused again are lost, which is logged as an error, not raised.
        """
        if self._persistence.trouble is not None and self._disk is not None:
            self._disk.free_reserve()
            self._persistence.run_queued_jobs()
        if (trouble := self._persistence.trouble) is not None:
            log.error("%d jobs are lost that no disk took: %s", len(self._persistence), trouble.message)

    def report(self) -> None:
        """Report what the background tasks have found: sets that get no file, and corruption.

        While the disk refuses, nothing is reported.
        """
        if self._finalizer is not None:
            self._report_finalizing(self._finalizer.trouble)
        if self._persistence.trouble is None:
            self._report_corruption()

    def _report_space(self, space: DiskSpace) -> None:
        """Log the level of the volume and store it as an event; raise or clear the alarm of the space.

        The alarm is active at the levels "alarm" and "stop".
        """
        log.warning("%s: level %s", space.description, space.level)
        self._persistence.say(DISK_SPACE, asdict(space))
        condition = build_disk_condition(
            space.free_bytes,
            space.total_bytes,
            space.stop_bytes,
            present=space.level in ("alarm", "stop"),
            stops=space.level == "stop",
        )
        self._store_alarm(condition)

    def _store_alarm(self, condition: Condition) -> None:
        """Update an alarm now; if the disk refuses, log it and queue the update."""
        job = partial(self._set_assessor.update_alarm, condition, self._moment())
        try:
            job()
        except PASSING as error:
            log.warning("the alarm is stored later: %s", error)
            self._persistence.do(job)

    def report_trouble(self, trouble: Trouble | None) -> None:
        """Raise the storage alarm with a trouble, if the catalogue accepts it, or clear it with None.

        A trouble that could not be stored is stored at its end, as raised and cleared. Disk errors are
        logged.
        """
        self._trouble_until_ns = self._moment().utc_ns
        if trouble is not None:
            self._reported_trouble = trouble.message
            try:
                self._set_assessor.update_alarm(
                    build_write_condition(trouble.message, present=True), self._moment()
                )
            except PASSING as error:
                log.warning("the alarm is not stored: %s", error)
        else:  # on record even if the catalogue itself was what took nothing
            self._store_alarm(build_write_condition(self._reported_trouble, present=True))
            self._store_alarm(build_write_condition(self._reported_trouble, present=False))
            self._reported_finalizing = ""  # what still has no file is reported again

    def _report_finalizing(self, trouble: str) -> None:
        """Raise or clear the alarm of sets that get no file, when that changes; they are safe in the journal.

        Nothing happens while the disk refuses.
        """
        if bool(trouble) == bool(self._reported_finalizing) or self._persistence.trouble is not None:
            return
        message = trouble or self._reported_finalizing
        self._reported_finalizing = trouble
        self._store_alarm(build_write_condition(message, present=bool(trouble), waits_in="journal"))

    def _report_corruption(self, *, at_the_start: bool = False) -> None:
        """Raise or clear the alarm of corrupt or missing sets, if they changed; log and store each new one.

        ``at_the_start`` True updates the alarm even without a change.
        """
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
            self._persistence.say("data_corrupt", {"file": file, "description": description})
        aside = [file for file in self._archive.list_quarantined() if file not in damaged]
        condition = build_data_condition(aside, damaged)
        self._persistence.do(partial(self._set_assessor.update_alarm, condition, self._moment()))
