"""Digitizer and striker on NI-DAQmx boards, through NI's `nidaqmx` package.

Importing this package is light: `nidaqmx` is loaded when a rig is opened.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from hardware_drivers.daqmx.parameters import DaqmxParameters, TransducerWiring, WatchdogWiring

if TYPE_CHECKING:
    from hardware_drivers.daqmx.instruments import DaqmxInstruments

__all__ = ["DaqmxParameters", "TransducerWiring", "WatchdogWiring", "open_daqmx"]


@contextmanager
def open_daqmx(parameters: DaqmxParameters) -> Iterator[DaqmxInstruments]:
    """Find and check the boards, and yield the instruments.

    The thread that opens them is the only one that may call them. At the end the coil is off and no
    task is left.

    Raises
    ------
    ConfigurationError
        No driver, a board that cannot do what is asked, wiring that does not exist.
    BusyError
        Someone else holds a board, named in the message.
    ConnectionLostError
        A board or the gRPC server is not there.
    """
    from hardware_drivers.daqmx.instruments import opened

    with opened(parameters) as instruments:
        yield instruments
