"""The experiment's two clocks behind one Protocol (`hardware_drivers.instruments.Clock`), and what they need.

The wall clock runs a real test; the simulated clock jumps, or walks at a pace. Heartbeats and driver
deadlines never use these clocks but the machine's monotonic time.
"""

from daq_service.clock.boot import WINDOWS_BOOT_COUNTER, boot_id, boot_name
from daq_service.clock.machine import MACHINE, MachineClock, elapsed_ns
from daq_service.clock.simulated import SimulatedClock
from daq_service.clock.time_line import Before, Step, TimeLine
from daq_service.clock.wall import WallClock
from daq_service.clock.written import format_utc, parse_utc

__all__ = [
    "MACHINE",
    "WINDOWS_BOOT_COUNTER",
    "Before",
    "MachineClock",
    "SimulatedClock",
    "Step",
    "TimeLine",
    "WallClock",
    "boot_id",
    "boot_name",
    "elapsed_ns",
    "format_utc",
    "parse_utc",
]
