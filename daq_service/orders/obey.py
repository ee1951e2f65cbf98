"""Orders of the operator: rows of ``commands``, carried out and answered by the recorder."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from daq_service.alarms.states import (
    RETIRING,
    Condition,
    Moment,
    acknowledge,
    reset,
    retired_positions,
    update,
)
from daq_service.catalogue import RecorderCatalogue
from daq_service.catalogue.rows import AlarmRow, CommandRow
from daq_service.clock import SimulatedClock
from daq_service.judgement.transaction import Transaction
from hardware_drivers.instruments import Clock

log = logging.getLogger(__name__)

LISTEN_EVERY_NS = 200_000_000
"""A person does not notice a fifth of a second; SQLite does not notice five queries a second."""

ORDERS = (
    "finish_now",
    "stop",
    "acknowledge_alarm",
    "hold",
    "release",
    "retire",
    "reinstate",
    "supply_on",
    "supply_off",
)

AlarmKey = tuple[str | None, str]
Alarms = Mapping[AlarmKey, AlarmRow]


class SupplySwitch(Protocol):
    """Who switches the corrosion drive; a refusal is a ValueError."""

    def supply_on(
        self, author: str, hour: float, *, voltage_v: float | None, current_limit_a: float | None
    ) -> str:
        """Switch it on; voltage and limit as configured where not given."""
        ...

    def supply_off(self, author: str, hour: float) -> str:
        """Switch it off."""
        ...


class Operator:
    """Obeys orders, one at a time, between shots and while waiting.

    Parameters
    ----------
    alarms
        The recorder's current alarms by position and kind.
    store
        Stores a transaction and takes its alarms over.
    reinstated
        Called with a position that may strike again.
    positions
        The solitary-wave transducers.
    supply
        None where the test has no supply.
    """

    def __init__(
        self,
        catalogue: RecorderCatalogue,
        clock: Clock,
        alarms: Alarms,
        *,
        stop: threading.Event,
        store: Callable[[Transaction], None],
        reinstated: Callable[[str], None],
        positions: Sequence[str],
        supply: SupplySwitch | None = None,
    ) -> None:
        self._catalogue = catalogue
        self._clock = clock
        self._alarms = alarms
        self._stop = stop
        self._store = store
        self._reinstated = reinstated
        self._positions = positions
        self._supply = supply
        self._listened_ns: int | None = None
        # Whatever ended the last recorder: a restart never ends a hold.
        self._held = catalogue.held() or ""

    @property
    def held(self) -> str:
        """Who holds the test and why; empty while it runs. A hold outlives a restart."""
        return self._held

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
                log.warning("command %d (%s) refused: %s", command.id, command.kind, error)
                self._catalogue.finish_command(command.id, "refused", str(error))
            else:
                log.info("command %d (%s) of %s: %s", command.id, command.kind, command.author, result)
                self._catalogue.finish_command(command.id, "done", result)

    def _obey(self, command: CommandRow, hour: float) -> str:
        match command.kind:
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
            case "hold":
                return self._hold(command, hour)
            case "release":
                return self._release(command, hour)
            case "retire":
                return self._retire(command, hour)
            case "reinstate":
                return self._reinstate(command, hour)
            case "supply_on" | "supply_off":
                return self._switch_supply(command, hour)
            case other:
                raise ValueError(f"unknown order {other!r}; there are {', '.join(ORDERS)}")

    def _acknowledge(self, command: CommandRow, hour: float) -> None:
        wanted = command.arguments.get("alarm_id")
        rows = [row for row in self._alarms.values() if row.id == wanted]
        if not rows:
            raise ValueError(f"there is no current alarm {wanted!r}")
        moment, transaction = self._moment(hour), Transaction()
        transaction.add_alarm(acknowledge(rows[0], command.author, _note(command), moment), moment)
        self._store(transaction)

    def _hold(self, command: CommandRow, hour: float) -> str:
        if self._held:
            raise ValueError(f"the test is already on hold: {self._held}")
        held = f"held by {command.author}" + (f": {_note(command)}" if _note(command) else "")
        transaction = Transaction()
        transaction.tell("hold", {"held": held, "author": command.author}, self._moment(hour))
        self._store(transaction)
        self._held = held
        return "on hold: nothing strikes until the test is released; sets that fall due are missed"

    def _release(self, command: CommandRow, hour: float) -> str:
        if not self._held:
            raise ValueError("the test is not on hold")
        transaction = Transaction()
        payload = {"held": "", "author": command.author, "note": _note(command)}
        transaction.tell("release", payload, self._moment(hour))
        self._store(transaction)
        self._held = ""
        return "released: the next due set is taken"

    def _retire(self, command: CommandRow, hour: float) -> str:
        position = self._position(command)
        if position in retired_positions(self._alarms.values()):
            raise ValueError(f"{position} is retired already")
        condition = Condition(
            position=position,
            kind="retired",
            family="device",
            severity="medium",
            present=True,
            latched=True,
            message=f"retired by {command.author}: {_note(command) or 'no reason given'}",
            proof={"command_id": command.id},
        )
        moment, transaction = self._moment(hour), Transaction()
        change = update(self._alarms.get((position, "retired")), condition, moment)
        assert change is not None, "a position that is not retired has no such alarm standing"
        transaction.add_alarm(change, moment)
        self._store(transaction)
        return f"{position} strikes no more"

    def _reinstate(self, command: CommandRow, hour: float) -> str:
        position = self._position(command)
        standing = [
            row
            for (place, kind), row in self._alarms.items()
            if place == position and kind in RETIRING and row.state != "normal"
        ]
        if not standing:
            raise ValueError(f"{position} is not retired")
        moment, transaction = self._moment(hour), Transaction()
        for row in standing:
            transaction.add_alarm(reset(row, command.author, _note(command), moment), moment)
        self._store(transaction)
        self._reinstated(position)
        return f"{position} strikes again from the next set"

    def _switch_supply(self, command: CommandRow, hour: float) -> str:
        if self._supply is None:
            raise ValueError("this test has no supply; configure [rig.supply]")
        if command.kind == "supply_off":
            return self._supply.supply_off(command.author, hour)
        arguments = command.arguments
        return self._supply.supply_on(
            command.author,
            hour,
            voltage_v=arguments.get("voltage_v"),
            current_limit_a=arguments.get("current_limit_a"),
        )

    def _position(self, command: CommandRow) -> str:
        position = str(command.arguments.get("position", ""))
        if position not in self._positions:
            names = ", ".join(self._positions) or "none"
            raise ValueError(f"there is no solitary-wave transducer {position!r}; there are: {names}")
        return position

    def _moment(self, hour: float) -> Moment:
        return Moment(utc_ns=self._clock.utc_ns(), due_h=hour, set_index=None)


def _note(command: CommandRow) -> str:
    return str(command.arguments.get("note", ""))
