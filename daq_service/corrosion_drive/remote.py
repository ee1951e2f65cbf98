"""The recorder's side of a drive in a process of its own: found, started where there is none, asked.

Only an order waits for it, for a bounded time. What was told last is shown with its age; as soon as the
process does not answer, what the output does is unknown. Nothing here repeats an order.
"""

from __future__ import annotations

import itertools
import logging
import subprocess
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

from daq_service.catalogue.rows import EnvironmentRow
from daq_service.clock import elapsed_ns
from daq_service.corrosion_drive.channel import Connection, connect
from daq_service.corrosion_drive.charge import DriveState
from daq_service.corrosion_drive.drive import DriveCondition, no_supply
from daq_service.corrosion_drive.kept import address_of, kept_now, write_kept
from daq_service.corrosion_drive.own_process import fingerprint
from daq_service.processes.data_folder import DRIVE_FILE, DRIVE_LOCK, is_owned
from hardware_drivers.drive_parameters import DriveParameters
from hardware_drivers.errors import ConfigurationError, ConnectionLostError
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

LOOK_EVERY_S = 0.5
STARTS_AFTER_S = (0.0, 1.0, 2.0, 5.0, 10.0, 30.0)
"""Before each further start of a process that does not come up; the last one repeats."""
COMES_WITHIN_S = 30.0
"""So long it may take from the first look to the first answer without an alarm."""
PAUSE_S = 0.01

Start = Callable[[], "subprocess.Popen[bytes]"]


def answered_within_s(parameters: DriveParameters) -> float:
    """Longest time between an order to the process and its answer: what it is at, then the order."""
    return parameters.read_timeout_s + 2.0 * parameters.longest_order_s + 5.0


