"""Parameters of supply and climate: setpoints, logging and monitoring, for any instrument."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated

from annotated_types import Ge, Gt, Le

from hardware_drivers.bounds import bounded, check_field_relation
from hardware_drivers.errors import ConfigurationError

LOG_KEYS = frozenset({"log_interval_s", "read_timeout_s"})
"""Not what is measured: how often, and how long an answer is waited for."""
CLIMATE_KEYS = LOG_KEYS | {"suspect_after_s"}
"""Nor how the climate is rated."""
WATCH_KEYS = LOG_KEYS | {
    "minimum_current_a",
    "deviation_after_s",
    "interlock_current_a",
    "interlock_readings",
    "interlock_lost_after_s",
    "off_at_end",
    "watchdog_timeout_s",
}
"""Nor how the drive is watched."""


@bounded
class DriveParameters(ABC):
    """Corrosion supply: its setpoint, and the reaction when that is not reached."""

    voltage_v: Annotated[float, Gt(0.0), Le(60.0)] = 10.0
    """Voltage of the drive (paper: 10 V)."""
    current_limit_a: Annotated[float, Gt(0.0), Le(100.0)] = 1.0
    """Current at which the supply stops holding its voltage."""
    voltage_cap_v: Annotated[float, Gt(0.0), Le(60.0)] = 12.0
    """Highest voltage that is ever sent (at most 60 V: extra-low voltage)."""
    current_cap_a: Annotated[float, Gt(0.0), Le(100.0)] = 2.0
    """Highest current limit that is ever sent."""
    readback_tolerance_v: Annotated[float, Gt(0.0), Le(1.0)] = 0.05
    """How far the voltage read back or measured may lie above the one that was set."""
    readback_tolerance_a: Annotated[float, Gt(0.0), Le(1.0)] = 0.02
    """How far the current limit read back, or the current measured, may lie above the one that was set."""
    log_interval_s: Annotated[float, Gt(0.0), Le(3600.0)] = 10.0
    """Seconds between two readings; charge is integrated over them."""
    read_timeout_s: Annotated[float, Gt(0.0), Le(60.0)] = 3.0
    """Longest time one reading may take: three questions, after a fault also finding the instrument."""
    interlock_current_a: Annotated[float, Gt(0.0), Le(100.0)] = 0.9
    """Measured current at which the interlock switches off (a hole, a short circuit). Below
    `current_limit_a`, or it is never reached while the supply keeps its limit."""
    interlock_readings: Annotated[int, Ge(1), Le(1000)] = 3
    """So many consecutive readings at or above `interlock_current_a` trip it."""
    minimum_current_a: Annotated[float, Ge(0.0), Le(100.0)] = 0.002
    """Measured current below which an energized cell counts as open (a lead is off, the bath is dry)."""
    deviation_after_s: Annotated[float, Gt(0.0), Le(86_400.0)] = 120.0
    """So long voltage or current may deviate from the command before the alarm `supply_deviation`."""
    off_at_end: bool = True
    """Switch the output off when the schedule is done or the test is stopped by a command. A crash or a
    restart leaves it as it is for `watchdog_timeout_s`. So does `false` at the end, and the corrosion
    continues. Only a person's command switches it on again."""
    interlock_lost_after_s: Annotated[float, Gt(0.0), Le(86_400.0)] = 300.0
    """Silence after which the interlock trips: the output is switched off as soon as the link is back."""
    watchdog_timeout_s: Annotated[float, Ge(1.0), Le(86_400.0)] = 600.0
    """Watchdog trip: after this time without a recorder, the output is switched off until a person's command.
    A command outlives the supply process by this time at most, and never a boot of the computer."""

    @property
    @abstractmethod
    def longest_order_s(self) -> float:
        """Return the longest time in s of a command, with that of switching off again if it fails."""

    def require_within_caps(self, voltage_v: float, current_limit_a: float) -> None:
        """Raise an error unless voltage in V and current limit in A of a command are within their caps.

        Raises
        ------
        ConfigurationError
            A value is not above 0, or is above its cap; nothing was sent.
        """
        for name, value, cap_name, cap in (
            ("voltage_v", voltage_v, "voltage_cap_v", self.voltage_cap_v),
            ("current_limit_a", current_limit_a, "current_cap_a", self.current_cap_a),
        ):
            if not 0.0 < value <= cap:
                raise ConfigurationError(
                    f"{name} is {value:g}; it must be above 0 and at most {cap_name} = {cap:g}; "
                    "nothing was sent"
                )

    def __post_init__(self) -> None:
        """Raise ValueError if voltage or current limit is above its cap."""
        check_field_relation(self, "voltage_v", "at most", "voltage_cap_v")
        check_field_relation(self, "current_limit_a", "at most", "current_cap_a")


@bounded
class NamedSupply(DriveParameters):
    """Supply by an instrument of `[rig.instruments]`; `[rig.supply]` is one with a text protocol."""

    instrument: str
    """Its name there; the instrument serves as nothing else."""
    order_timeout_s: Annotated[float, Gt(0.0), Le(600.0)] = 15.0
    """Longest time that it takes to obey (set, read back, switch, measure)."""

    @property
    def longest_order_s(self) -> float:
        """Return twice ``order_timeout_s``, in s: for a command, and for switching off again if it fails."""
        return 2.0 * self.order_timeout_s


@bounded
class LogParameters:
    """Logging of the climate next to the specimen."""

    log_interval_s: Annotated[float, Gt(0.0), Le(3600.0)] = 60.0
    """Seconds between two readings."""
    read_timeout_s: Annotated[float, Gt(0.0), Le(60.0)] = 3.0
    """Longest time one reading may take."""
    suspect_after_s: Annotated[float, Gt(0.0), Le(604_800.0)] = 3600.0
    """Readings that repeat the same temperature and humidity for so long are suspect."""


@bounded
class NamedClimateProbe(LogParameters):
    """Climate probe by an instrument of `[rig.instruments]`; `[rig.climate]` is one with a text protocol."""

    instrument: str
    """Its name there."""
