"""Open the rig; a test that has started waits, with an alarm, for a rig that is busy or gone."""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from daq_service.alarms.rig_trouble import build_opening_condition
from daq_service.alarms.states import Change, Condition, Moment, update_alarm
from daq_service.catalogue import RecorderCatalogue, SetCommit
from daq_service.catalogue.history import HistoryFollower
from daq_service.catalogue.rows import AlarmRow
from daq_service.errors import PASSING, BusyError, RigError
from daq_service.processes.heartbeat import Heartbeat
from hardware_drivers.errors import BusyError as InstrumentBusyError
from hardware_drivers.errors import ConnectionLostError, InstrumentError, UnknownStatusError
from hardware_drivers.instruments import Rig
from hardware_drivers.measurement import DueSet

log = logging.getLogger(__name__)

WAITS_FOR_RIG_S = (1.0, 2.0, 5.0, 10.0, 30.0)
BEAT_EVERY_S = 0.2
MAY_PASS = (InstrumentBusyError, ConnectionLostError, UnknownStatusError)


@dataclass(frozen=True, slots=True, kw_only=True)
class Opening:
    """What a recorder did before it took up the schedule.

    Attributes
    ----------
    since_mono_ns
        When it was started, on its clock's elapsed time.
    text
        Why it took no set meanwhile.
    """

    since_mono_ns: int
    text: str


def is_transient(trouble: InstrumentError, *, proven: bool) -> bool:
    """Return whether an instrument error may be gone at the next set.

    A board that is busy or gone may be free or back by then; if one has taken a complete set in this
    folder (``proven``) no error is final.
    """
    return proven or isinstance(trouble, InstrumentBusyError | ConnectionLostError)


def raise_if_permanent(trouble: InstrumentError, due: DueSet, *, n_shots: int, proven: bool) -> None:
    """Raise RigError if the error that ended a set early will not be gone at the next set (`is_transient`).

    ``n_shots`` is the number of its stored shots, for the message.
    """
    if not is_transient(trouble, proven=proven):
        raise RigError(
            f"set {due.set_key} ended early: {trouble}; the {n_shots} shots before it are stored"
        ) from trouble


def build_started_payload(
    rig: Rig, not_running_reason: str, sets_done: int, provenance: Mapping[str, Any]
) -> dict[str, object]:
    """Build the payload of the event of a recorder's start.

    It has the rig and its identity, dry run, number of completed sets, reason why none ran before, versions.
    """
    return {
        "rig": rig.kind,
        "dry_run": rig.dry_run,
        "rig_identity": dict(rig.identity),
        "sets_done": sets_done,
        "before": not_running_reason,
        "versions": provenance["versions"],
    }


class OpeningAlarm:
    """Raises ``instruments_unavailable`` while the rig cannot be opened, and clears what it raised.

    An alarm that a set has raised is left to the next set: a rig that opens may still not respond.
    """

    def __init__(
        self,
        catalogue: RecorderCatalogue,
        history: HistoryFollower,
        moment: Callable[[], Moment],
        report: Callable[..., None],
    ) -> None:
        """Keep the catalogue, the history, and the functions that give the time and send reports."""
        self._catalogue, self._history = catalogue, history
        self._moment, self._report = moment, report
        self._reported = False

    def report_condition(self, trouble: InstrumentError | None) -> None:
        """Raise the alarm for an error that prevents the opening, or clear it with None.

        A disk error is logged; the next call stores the alarm. Changes, and the first error without a change,
        are also reported to the starting program.
        """
        condition, moment = build_opening_condition(trouble), self._moment()
        try:
            change = self._update_stored_alarm(condition, moment)
        except PASSING as error:
            log.warning("the alarm is not stored, the next try does it: %s", error)
            change = None
        if change is not None:
            row, kind = change.row, change.event_kind
            self._report("alarm", change=kind, hour=moment.due_h, priority=row.priority, message=row.message)
        elif condition.present and not self._reported:
            self._report("waits", reason=condition.build_texts(moment.due_h).message)
        self._reported = condition.present

    def _update_stored_alarm(self, condition: Condition, moment: Moment) -> Change | None:
        """Update the alarm in catalogue and history; return its change, None if it does not change.

        An alarm that a set raised is not cleared. Raises StorageError if the catalogue refuses.
        """
        rows = self._catalogue.rows(AlarmRow, kind=condition.kind)
        row = rows[-1] if rows else None
        if not condition.present and row is not None and row.evidence.get("set_index") is not None:
            return None
        change = update_alarm(row, condition, moment)
        if change is not None:
            transaction = SetCommit()
            transaction.add_alarm(change.row, change.event(moment))
            self._catalogue.commit_set(transaction)
            self._history.follow(now=True)
        return change


def open_rig_with_retries(
    open_once: Callable[[], Rig],
    *,
    resuming: bool,
    restarted: bool,
    heartbeat: Heartbeat,
    stop: threading.Event,
    waits_s: Sequence[float],
    alarm: OpeningAlarm,
) -> tuple[Rig | None, str]:
    """Open the rig; a test that has started waits for a passing error, a new test ends with it.

    A chassis that reboots, a colleague's panel left open or an unplugged cable must not end a test of two
    weeks: the sets that fall due meanwhile get rows with that cause. Where the supervisor starts the recorder
    again, no person is at the rig: then it waits after any error of the instruments. It blocks without limit,
    writes the heartbeat, logs each error and raises the alarm.

    Parameters
    ----------
    resuming, restarted
        The test has rows of sets; the supervisor has started the recorder again.
    waits_s
        Pauses between the attempts in s; the last one repeats.

    Returns
    -------
    Rig or None
        None if ``stop`` came first.
    str
        What the recorder did meanwhile.

    Raises
    ------
    RigError, BusyError
        An error that does not pass, or any error of the rig of a test that has not started.
    """
    did, heartbeat.stage = "the recorder was opening the rig", "opening"
    for wait_s in itertools.chain(waits_s, itertools.repeat(waits_s[-1])):
        heartbeat.beat("opening the rig")
        try:
            rig = open_once()
        except InstrumentError as error:
            may_pass = restarted or isinstance(error, MAY_PASS)
            if not (resuming and may_pass):
                kind = BusyError if isinstance(error, InstrumentBusyError) else RigError
                raise kind(f"the rig cannot be opened: {error}") from error
            log.warning("the rig cannot be opened, next try in %g s: %s", wait_s, error)
            did = f"the recorder waited for the rig: {error}"
            alarm.report_condition(error)
            again_s = time.monotonic() + wait_s
            while time.monotonic() < again_s:
                heartbeat.beat(f"waiting for the rig: {error}")
                if stop.wait(min(BEAT_EVERY_S, wait_s)):
                    return None, did
        else:
            heartbeat.stage = ""
            alarm.report_condition(None)
            return rig, did
    raise AssertionError("the waits never end")
