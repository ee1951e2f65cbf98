"""A coil's output wired to an input of its own board."""

from __future__ import annotations

from dataclasses import dataclass, replace

from hardware_drivers.daqmx.boards import Board
from hardware_drivers.daqmx.connection import Connection
from hardware_drivers.daqmx.parameters import DaqmxParameters

LOOPBACK_RATE_HZ = 100e3
LOOPBACK_PRETRIGGER = 1_000
"""10 ms of the idle line before the pulse."""
AFTER_S = 0.02
"""So much of the idle line after the pulse."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Loopback:
    """Output of a coil wired to an input of its own board.

    Attributes
    ----------
    parameters
        One position, whose input is the looped one.
    """

    position: str
    parameters: DaqmxParameters
    connection: Connection
    board: Board

    def at_level(self, level_v):
        """Return the same settings with another trigger level."""
        return replace(self.parameters, trigger_level_v=level_v)
