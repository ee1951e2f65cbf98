"""Orders of the operator: rows of ``commands``, carried out and answered by the recorder."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from daq_service.alarms import Moment, acknowledge
from daq_service.catalogue import RecorderCatalogue
from daq_service.clock import SimulatedClock
from daq_service.rows import Transaction
from hardware_drivers.instruments import Clock

log = logging.getLogger(__name__)

LISTEN_EVERY_NS = 200_000_000
"""A person does not notice a fifth of a second; SQLite does not notice five queries a second."""

AlarmKey = tuple[str | None, str]


class Operator:
    """Obeys orders, one at a time, between shots and while waiting.

    Parameters
    ----------
    alarms
        The recorder's current alarms by position and kind.
    store
        Stores a transaction and takes its alarms over.
    """

    def __init__(
        self,
        catalogue: RecorderCatalogue,
        clock: Clock,
        alarms: Mapping[AlarmKey, Mapping[str, Any]],
        *,
        stop: threading.Event,
        store: Callable[[Transaction], None],
    ) -> None:
        self._catalogue = catalogue
        self._clock = clock
        self._alarms = alarms
        self._stop = stop
        self._store = store
        self._listened_ns: int | None = None

    def listen(self, hour: float) -> None:
        """Carry out what is waiting; a refused order is answered with the reason."""
        now_ns = time.monotonic_ns()
        if self._listened_ns is not None and now_ns - self._listened_ns < LISTEN_EVERY_NS:
            return
        self._listened_ns = now_ns
        for command in self._catalogue.pending_commands():
            try:
                result = self._obey(command, hour)
            except ValueError as error:
                log.warning("command %d (%s) refused: %s", command["id"], command["kind"], error)
                self._catalogue.finish_command(command["id"], "refused", str(error))
            else:
                log.info(
                    "command %d (%s) of %s: %s", command["id"], command["kind"], command["author"], result
                )
                self._catalogue.finish_command(command["id"], "done", result)

    def _obey(self, command: Mapping[str, Any], hour: float) -> str:
        match command["kind"]:
            case "finish_now":
                if not isinstance(self._clock, SimulatedClock):
                    raise ValueError("the test runs on the wall clock, which cannot skip time")
                self._clock.finish_now()
                return "no pacing from here on"
            case "stop":
                self._stop.set()
                return "stopping after the shot being taken"
            case "acknowledge_alarm":
                self._acknowledge(command, hour)
                return "acknowledged"
            case other:
                raise ValueError(f"unknown order {other!r}; there are finish_now, stop and acknowledge_alarm")

    def _acknowledge(self, command: Mapping[str, Any], hour: float) -> None:
        wanted = command["arguments"].get("alarm_id")
        rows = [row for row in self._alarms.values() if row["id"] == wanted]
        if not rows:
            raise ValueError(f"there is no current alarm {wanted!r}")
        moment = Moment(utc_ns=self._clock.utc_ns(), due_h=hour, set_index=None)
        transaction = Transaction()
        note = str(command["arguments"].get("note", ""))
        transaction.add_alarm(acknowledge(rows[0], command["author"], note, moment), moment)
        self._store(transaction)
