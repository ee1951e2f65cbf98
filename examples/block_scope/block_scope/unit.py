"""Oscilloscope unit: calls that raise solimon's errors, and blocks of samples."""

from __future__ import annotations

import logging
import time
from ctypes import POINTER, c_int16, c_int32, c_uint32, create_string_buffer, pointer
from typing import Any

import numpy as np
from numpy.typing import NDArray

from block_scope import api
from block_scope.api import Status
from hardware_drivers.errors import (
    AcquisitionTimeoutError,
    BusyError,
    ConfigurationError,
    ConnectionLostError,
    InstrumentError,
)

log = logging.getLogger(__name__)

POLL_S = 2e-3
"""The library has no call that waits: it is asked this often, which costs a core nothing."""
BITS_OF_A_SAMPLE = 16

ERRORS: dict[Status, tuple[type[InstrumentError], str]] = {
    Status.NOT_FOUND: (ConnectionLostError, "check its cable, its power and the serial number"),
    Status.NOT_RESPONDING: (ConnectionLostError, "check its cable and its power"),
    Status.INVALID_HANDLE: (ConnectionLostError, "it was unplugged; it is opened anew for the next shot"),
    Status.BUSY: (BusyError, "it is still at work"),
    Status.OPENED_ELSEWHERE: (BusyError, "close the other program that uses it"),
}
"""What a status means; every other one is a fault of what was asked."""
CORRECT = (ConfigurationError, "correct the parameters")
UNKNOWN = (ConfigurationError, "look the status up in its maker's manual")


class Unit:
    """Oscilloscope that is opened when it is needed, and again after a loss.

    Parameters
    ----------
    library
        What `api.load` gives.
    serial
        Serial number; empty: the first one found.
    """

    def __init__(self, library: Any, serial: str, resolution_bits: int) -> None:
        self._library = library
        self._serial = serial
        self._bits = resolution_bits
        self._handle: int | None = None
        self.highest_code = 0

    @property
    def is_open(self) -> bool:
        """Return True between `open` and the loss of the unit."""
        return self._handle is not None

    def open(self) -> None:
        """Open the unit and query its highest code."""
        handle, highest = pointer(c_int16()), pointer(c_int16())
        self._check("opening", self._library.bs_open_unit(handle, self._serial.encode("ascii"), self._bits))
        self._handle = handle.contents.value
        self._call("bs_maximum_value", highest)
        self.highest_code = highest.contents.value >> self._shift

    def close(self) -> None:
        """Close the unit; harmless when closed, and when it is lost."""
        handle, self._handle = self._handle, None
        if handle is not None:
            status = self._library.bs_close_unit(handle)
            if status != Status.OK:
                log.warning("closing the oscilloscope: status %#x", status)

    def info(self, subject: int) -> str:
        """Query a text about the unit."""
        text = create_string_buffer(80)
        self._call("bs_get_unit_info", text, len(text), subject)
        return text.value.decode("ascii", errors="replace").strip() or "unknown"

    def timebase(self, sample_rate_hz: float) -> int:
        """Return the timebase of a rate; reject one that the unit would round."""
        interval_ns = 1e9 / sample_rate_hz
        number, actual_ns = max(0, round(interval_ns / 10.0) - 1), pointer(c_int32())
        self._call("bs_get_timebase", number, actual_ns)
        if abs(actual_ns.contents.value - interval_ns) > 1e-6 * interval_ns:
            raise ConfigurationError(
                f"sample_rate_hz is {sample_rate_hz:g}; the nearest of this oscilloscope is "
                f"{1e9 / actual_ns.contents.value:g}"
            )
        return number

    def start(
        self,
        channel: str,
        *,
        range_v: float,
        level_v: float,
        rising: bool,
        samples: tuple[int, int],
        base: int,
    ) -> None:
        """Run a block: `samples` before and after the level is crossed at the channel."""
        number = api.CHANNELS.index(channel)
        for each in range(len(api.CHANNELS)):
            self._call("bs_set_channel", each, int(each == number), api.RANGES_MV.index(round(range_v * 1e3)))
        level = round(level_v / range_v * self.highest_code) << self._shift
        direction = api.RISING if rising else api.FALLING
        self._call("bs_set_simple_trigger", number, level, direction, api.NEVER)
        self._call("bs_run_block", *samples, base)

    def wait(self, timeout_s: float) -> None:
        """Wait for the end of the block."""
        until_s, ready = time.monotonic() + timeout_s, pointer(c_int16())
        while True:
            self._call("bs_is_ready", ready)
            if ready.contents.value:
                return
            left_s = until_s - time.monotonic()
            if left_s <= 0.0:
                raise AcquisitionTimeoutError(
                    f"no trigger within {timeout_s:g} s; look at the wave and at trigger_level_v"
                )
            time.sleep(min(POLL_S, left_s))

    def values(self, wanted: int) -> tuple[NDArray[np.int16], bool]:
        """Return the codes of the block, shape (wanted,), and whether the input exceeded its range."""
        buffer = np.zeros(wanted, dtype=np.int16)
        got, overflow = pointer(c_uint32(wanted)), pointer(c_int16())
        self._call("bs_get_values", buffer.ctypes.data_as(POINTER(c_int16)), got, overflow)
        if got.contents.value != wanted:
            raise ConnectionLostError(f"{got.contents.value} of {wanted} samples came; check the USB cable")
        return buffer >> self._shift, bool(overflow.contents.value)

    def stop(self) -> None:
        """Stop the block."""
        self._call("bs_stop")

    @property
    def _shift(self) -> int:
        return BITS_OF_A_SAMPLE - self._bits

    def _call(self, function: str, *arguments: Any) -> None:
        if self._handle is None:
            raise ConnectionLostError("the oscilloscope is not open; it is opened anew for the next shot")
        self._check(function, getattr(self._library, function)(self._handle, *arguments))

    def _check(self, subject: str, code: int) -> None:
        if code == Status.OK:
            return
        known = code in list(Status)
        kind, remedy = ERRORS.get(Status(code), CORRECT) if known else UNKNOWN
        if kind is ConnectionLostError:
            self.close()
        status_text = Status(code).name if known else f"status {code:#x}"
        raise kind(f"oscilloscope {self._serial or '(any)'}: {subject} says {status_text}; {remedy}")
