"""Device model behind every transport: answers calls, keeps the record, applies faults.

A front (the C library's wire, a gRPC server) opens a client, hands in calls by C name with arguments
by name, and gets values by name or a `Status`.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from hardware_drivers.measurement import ShotKey
from hardware_drivers.nanoseconds import NS_PER_S
from simulator.doubles.chassis.crosstalk import Crosstalk
from simulator.doubles.chassis.description import Description
from simulator.doubles.daqmx import (
    analog_calls,
    analog_input,
    channel_attributes,
    counter_output,
    device_attributes,
    device_calls,
    routing,
    task_attributes,
    task_calls,
    tasks,
    watchdog,
)
from simulator.doubles.daqmx.devices import Devices
from simulator.doubles.daqmx.lines import LineRecord
from simulator.doubles.daqmx.reservations import Reservations
from simulator.doubles.daqmx.strikes import Strikes
from simulator.doubles.daqmx.tasks import Arguments, Bench, Clock, Handler, TaskHandler, WallClock
from simulator.doubles.faults import Faults, build_wrong_answer
from simulator.doubles.niscope.device_model import NiscopeBrain
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.attributes import ATTRIBUTES
from simulator.doubles.vendor_api.entry_points import ENTRY_POINTS, EntryPoint
from simulator.doubles.vendor_api.statuses import Status

ClientKind = Literal["library", "grpc"]

CALLS_KEPT = 200_000
"""The record of calls is a ring."""

RINGING_NS = 5_000_000
"""So long after its contact no strike gives a wave: longer than any record."""

EXIT_ON_DEATH = 70
"""Exit code of a process that was ordered to die."""


HANDLERS: Mapping[str, Handler] = {
    **task_calls.HANDLERS,
    **routing.HANDLERS,
    **device_calls.HANDLERS,
    **watchdog.HANDLERS,
    **device_attributes.HANDLERS,
}
"""Of NI-DAQmx, by C name."""
TASK_HANDLERS: Mapping[str, TaskHandler] = {
    **task_calls.TASK_HANDLERS,
    **analog_calls.TASK_HANDLERS,
    **counter_output.TASK_HANDLERS,
    **routing.TASK_HANDLERS,
    **watchdog.TASK_HANDLERS,
    **channel_attributes.TASK_HANDLERS,
    **task_attributes.TASK_HANDLERS,
}
"""Those that are about one task."""


def _create_niscope_boards(description: Description, bench: Bench) -> NiscopeBrain:
    """Create the device model of all described NI-SCOPE boards, on the specimen of the bench."""

    def next_echo(position: str) -> tuple[ShotKey, float]:
        """Return and use up key and hour of a position's next pulse-echo record, under the bench's lock."""
        with bench.changed:
            return bench.strikes.take_next_echo(position)

    return NiscopeBrain(description.all_scopes, description.probes, bench.strikes.specimen, next_echo)


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """Recorded call.

    Attributes
    ----------
    attribute
        Name of the attribute a variadic call was about.
    status
        0, a warning or an error.
    begin_ns, end_ns
        Monotonic time.
    """

    client: str
    function: str
    attribute: str
    status: int
    begin_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class LeakedTask:
    """Task that its client left when it died."""

    client: str
    task: str
    state: str
    reservations: tuple[str, ...]
    ns: int


class Brain:
    """Device model of one double.

    Parameters
    ----------
    clock
        Wall time, or a test's own.
    die
        Ends the process for a fault of kind ``death``.
    """

    def __init__(
        self,
        description: Description,
        *,
        clock: Clock | None = None,
        die: Callable[[], None] = lambda: os._exit(EXIT_ON_DEATH),
    ) -> None:
        self.faults = Faults()
        self.bench = Bench(
            description=description,
            clock=clock or WallClock(),
            devices=Devices(description.boards),
            strikes=Strikes(description),
            lines=LineRecord(),
            reservations=Reservations(),
            changed=threading.Condition(),
            kinds={
                "ai": analog_input.AnalogInput(),
                "co": counter_output.CounterOutput(),
                "watchdog": watchdog.Watchdog(),
            },
        )
        self._die = die
        self._calls: deque[Call] = deque(maxlen=CALLS_KEPT)
        self._leaked: list[LeakedTask] = []
        self._clients: dict[str, ClientKind] = {}
        self._client_count = 0
        self.niscope = _create_niscope_boards(description, self.bench)

    # Clients

    def open_client(self, kind: ClientKind, label: str) -> str:
        """Register a client that tasks can belong to; return its unique name ``<kind>:<label>:<number>``."""
        with self.bench.changed:
            self._client_count += 1
            client = f"{kind}:{label}:{self._client_count}"
            self._clients[client] = kind
            return client

    def close_client(self, client: str) -> None:
        """Remove a client and record the tasks and sessions that it left; do nothing if it is unknown.

        The tasks of a library are cleared, as its process has ended; those of a gRPC server stay. NI-SCOPE
        sessions are closed.
        """
        with self.bench.changed:
            kind = self._clients.pop(client, None)
            if kind is None:
                return
            held = self.bench.reservations.held
            for task in [task for task in self.bench.tasks.values() if task.client == client]:
                mine = tuple(name for name, holder in held.items() if holder == task.holder)
                self._leaked.append(
                    LeakedTask(
                        client=client,
                        task=task.name,
                        state=task.state.name.lower(),
                        reservations=mine,
                        ns=time.monotonic_ns(),
                    )
                )
                if kind == "library":
                    tasks.clear_task(self.bench, task)
            self.bench.changed.notify_all()
        for resource in self.niscope.close_client_sessions(client):
            leak = LeakedTask(
                client=client, task="session", state="open", reservations=(resource,), ns=time.monotonic_ns()
            )
            self._leaked.append(leak)

    def is_open(self, client: str) -> bool:
        """Return whether a client is still registered."""
        with self.bench.changed:
            return client in self._clients

    # Calls

    def call(self, client: str, function: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Execute one API call of a client, with faults, and return its outputs; record its status and times.

        Raise Status for an error, or a warning with its outputs; KeyError for an unknown function or a
        missing argument.
        """
        entry = ENTRY_POINTS[function]
        attribute = ATTRIBUTES.get(arguments.get("attribute", 0))
        name = attribute.name if attribute is not None else ""
        begin_ns = time.monotonic_ns()
        code = 0
        try:
            return self._answer_with_faults(client, entry, name, arguments)
        except Status as status:
            code = status.code
            raise
        finally:
            end_ns = time.monotonic_ns()
            self._calls.append(
                Call(
                    client=client,
                    function=function,
                    attribute=name,
                    status=code,
                    begin_ns=begin_ns,
                    end_ns=end_ns,
                )
            )

    def _answer_with_faults(
        self, client: str, entry: EntryPoint, attribute: str, arguments: Arguments
    ) -> dict[str, Any]:
        """Answer a call, unless an injected fault makes it hang, fail, answer wrongly or end the process.

        Raise the Status of the call or the fault, or TRANSFER_ABORTED if the client is gone after a hang.
        """
        fault = self.faults.due(entry.name, attribute)
        if fault is not None and fault.kind == "death":
            self._die()
        if fault is not None and fault.kind == "hang":
            self.faults.hang(fault.seconds)
            if not self.is_open(client):
                raise Status(statuses.TRANSFER_ABORTED, "The caller went away while its call hung.")
        if fault is not None and fault.kind == "error":
            raise Status(fault.code, "Ordered by a test.")
        if fault is not None and fault.kind == "lie":
            return build_wrong_answer(entry, arguments, lambda: self._answer(client, entry, arguments))
        return self._answer(client, entry, arguments)

    def _answer(self, client: str, entry: EntryPoint, arguments: Arguments) -> dict[str, Any]:
        """Answer a call by its handler, under the bench's lock for NI-DAQmx; raise Status as it does."""
        if entry.library == "niScope":
            return dict(self.niscope.call(client, entry.name, arguments))
        with self.bench.changed:
            if entry.name in TASK_HANDLERS:
                task = tasks.find_task(self.bench, client, arguments["task"])
                return dict(TASK_HANDLERS[entry.name](self.bench, task, arguments) or {})
            return dict(HANDLERS[entry.name](self.bench, client, arguments) or {})

    # Control

    def announce(self, key: ShotKey, hour_h: float) -> None:
        """Set key and hour of the next strike, or pulse-echo record, at the key's position.

        Raise ValueError if nothing is wired there.
        """
        with self.bench.changed:
            self.bench.strikes.announce(key, hour_h)

    def disturb(self, position: str, crosstalk: Mapping[str, Any]) -> None:
        """Replace the crosstalk from the coil at a position into its sensor; missing keys get defaults.

        Raise TypeError for an unknown key, ValueError for a value out of bounds.
        """
        with self.bench.changed:
            self.bench.strikes.disturb(position, Crosstalk(**crosstalk))

    def unplug(self, serial_number: int) -> None:
        """Remove a board from the chassis: its tasks are lost, the calls of its sessions fail.

        Raise KeyError if no board has this serial number.
        """
        if self.niscope.has_board(serial_number):
            self.niscope.unplug(serial_number)
            return
        with self.bench.changed:
            device_calls.unplug_board(self.bench, serial_number)

    def plug(self, serial_number: int, name: str = "") -> None:
        """Plug a removed board in again, under another name if one is given.

        Raise KeyError if no board has this serial number, or an NI-SCOPE board was not removed.
        """
        if self.niscope.has_board(serial_number):
            self.niscope.plug(serial_number, name)
            return
        with self.bench.changed:
            self.bench.devices.plug(serial_number, name)

    def occupy(self, resource: str, owner: str) -> None:
        """Reserve ``<board name or serial number>/<part>`` or an NI-SCOPE board for an outside program.

        A present holder is replaced. Raise Status for an unknown board name.
        """
        if resource in self.niscope.names():
            self.niscope.occupy(resource, owner)
            return
        board, _, part = resource.partition("/")
        with self.bench.changed:
            serial_number = int(board) if board.isdecimal() else self.bench.devices.find(board).serial_number
            self.bench.reservations.occupy(f"{serial_number}/{part}", owner)

    def vacate(self, owner: str) -> None:
        """Release everything that `occupy` has reserved for an outside program, if anything."""
        self.niscope.vacate(owner)
        with self.bench.changed:
            for holder in set(self.bench.reservations.held.values()):
                if holder.client == "another process" and holder.task == owner:
                    self.bench.reservations.release(holder)

    def wait_until_no_tasks(self, timeout_s: float) -> bool:
        """Wait until no NI-DAQmx task exists, as after a client's end; return False after ``timeout_s``."""
        with self.bench.changed:
            return self.bench.changed.wait_for(lambda: not self.bench.tasks, timeout_s)

    def wait_until_quiet(self, timeout_s: float) -> bool:
        """Wait until no striker falls and `RINGING_NS` have passed since the last contact.

        Return False if that takes longer than ``timeout_s``.
        """
        clock = self.bench.clock
        deadline_ns = clock.now_ns() + round(timeout_s * NS_PER_S)
        with self.bench.changed:
            while True:
                contacts_ns = [strike.contact_ns for strike in self.bench.strikes.planned]
                quiet_ns = max(contacts_ns) + RINGING_NS if contacts_ns else 0
                now_ns = self.bench.settle()
                if now_ns >= min(quiet_ns, deadline_ns):
                    return now_ns >= quiet_ns
                clock.wait(self.bench.changed, min(quiet_ns, deadline_ns))

    def record(self) -> dict[str, Any]:
        """Return everything that the double recorded, in JSON types, with times in monotonic ns.

        It has clients, calls, line changes, levels, tasks, reservations, sessions, leaked tasks, strikes and
        boards. Of the calls, level changes and strikes only the newest are kept.
        """
        sessions = self.niscope.list_open_sessions()
        with self.bench.changed:
            now_ns = self.bench.settle()
            wired = {
                self._get_counter_line(wiring.counter_serial, wiring.counter): position
                for position, wiring in self.bench.description.transducers.items()
            }
            return {
                "now_ns": now_ns,
                "clients": sorted(self._clients),
                "calls": [asdict(call) for call in tuple(self._calls)],
                "lines": [
                    asdict(event) | {"position": wired.get(event.line)} for event in self.bench.lines.events
                ],
                "levels": {line: self.bench.lines.level(line) for line in wired},
                "tasks": [
                    {
                        "client": task.client,
                        "task": task.name,
                        "kind": task.kind,
                        "state": task.state.name.lower(),
                        "lost": task.lost,
                    }
                    for task in self.bench.tasks.values()
                ],
                "reservations": {
                    name: asdict(holder) for name, holder in self.bench.reservations.held.items()
                },
                "sessions": [{"client": client, "resource": resource} for client, resource in sessions],
                "leaked": [asdict(leak) for leak in tuple(self._leaked)],
                "strikes": [
                    asdict(strike.key)
                    | {
                        "hour_h": strike.hour_h,
                        "lifted_ns": strike.lifted_ns,
                        "released_ns": strike.released_ns,
                        "contact_ns": strike.contact_ns,
                    }
                    for strike in self.bench.strikes.planned
                ],
                "boards": [
                    {
                        "serial_number": device.serial_number,
                        "name": device.name,
                        "plugged": device.plugged,
                        "power_up_states": device.power_up_states,
                    }
                    for device in self.bench.devices
                ],
            }

    def _get_counter_line(self, serial_number: int, counter: int) -> str:
        """Return the line that a counter drives by default, ``<serial number>/<terminal>``."""
        kind = self.bench.devices.get_by_serial(serial_number).kind
        return f"{serial_number}/{kind.counter_terminals[counter]}"

    def clear_record(self) -> None:
        """Discard recorded calls, level changes and leaked tasks; levels, tasks and strikes stay."""
        with self.bench.changed:
            self.bench.settle()
            self._calls.clear()
            self._leaked.clear()
            self.bench.lines.clear_events()