class RemoteDrive:
    """A `SupplyDrive` in another process; a context manager that leaves that process running.

    Parameters
    ----------
    start
        Starts the process, detached, for this folder.
    mono_s, pause
        The machine's monotonic time, and how an order's answer is waited for.
    """

    def __init__(
        self,
        parameters: DriveParameters,
        folder: Path,
        start: Start,
        *,
        mono_s: Callable[[], float] = time.monotonic,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        self._parameters, self._folder, self._start = parameters, folder, start
        self._mono_s, self._pause = mono_s, pause
        self._connection: Connection | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._ids = itertools.count(1)
        self._asked: int | None = None
        self._told: Mapping[str, Any] | None = None
        self._told_s = self._begun_s = self._look_s = self._start_s = mono_s()
        self._starts = 0
        self._tripped: str | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._disconnect()
        if self._process is not None and self._process.poll() is None:
            self._process.returncode = 0  # it outlives us, and nobody of ours waits for it

    def begin(self, state: DriveState) -> None:
        """Take over what the catalogue says; a process that kept its own state knows more."""
        self._tripped = state.tripped
        if (self._folder / DRIVE_FILE).exists():
            return
        try:
            write_kept(self._folder, kept_now(state))
        except OSError as error:
            log.warning("the drive begins without its charge: %s", error)

    # While the recorder is idle ------------------------------------------------------------------

    def tick(self) -> None:
        """Take what was told and ask again; where nobody is, start a process. Waits for nothing."""
        now_s = self._mono_s()
        if self._connection is None:
            if now_s >= self._look_s:
                self._look_s = now_s + LOOK_EVERY_S
                self._find(now_s)
            return
        try:
            for answer in self._connection.received():
                self._take(answer)
            if self._asked is None and now_s >= self._look_s:
                self._look_s = now_s + LOOK_EVERY_S
                self._asked = self._send("look")
        except OSError as error:
            self._lose(error)

    def _find(self, now_s: float) -> None:
        owned = is_owned(self._folder, DRIVE_LOCK)
        if owned is False:
            starting = self._process is not None and self._process.poll() is None
            if not starting and now_s >= self._start_s:
                wait_s = STARTS_AFTER_S[min(self._starts + 1, len(STARTS_AFTER_S) - 1)]
                self._starts, self._start_s = self._starts + 1, now_s + wait_s
                log.info("starting the process of the drive")
                self._process = self._start()
                self._look_s = now_s  # it comes up within a moment
            return
        try:
            address = address_of(self._folder)
            self._connection = connect(address.port, bytes.fromhex(address.key))
            if address.fingerprint != fingerprint(self._parameters):
                self._send("hand over", why="the recorder has another configuration or version")
                self._disconnect()
                return
            self._asked = (
                self._send("look") if self._tripped is None else self._send("trip", reason=self._tripped)
            )
        except (OSError, ValueError, LookupError, TypeError) as error:
            self._lose(error)

    def _send(self, do: str, **values: Any) -> int:
        assert self._connection is not None, "only called while connected"
        number = next(self._ids)
        self._connection.send({"id": number, "do": do, **values})
        return number

    def _take(self, answer: Mapping[str, Any]) -> None:
        if answer["id"] == self._asked:
            self._asked = None
        self._told, self._told_s, self._starts = answer, self._mono_s(), 0
        self._tripped = answer["row"]["supply_tripped"]

    def _lose(self, error: Exception) -> None:
        log.log(logging.WARNING if self._told else logging.DEBUG, "the process of the drive: %s", error)
        self._disconnect()

    def _disconnect(self) -> None:
        if self._connection is not None:
            self._connection.close()
        self._connection, self._asked = None, None

    # Orders --------------------------------------------------------------------------------------

    def energise(
        self, author: str, *, voltage_v: float | None = None, current_limit_a: float | None = None
    ) -> None:
        """Switch the output on at a person's order, and close the interlock.

        Raises
        ------
        InstrumentError
            It was not done, or what became of it is unknown.
        """
        self._order("energise", author=author, voltage_v=voltage_v, current_limit_a=current_limit_a)

    def switch_off(self, author: str) -> None:
        """Switch the output off at a person's order; the interlock stays as it is.

        Raises
        ------
        InstrumentError
            What the output does is unknown.
        """
        self._order("switch off", author=author)

    def trip(self, reason: str) -> bool:
        """Open the interlock; a process that does not answer now hears it as soon as it does."""
        self._tripped = self._tripped or reason
        try:
            return not self._order("trip", reason=reason)["owes"]
        except (ConfigurationError, ConnectionLostError) as error:
            log.error("the interlock is not open yet: %s", error)
            self._tripped = self._tripped or reason
            self._disconnect()  # it is told first when it is met again
            return False

    def _order(self, do: str, **values: Any) -> Mapping[str, Any]:
        """Ask once and wait for the answer, at most `answered_within_s` and the time to meet the process."""
        begin_by_s = self._mono_s() + COMES_WITHIN_S
        while self._connection is None or self._asked is not None:
            if self._mono_s() >= begin_by_s:
                raise ConnectionLostError("the process of the drive does not answer; nothing was sent to it")
            self.tick()
            self._pause(PAUSE_S)
        within_s = answered_within_s(self._parameters)
        begun_by_ns = elapsed_ns() + round(self._parameters.read_timeout_s + 5.0) * NS_PER_S
        try:
            number = self._asked = self._send(do, until_boot_ns=begun_by_ns, **values)
            deadline_s = self._mono_s() + within_s
            while self._mono_s() < deadline_s:
                for answer in self._connection.received():
                    self._take(answer)
                    if answer["id"] == number:
                        if "error" in answer:
                            raise ConfigurationError(answer["error"])
                        return answer
                self._pause(PAUSE_S)
        except OSError as error:
            self._lose(error)
        self._disconnect()
        raise ConnectionLostError(
            "the process of the drive has not answered, what the output does is unknown; look before the "
            "order is given again"
        )

    # What it says --------------------------------------------------------------------------------

    def conditions(self) -> tuple[DriveCondition, ...]:
        """Possible alarms as told last, but for the loss of whoever told them."""
        told = () if self._told is None else self._told["conditions"]
        found = {condition["name"]: DriveCondition(**condition) for condition in told}
        tripped = found.get("interlock_tripped")
        if self._tripped is not None and (tripped is None or not tripped.active):
            found["interlock_tripped"] = DriveCondition(
                name="interlock_tripped",
                active=True,
                message=f"{self._tripped}; the process of the drive has not heard it yet",
            )
        missing_s = self._mono_s() - (self._begun_s if self._told is None else self._told_s)
        gone = self._connection is None and (self._told is not None or missing_s >= COMES_WITHIN_S)
        if gone or missing_s >= answered_within_s(self._parameters):
            found["supply_lost"] = DriveCondition(
                name="supply_lost",
                active=True,
                message="what the output does is unknown: the process of the drive does not answer, for "
                f"{missing_s:.0f} s now",
            )
        return tuple(found.values())

    def row(self, set_index: int, due_h: float) -> EnvironmentRow:
        """Row of a set, as told last; without an answer the output is unknown and its time, too."""
        unknown = replace(
            no_supply(set_index, due_h),
            supply_state="unknown",
            supply_quality="stale",
            supply_tripped=self._tripped,
        )
        if self._told is None:
            return unknown
        row = replace(unknown, **self._told["row"])
        since_s = self._mono_s() - self._told_s
        aged = replace(
            row,
            supply_age_s=None if row.supply_age_s is None else row.supply_age_s + since_s,
            supply_tripped=self._tripped,
        )
        if self._connection is not None and since_s < answered_within_s(self._parameters):
            return aged
        return replace(
            aged,
            supply_state="unknown",
            supply_quality="lost",
            unknown_s=None if row.unknown_s is None else row.unknown_s + since_s,
        )

    def begin_window(self) -> None:
        """Start the means anew with the readings that were not in the last row."""
        if self._connection is not None and self._told is not None:
            try:
                self._send("begin window", window_length=self._told["window_length"])
            except OSError as error:
                self._lose(error)
