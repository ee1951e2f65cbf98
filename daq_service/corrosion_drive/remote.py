"""Client of the supply process in the recorder: finds it, starts it if absent, replaces it if it hangs.

Only `switch_off_at_end` waits for that process. The newest answer is shown with its age; as soon as the
process does not answer, the state of the output is unknown. A command `on` is never repeated; one without an
answer is followed by a switch-off.
"""

from __future__ import annotations

import itertools
import logging
import os
import signal
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Self

from daq_service.catalogue.rows import EnvironmentRow
from daq_service.clock import MACHINE, MachineClock
from daq_service.corrosion_drive.channel import Connection, Message, connect_to_server
from daq_service.corrosion_drive.charge import DriveState
from daq_service.corrosion_drive.drive import DriveCondition, Reply, build_absent_row
from daq_service.corrosion_drive.own_process import hash_supply_settings
from daq_service.corrosion_drive.supply_state import (
    read_address,
    read_process_number,
    read_stored_state,
    stamp_state,
    write_stored_state,
)
from daq_service.processes.data_folder import DRIVE_LOCK, is_held
from hardware_drivers.drive_parameters import DriveParameters
from hardware_drivers.errors import ConnectionLostError
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

CHECK_EVERY_S = 0.5
STARTS_AFTER_S = (0.0, 1.0, 2.0, 5.0, 10.0, 30.0)
"""Delays before further starts of a process that does not come up; the last one repeats."""
COMES_WITHIN_S = 30.0
"""Longest time to the first answer without an alarm, and for which a command waits unsent."""
ENDS_WITHIN_S = 2.0
"""Time at the end of a test: half of the time that a supervisor allows its recorder."""
PAUSE_S = 0.01
KILL = getattr(signal, "SIGKILL", signal.SIGTERM)
"""Ends also a suspended process; on Windows, SIGTERM ends any process at once."""

Start = Callable[[], "subprocess.Popen[bytes]"]


def longest_answer_time_s(parameters: DriveParameters) -> float:
    """Return the longest time in s from a request to its answer, with a margin of 5 s.

    It is that of the supply process's current call and of the request itself.
    """
    return parameters.read_timeout_s + 2.0 * parameters.longest_order_s + 5.0


@dataclass(slots=True, kw_only=True)
class _Request:
    """Request that was sent, or waits to be sent."""

    values: Message
    since_s: float
    reply: Reply = field(default_factory=Reply)


