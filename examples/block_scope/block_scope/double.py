"""Double of the maker's library, a Python object with the same functions: it samples given volts.

It writes where pointers point and answers in status codes. `as_library` puts it behind pointers to C
functions, so every call of the driver goes through ctypes as to the maker's own library.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from block_scope import api
from block_scope.api import Status
from hardware_drivers.conformance.bench import Bench, Double
from hardware_drivers.measurement import ShotKey

SERIAL = "BS0001/042"
INFO = (SERIAL, "Block Scope 4", "2.1.7", "2026-02-11")
WAVE_RATE_HZ = 50e6


@dataclass(frozen=True, slots=True, kw_only=True)
class _Block:
    """Block in progress.

    Attributes
    ----------
    samples
        Before and after the trigger.
    """

    channel: int
    range_v: float
    level: int
    rising: bool
    samples: tuple[int, int]
    interval_s: float


class ScopeDouble:
    """Oscilloscope at a USB port."""

    def __init__(self) -> None:
        self.plugged_in = True
        self.opened_elsewhere = False
        self._handle = 0
        self._last_handle = 0
        self._bits = 16
        self._channel, self._range_v = -1, 0.0
        self._trigger = (-1, 0, api.RISING)
        self._running: _Block | None = None
        self._taken: tuple[NDArray[np.int16], bool] | None = None

    # What happens to it ----------------------------------------------------------------------------

    def unplug(self) -> None:
        """Pull the cable: the handle becomes invalid."""
        self.plugged_in, self._handle, self._running, self._taken = False, 0, None, None

    def wave_arrives(self, volts_v: NDArray[np.float64], sample_rate_hz: float, channel: str = "A") -> None:
        """Start a voltage, shape (n_samples,), at an input; before and after it there is none."""
        block = self._running
        if block is None or self._taken is not None or api.CHANNELS.index(channel) != block.channel:
            return
        n_samples = max(2, int(volts_v.size / sample_rate_hz / block.interval_s))
        times_s = np.arange(n_samples) * block.interval_s
        sampled_v = np.interp(times_s, np.arange(volts_v.size) / sample_rate_hz, volts_v)
        codes = self._codes(sampled_v, block.range_v)
        passed = codes >= block.level if block.rising else codes <= block.level
        if not passed.any():
            return
        before, after = block.samples
        trigger = int(np.argmax(passed))
        record = np.concatenate([np.zeros(before), codes, np.zeros(after)])[
            trigger : trigger + before + after
        ]
        outside = bool((np.abs(sampled_v) > block.range_v).any())
        self._taken = record.astype(np.int16), outside

    def _codes(self, volts_v: NDArray[np.float64], range_v: float) -> NDArray[np.float64]:
        """Round to the resolution; fewer bits than 16 are in the upper ones."""
        highest = self._highest >> (16 - self._bits)
        return np.clip(np.rint(volts_v / range_v * highest), -highest, highest) * (1 << (16 - self._bits))

    @property
    def _highest(self) -> int:
        return ((1 << (self._bits - 1)) - 1) << (16 - self._bits)

    # The maker's functions -------------------------------------------------------------------------

    def bs_open_unit(self, handle: Any, serial: bytes, resolution_bits: int) -> int:
        """Open the unit of a serial number; empty: any."""
        if not self.plugged_in or serial not in (b"", SERIAL.encode("ascii")):
            return Status.NOT_FOUND
        if self.opened_elsewhere or self._handle:
            return Status.OPENED_ELSEWHERE
        if resolution_bits not in (8, 12, 14, 16):
            return Status.INVALID_PARAMETER
        self._last_handle += 1
        self._handle, self._bits = self._last_handle, resolution_bits
        handle.contents.value = self._handle
        return Status.OK

    def bs_close_unit(self, handle: int) -> int:
        """Close the unit."""
        status = self._status(handle)
        if status is Status.OK:
            self._handle, self._running, self._taken = 0, None, None
        return status

    def bs_get_unit_info(self, handle: int, text: Any, length: int, subject: int) -> int:
        """Write a text about the unit."""
        status = self._status(handle)
        if status is Status.OK:
            text_bytes = INFO[subject].encode("ascii")[: length - 1] + b"\0"
            ctypes.memmove(text, text_bytes, len(text_bytes))
        return status

    def bs_maximum_value(self, handle: int, value: Any) -> int:
        """Write the highest code at this resolution."""
        status = self._status(handle)
        if status is Status.OK:
            value.contents.value = self._highest
        return status

    def bs_get_timebase(self, handle: int, timebase: int, interval_ns: Any) -> int:
        """Write the interval of a timebase: 10 ns and its multiples."""
        status = self._status(handle)
        if status is Status.OK:
            interval_ns.contents.value = 10 * (timebase + 1)
        return status

    def bs_set_channel(self, handle: int, channel: int, enabled: int, range_number: int) -> int:
        """Enable an input with a range, or disable it."""
        status = self._status(handle)
        if status is Status.OK and enabled:
            self._channel, self._range_v = channel, api.RANGES_MV[range_number] / 1e3
        return status

    def bs_set_simple_trigger(self, handle: int, channel: int, level: int, direction: int, after: int) -> int:
        """Trigger when an input crosses a level; after `after` milliseconds in any case, 0: never."""
        status = self._status(handle)
        if status is Status.OK and (abs(level) > self._highest or after != api.NEVER):
            return Status.INVALID_PARAMETER
        self._trigger = (channel, level, direction)
        return status

    def bs_run_block(self, handle: int, before: int, after: int, timebase: int) -> int:
        """Sample until a trigger occurs and the block is full."""
        status = self._status(handle)
        if status is not Status.OK:
            return status
        if self._running is not None:
            return Status.BUSY
        channel, level, direction = self._trigger
        if channel != self._channel:
            return Status.INVALID_PARAMETER
        self._taken = None
        self._running = _Block(
            channel=channel,
            range_v=self._range_v,
            level=level,
            rising=direction == api.RISING,
            samples=(before, after),
            interval_s=10e-9 * (timebase + 1),
        )
        return Status.OK

    def bs_is_ready(self, handle: int, ready: Any) -> int:
        """Write whether the block is full."""
        status = self._status(handle)
        if status is Status.OK:
            ready.contents.value = int(self._taken is not None)
        return status

    def bs_get_values(self, handle: int, buffer: Any, n_samples: Any, overflow: Any) -> int:
        """Write the samples, their number, and whether the input exceeded its range."""
        status = self._status(handle)
        if status is not Status.OK:
            return status
        if self._taken is None:
            return Status.NO_SAMPLES_AVAILABLE
        codes, outside = self._taken
        given = min(n_samples.contents.value, codes.size)
        np.ctypeslib.as_array(buffer, shape=(given,))[:] = codes[:given]
        n_samples.contents.value, overflow.contents.value = given, int(outside)
        return Status.OK

    def bs_stop(self, handle: int) -> int:
        """Stop the block; harmless when there is none."""
        status = self._status(handle)
        if status is Status.OK:
            self._running = None
        return status

    def _status(self, handle: int) -> Status:
        if not self.plugged_in:
            return Status.NOT_RESPONDING
        return Status.OK if handle and handle == self._handle else Status.INVALID_HANDLE


def pulse_v(peak_v: float = 2.5, width_s: float = 50e-6, lasts_s: float = 1.3e-3) -> NDArray[np.float64]:
    """Return a solitary wave as seen by a sensor, at `WAVE_RATE_HZ`: a peak, then a smaller one."""
    times_s = np.arange(round(lasts_s * WAVE_RATE_HZ)) / WAVE_RATE_HZ
    pulses = [(peak_v, 3.0 * width_s), (0.4 * peak_v, 12.0 * width_s)]
    volts_v = np.zeros_like(times_s)
    for peak, at_s in pulses:
        volts_v += peak / np.cosh((times_s - at_s) / (width_s / 3.0)) ** 2
    return volts_v


def as_library(scope: ScopeDouble) -> SimpleNamespace:
    """Return the double in the form of `api.load`."""

    def function(name: str, arguments: tuple[Any, ...]) -> Any:
        prototype = ctypes.CFUNCTYPE(ctypes.c_uint32, *arguments)
        # Looked up at each call: a test may come between.
        return prototype(lambda *given: getattr(scope, name)(*given))  # noqa: PLW0108

    return SimpleNamespace(**{name: function(name, arguments) for name, arguments in api.PROTOTYPES.items()})


@contextmanager
def bench() -> Iterator[Bench]:
    """Connect the kind to a double, for the option `--solimon-double`."""
    scope = ScopeDouble()

    def strike(key: ShotKey) -> None:
        scope.wave_arrives(pulse_v(), WAVE_RATE_HZ)

    @contextmanager
    def fault(name: str) -> Iterator[None]:
        scope.unplug()
        scope.plugged_in = scope.opened_elsewhere = name == "taken"
        try:
            yield
        finally:
            scope.plugged_in, scope.opened_elsewhere = True, False

    with patch.object(api, "load", lambda name: as_library(scope)):
        yield Bench(strike=strike, fault=fault)


DOUBLE = Double(bench=bench, faults=("unplugged", "taken"))
"""`unplugged`: and plugged in again afterwards; `taken`: by another program before it is opened again."""
