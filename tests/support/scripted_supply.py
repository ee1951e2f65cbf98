"""A scripted supply that records its commands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hardware_drivers.measurement import SupplyReading
from hardware_drivers.serial_port.parameters import SerialLineParameters, SupplyParameters


def supply_parameters(**values: Any) -> SupplyParameters:
    """Return parameters of any supply, read every 10 s."""
    line = SerialLineParameters(port="COM4")
    return SupplyParameters(**{"line": line, "identity": "ANY", "log_interval_s": 10.0, **values})


class ScriptedSupply:
    """Supply that is on or off, at 10 V; ``error`` is its answer."""

    tripped_protections = ()
    protection_unknown = ""

    def __init__(self, clock: Any) -> None:
        self.clock = clock
        self.on = False
        self.voltage_v, self.current_a = 10.0, 0.2
        self.error: Exception | None = None
        self.calls: list[str] = []

    def _call(self, name: str) -> None:
        self.calls.append(name)
        if self.error is not None:
            raise self.error

    def read(self, timeout_s: float) -> SupplyReading:
        self._call("read")
        return SupplyReading(
            stamp=self.clock.stamp(),
            voltage_v=self.voltage_v if self.on else 0.0,
            current_a=self.current_a if self.on else 0.0,
            output_on=self.on,
        )

    def energise(self, voltage_v: float, current_limit_a: float) -> None:
        self._call(f"energise {voltage_v:g} V {current_limit_a:g} A")
        self.on = True

    def make_safe(self) -> None:
        self._call("make_safe")
        self.on = False

    def identity(self) -> Mapping[str, str]:
        return {}
