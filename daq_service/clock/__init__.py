"""The wall clock of a test (`hardware_drivers.instruments.Clock`), and clocks of the computer.

The clock of simulated time is `simulator.clock.SimulatedClock`. Heartbeats and driver
deadlines never use these clocks but the machine's monotonic time.
"""

from daq_service.clock.boot import WINDOWS_BOOT_COUNTER, boot_name, read_boot_id
from daq_service.clock.machine import MACHINE, MachineClock, elapsed_ns
from daq_service.clock.time_line import Before, Step, TimeLine
from daq_service.clock.wall import WallClock
from daq_service.clock.written import format_utc, parse_utc

__all__ = [
    "MACHINE",
    "WINDOWS_BOOT_COUNTER",
    "Before",
    "MachineClock",
    "Step",
    "TimeLine",
    "WallClock",
    "boot_name",
    "elapsed_ns",
    "format_utc",
    "parse_utc",
    "read_boot_id",
]