class RemoteDrive:
    """Drive in the supply process; the context manager leaves that process running.

    Parameters
    ----------
    start
        Starts the process, detached, for this folder.
    supply_port
        Name of the supply's port; see `own_process.DriveProcess`.
    watches
        False: it only checks whether the process is alive, which then counts the recorder as absent.
    kill
        Ends a process that hangs, by its number.
    """

    def __init__(
        self,
        parameters: DriveParameters,
        folder: Path,
        start: Start,
        *,
        supply_port: str = "",
        watches: bool = True,
        machine: MachineClock = MACHINE,
        kill: Callable[[int], None] = lambda process: os.kill(process, KILL),
    ) -> None:
        """Store the settings of the connection; the first `tick` connects or starts the process."""
        self._parameters, self._folder, self._start = parameters, folder, start
        self._supply_port, self._watches = supply_port, watches
        self._machine, self._kill = machine, kill
        self._connection: Connection | None = None
        self._answers = False
        self._process: subprocess.Popen[bytes] | None = None
        self._ids = itertools.count(1)
        self._sent: dict[int, _Request] = {}
        self._unsent: list[_Request] = []
        self._pending: Message | None = None
        self._commanded: bool | None = None
        self._newest: Message | None = None
        self._newest_s = self._started_s = self._next_check_s = self._start_s = machine.mono_s()
        self._starts = 0
        self._tripped: str | None = None

    def __enter__(self) -> Self:
        """Return the drive itself; nothing is connected here."""
        return self

    def __exit__(self, *_: object) -> None:
        """Disconnect from the supply process; before that, withdraw an unanswered command `on`."""
        if any(request.values["do"] == "energise" for request in self._sent.values()):
            # The answer to that command would be lost.
            self._queue_command("switch off", author="the recorder's end")
        self._disconnect("the recorder has ended")
        self._abandon_process()

    def _abandon_process(self) -> None:
        """Mark a running child process as ended, so that nothing ever waits for it; it keeps running."""
        if self._process is not None and self._process.poll() is None:
            self._process.returncode = 0  # it outlives this process, or was killed: nothing waits for it

    def store_catalogue_state(self, state: DriveState) -> None:
        """Write the catalogue's state, without its command, to ``drive.json`` for the first supply process.

        A state that a supply process has written already is kept. An OSError is logged, not raised.
        """
        self._tripped = state.tripped
        stored = read_stored_state(self._folder)
        if stored is not None and stored.utc_ns:
            return
        try:
            write_stored_state(self._folder, stamp_state(replace(state, command=None)))
        except OSError as error:
            log.warning("the drive starts without its charge: %s", error)

    # While the recorder is idle ------------------------------------------------------------------

    def tick(self) -> None:
        """Read answers and send requests without waiting; start a missing process, kill one that hangs.

        A command still unsent after `COMES_WITHIN_S` fails; unless it was `energise`, a switch-off is
        scheduled. Errors of the connection are logged, not raised.
        """
        now_s = self._machine.mono_s()
        for request in [request for request in self._unsent if now_s - request.since_s >= COMES_WITHIN_S]:
            self._unsent.remove(request)
            request.reply.error = "the process of the drive does not answer; nothing was sent to it"
            if request.values["do"] != "energise":
                self._schedule_switch_off(request)
        if self._connection is None:
            if now_s >= self._next_check_s:
                self._next_check_s = now_s + CHECK_EVERY_S
                self._connect_or_start(now_s)
            return
        try:
            for answer in self._connection.read_messages():
                if answer.get("released"):
                    self._disconnect("the process of the drive has released the supply")
                    return
                self._process_answer(answer)
            for request in self._unsent[:]:
                self._unsent.remove(request)
                self._send_request(request)
            if not self._sent and now_s >= self._next_check_s:
                self._next_check_s = now_s + CHECK_EVERY_S
                self._send_to_process("look" if self._watches else "ping")
        except OSError as error:
            self._handle_lost_connection(error)
            return
        waited_s = now_s - min((request.since_s for request in self._sent.values()), default=now_s)
        if waited_s >= longest_answer_time_s(self._parameters):
            self._kill_process(f"it has not answered for {waited_s:.0f} s")

    def _connect_or_start(self, now_s: float) -> None:
        """Connect to the supply process and send its first request; start a process if none runs.

        Further starts are delayed by `STARTS_AFTER_S`. A process of another configuration is asked to hand
        over. A failed connection is logged and tried again later; OSError if no process can be started.
        """
        owned = is_held(self._folder, DRIVE_LOCK)
        if owned is False:
            is_starting = self._process is not None and self._process.poll() is None
            if not is_starting and now_s >= self._start_s:
                wait_s = STARTS_AFTER_S[min(self._starts + 1, len(STARTS_AFTER_S) - 1)]
                self._starts, self._start_s = self._starts + 1, now_s + wait_s
                log.info("starting the process of the drive")
                self._process = self._start()
                self._next_check_s = now_s  # it comes up soon
            return
        try:
            address = read_address(self._folder)
            self._connection = connect_to_server(address.port, bytes.fromhex(address.key))
            if not self._watches:
                self._send_to_process("ping")
            elif address.fingerprint != hash_supply_settings(self._parameters):
                reason = "the recorder has another configuration or version"
                self._send_to_process("hand over", why=reason, supply_port=self._supply_port)
            elif self._pending is not None:
                self._send_to_process(**self._pending)
            elif self._tripped is not None:
                self._send_to_process("trip", reason=self._tripped)
            else:
                self._send_to_process("look", commanded=self._commanded)
        except (OSError, ValueError, LookupError, TypeError) as error:
            self._handle_lost_connection(error)

    def _send_to_process(self, do: str, **values: object) -> None:
        """Send a request whose reply is not polled; OSError if the process is gone or does not read."""
        self._send_request(_Request(values={"do": do, **values}, since_s=self._machine.mono_s()))

    def _send_request(self, request: _Request) -> None:
        """Send a request under a new number, and keep it until its answer or the loss of the connection.

        OSError if the process is gone or does not read.
        """
        assert self._connection is not None, "only called while connected"
        number = next(self._ids)
        request.since_s = self._machine.mono_s()
        self._sent[number] = request
        self._connection.send({"id": number, **request.values})

    def _process_answer(self, answer: Message) -> None:
        """Store an answer in the reply of its request, and keep the state of the supply that it reports.

        An answer to ``ping`` has no state. A confirmed pending request is no longer pending.
        """
        request = self._sent.pop(answer["id"], None)
        if request is not None:
            request.reply.error = answer.get("error", "")
            request.reply.done = not request.reply.error
        self._starts = 0
        if "row" not in answer:
            return
        self._newest, self._newest_s, self._answers = answer, self._machine.mono_s(), True
        self._tripped, self._commanded = answer["row"]["supply_tripped"], answer.get("commanded")
        if request is not None and request.values == self._pending:
            self._pending = None  # a failed switch-off is retried by the process itself

    def _handle_lost_connection(self, error: Exception) -> None:
        """Log a lost connection, close it, and fail the requests without an answer, as `_disconnect` does.

        It is a warning after the first answer, before that a debug entry.
        """
        log.log(logging.WARNING if self._newest else logging.DEBUG, "the process of the drive: %s", error)
        self._disconnect("the process of the drive has not answered, what the output does is unknown")

    def _disconnect(self, reason: str) -> None:
        """Close the connection and fail the requests without an answer, with this reason.

        Commands among them schedule a switch-off. From now on the output's state is unknown.
        """
        if self._connection is not None:
            self._connection.close()
        self._connection, self._answers = None, False
        sent, self._sent = self._sent, {}
        for request in sent.values():
            request.reply.error = reason
            self._schedule_switch_off(request)

    def _schedule_switch_off(self, request: _Request) -> None:
        """Make a switch-off pending for the next connection if this unanswered request is a command.

        An unanswered trip itself becomes pending; other requests are dropped.
        """
        if request.values["do"] in ("energise", "switch off"):
            self._pending = self._pending or {"do": "switch off", "author": request.values["author"]}
        elif request.values["do"] == "trip":
            self._pending = request.values

    def _kill_process(self, reason: str) -> None:
        """Kill the process that holds the supply's lock, and disconnect; the next tick starts another one.

        It is not waited for. A failure to kill is logged, not raised.
        """
        try:
            process = read_process_number(self._folder)
            log.error("the process of the drive (%d) is killed: %s", process, reason)
            self._kill(process)
        except (OSError, ValueError) as error:
            log.error("the process of the drive hangs and cannot be killed: %s", error)
        self._disconnect("the process of the drive hung, what the output does is unknown")
        self._starts, self._start_s = 0, self._machine.mono_s()

    # Commands ------------------------------------------------------------------------------------

    def energise(
        self, author: str, *, voltage_v: float | None = None, current_limit_a: float | None = None
    ) -> Reply:
        """Queue the command on, which also resets the interlock; return the object that receives its reply.

        Voltage in V and current limit in A are as configured if None. The command is never repeated, and
        expires if the process reads it too late.
        """
        return self._queue_command(
            "energise", author=author, voltage_v=voltage_v, current_limit_a=current_limit_a
        )

    def switch_off(self, author: str) -> Reply:
        """Queue the command off, without waiting; return the object that receives its reply.

        If it gets no answer, a switch-off is sent at the next connection.
        """
        return self._queue_command("switch off", author=author)

    def trip(self, reason: str) -> bool:
        """Queue a trip of the interlock, repeated until a process answers; do not wait.

        Always return False: the output has not been read back as off yet.
        """
        self._tripped = self._tripped or reason
        self._queue_command("trip", reason=reason)
        return False

    def _queue_command(self, do: str, **values: object) -> Reply:
        """Queue the command ``do``, send it at once if connected, and return the object for its reply.

        A command `energise` carries the boot time after which it must not be executed.
        """
        if do == "energise":
            within_s = round(self._parameters.read_timeout_s + COMES_WITHIN_S)
            values["until_boot_ns"] = self._machine.elapsed_ns() + within_s * NS_PER_S
        request = _Request(values={"do": do, **values}, since_s=self._machine.mono_s())
        self._unsent.append(request)
        self._next_check_s = min(self._next_check_s, self._machine.mono_s())
        self.tick()
        return request.reply

    def switch_off_at_end(self) -> None:
        """Switch off at the end of a test; replace a process that does not answer within `ENDS_WITHIN_S`.

        Blocks up to that time. The process that replaces it starts with a switch-off.

        Raises
        ------
        ConnectionLostError
            The state of the output is unknown; the switch-off is pending.
        OSError
            The process that replaces it cannot be started.
        """
        reply, deadline_s = self.switch_off("the end of the test"), self._machine.mono_s() + ENDS_WITHIN_S
        while not (reply.done or reply.error) and self._machine.mono_s() < deadline_s:
            self._machine.sleep(PAUSE_S)
            self.tick()
        if reply.done:
            return
        if reply.error and self._connection is not None:
            raise ConnectionLostError(reply.error)  # it answers, and retries itself
        if is_held(self._folder, DRIVE_LOCK):
            self._kill_process("it does not answer at the end of the test")
        stored = read_stored_state(self._folder)
        state = DriveState() if stored is None else stored.state
        try:
            write_stored_state(self._folder, stamp_state(replace(state, command=None, must_switch_off=True)))
        except OSError as error:
            log.error("the drive's next process finds no switch-off to do: %s", error)
        self._abandon_process()
        self._process = self._start()
        raise ConnectionLostError("the process of the drive did not answer; another one switches off")

    # Readings and conditions ---------------------------------------------------------------------

    def list_conditions(self) -> tuple[DriveCondition, ...]:
        """Return the conditions of the newest answer, updated by what this process knows.

        That is a trip or switch-off that the supply process has not confirmed, and ``supply_not_responding``
        if it does not answer.
        """
        answered = () if self._newest is None else self._newest["conditions"]
        conditions = {condition["name"]: DriveCondition(**condition) for condition in answered}

        def activate(name: str, **values: object) -> None:
            """Add a condition that is active, with these values."""
            conditions[name] = DriveCondition(name=name, active=True, values=values)

        tripped = conditions.get("interlock_tripped")
        if self._tripped is not None and (tripped is None or not tripped.active):
            activate("interlock_tripped", trip_reason=self._tripped, unverified=True)
        if self._pending is not None or any(request.values["do"] != "energise" for request in self._unsent):
            activate("supply_switch_off_pending", read_error="Its process does not respond")
        missing_s = self._machine.mono_s() - (self._started_s if self._newest is None else self._newest_s)
        is_lost = not self._answers and (self._newest is not None or missing_s >= COMES_WITHIN_S)
        if is_lost or missing_s >= longest_answer_time_s(self._parameters):
            read_error = "its process does not respond"
            activate("supply_not_responding", silent_s=missing_s, read_error=read_error)
        return tuple(conditions.values())

    def build_row(self, set_index: int, due_h: float) -> EnvironmentRow:
        """Build the environment row of a set from the newest answer, its age in s added; send no request.

        ``due_h`` is the set's test hour. Without a recent answer the output is unknown; without any, all
        measured columns are None.
        """
        unknown = replace(
            build_absent_row(set_index, due_h),
            supply_state="unknown",
            supply_quality="stale",
            supply_tripped=self._tripped,
        )
        if self._newest is None:
            return unknown
        row = replace(unknown, **self._newest["row"])
        since_s = self._machine.mono_s() - self._newest_s
        aged = replace(
            row,
            supply_age_s=None if row.supply_age_s is None else row.supply_age_s + since_s,
            supply_tripped=self._tripped,
        )
        if self._answers and since_s < longest_answer_time_s(self._parameters):
            return aged
        return replace(
            aged,
            supply_state="unknown",
            supply_quality="no_communication",
            unknown_s=None if row.unknown_s is None else row.unknown_s + since_s,
        )

    def restart_means(self) -> None:
        """Ask the process to delete the readings of the newest answer from the means of the next row.

        Nothing is sent without a connection or an answer; a lost connection is logged.
        """
        if self._connection is not None and self._newest is not None:
            try:
                self._send_to_process("begin window", window_length=self._newest["window_length"])
            except OSError as error:
                self._handle_lost_connection(error)
