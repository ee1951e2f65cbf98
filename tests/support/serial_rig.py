"""The serial instruments' doubles and the real drivers on them, for contract and fault tests."""

from __future__ import annotations

import itertools
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from hardware_drivers.errors import ConnectionLostError
from hardware_drivers.measurement import Stamp
from hardware_drivers.serial_port.climate_probe import ScpiClimateProbe
from hardware_drivers.serial_port.parameters import ClimateParameters, SerialLineParameters, SupplyParameters
from hardware_drivers.serial_port.power_supply import ScpiPowerSupply
from simulator.doubles.serial.dialects import SUPPLIES
from simulator.doubles.serial.instruments import SerialInstruments
from simulator.doubles.serial.link import SerialLink, SocketLink, find_missing_terminal_reason

NO_TERMINALS = find_missing_terminal_reason()
"""Why there is nothing to test here; empty where there is."""
REPLY_TIMEOUT_S = READ_TIMEOUT_S = 60.0
"""The doubles answer within a millisecond, on a busy machine later; no test waits for a missing reply, see
`DeadlineClock`."""


class DeadlineClock:
    """Monotonic clock of the machine, moved past every deadline when an answer is withheld."""

    def __init__(self) -> None:
        self._ahead_s = 0.0
        self.per_look_s = 0.0
        """Goes on by so much at each look: for silence that no double withholds."""

    def __call__(self) -> float:
        self._ahead_s += self.per_look_s
        return time.monotonic() + self._ahead_s

    def skip(self, seconds: float = 100.0 * REPLY_TIMEOUT_S) -> None:
        self._ahead_s += seconds


class TestClock:
    """Clock that the test advances; its stamps still differ."""

    __test__ = False

    def __init__(self) -> None:
        self.now_ns = 10**18
        self._ticks = itertools.count(1)

    def advance(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)

    def utc_ns(self) -> int:
        return self.now_ns

    def mono_ns(self) -> int:
        return self.now_ns

    def wait_until(self, utc_ns: int, idle: Callable[[], bool]) -> bool:
        self.now_ns = max(self.now_ns, utc_ns)
        return idle()

    def stamp(self) -> Stamp:
        now_ns = self.now_ns + next(self._ticks)
        return Stamp(utc_ns=now_ns, mono_ns=now_ns, boot_id="test")


class SerialRig:
    """Doubles on pseudo terminals in a folder, or on sockets, with their drivers."""

    def __init__(
        self,
        folder: Path,
        *,
        noise_v: float = 0.0,
        noise_a: float = 0.0,
        dialect: str = "scpi",
        way: str = "pty",
        line: dict[str, Any] | None = None,
        read_timeout_s: float = READ_TIMEOUT_S,
        **supply: Any,
    ) -> None:
        self.dialect = dialect
        self.clock = TestClock()
        self.deadlines = DeadlineClock()
        double = SUPPLIES[dialect](noise_v=noise_v, noise_a=noise_a)
        self.instruments = SerialInstruments(
            folder, supply=double, link=SerialLink if way == "pty" else SocketLink
        )
        link = self.instruments.supply_link
        for each in (link, self.instruments.climate_link):
            each.withheld = self.deadlines.skip
        line = {"reply_timeout_s": REPLY_TIMEOUT_S, **(line or {})}
        self.supply_parameters = SupplyParameters(
            line=SerialLineParameters(
                port=link.visa_port if way == "visa" else link.port,
                **{"terminator": "" if dialect == "korad" else "\n", **line},
            ),
            identity=re.escape(double.IDENTITY),
            dialect=dialect,
            read_timeout_s=read_timeout_s,
            **supply,
        )
        self.climate_parameters = ClimateParameters(
            line=SerialLineParameters(port=self.instruments.climate_link.port, **line),
            identity="SOLIMON,CLIMATE PROBE DOUBLE,CD0001",
            read_timeout_s=read_timeout_s,
        )
        self.supply = self.new_supply()
        self.climate = ScpiClimateProbe(
            self.climate_parameters, stamp=self.clock.stamp, monotonic_s=self.deadlines
        )

    def new_supply(self) -> ScpiPowerSupply:
        """Open a second driver on the same port."""
        return ScpiPowerSupply(self.supply_parameters, stamp=self.clock.stamp, monotonic_s=self.deadlines)

    def __enter__(self) -> SerialRig:
        return self

    def __exit__(self, *_: object) -> None:
        self.supply.close()
        self.climate.close()
        self.instruments.close()

    def supply_is_read(self) -> bool:
        """Read the supply once its next attempt is due; check that a reading matches the command."""
        self.clock.advance(60.0)
        try:
            reading = self.supply.read(READ_TIMEOUT_S)
        except ConnectionLostError:
            return False
        assert (reading.voltage_v, reading.output_on) == (10.0, True)
        return True

    def garble_reply(self, number: int) -> Iterator[int]:
        """Let the supply send one wrong reply, the ``number``-th from now on; return their counter."""
        answered = iter(range(1, 1000))
        link, answer = self.instruments.supply_link, self.instruments.supply.answer

        def garble_one(command: str) -> str | None:
            reply = answer(command)
            if reply is None or next(answered) != number:
                return reply
            if command == "*IDN?":
                self.deadlines.skip()  # the name may still come after what is not it
            return "@?"

        link.answer = garble_one
        return answered

    def switched(self) -> list[tuple[bool, str]]:
        """Return the changes of the supply's output with their causes."""
        return [(change.on, change.cause) for change in self.instruments.list_output_changes()]

    def heard(self) -> list[str]:
        """Return the commands that the supply received."""
        return [command for _, command in self.instruments.supply_link.heard()]
