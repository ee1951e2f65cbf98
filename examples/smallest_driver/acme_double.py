"""Provide a double of the maker's package, without its oscilloscope."""

import sys
from contextlib import contextmanager
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np

from hardware_drivers.conformance.bench import Bench, Double


class Scope:
    """Oscilloscope that records a wave when it is struck."""

    serial_number = "A-77"

    def __init__(self):
        self.plugged_in, self.codes_taken, self.armed = True, None, False

    def call(self):
        """Fail if it is unplugged."""
        if not self.plugged_in:
            raise ConnectionResetError("no answer")

    def arm(self, range_v, level_v, before, samples):
        """Prepare the wave of the next strike."""
        self.call()
        self.armed, self.codes_taken = True, None
        self.wave = np.zeros(samples, dtype=np.int16)
        self.wave[before : before + 500] = 900

    def strike(self, key):
        """Record the wave if it is armed."""
        if self.armed:
            self.codes_taken = self.wave

    def wait(self, timeout_s):
        """Return whether a waveform is recorded."""
        self.call()
        return self.codes_taken is not None  # no strike comes while it waits

    def codes(self):
        """Return the codes of the waveform."""
        self.call()
        return self.codes_taken

    def stop(self):
        """Disarm."""
        self.call()
        self.armed = False

    def close(self):
        """Do nothing: nothing is left open."""

    def open(self, address):
        """Return itself."""
        self.call()
        return self


@contextmanager
def bench():
    """Yield the double as the maker's package, with its faults."""
    scope = Scope()

    @contextmanager
    def fault(name):
        scope.plugged_in = False
        yield
        scope.plugged_in = True

    with patch.dict(sys.modules, acme=SimpleNamespace(open=scope.open)):
        yield Bench(strike=scope.strike, fault=fault)


DOUBLE = Double(bench=bench, faults=("unplugged",))
