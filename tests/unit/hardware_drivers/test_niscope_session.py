"""Errors for an acquisition that reports success with inconsistent data."""

import math
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest

from hardware_drivers.errors import ConnectionLostError
from hardware_drivers.niscope.averaging import Codes
from hardware_drivers.niscope.parameters import ProbeWiring
from hardware_drivers.niscope.session import Setup, fetch_records

RECORDS, SAMPLES = 4, 64
GAIN_V = 2.0 / 65_536
WIRING = ProbeWiring(resource="PXI1Slot5", firing_delay_s=2e-6)
SETUP = Setup(
    sample_rate_hz=100e6,
    record_samples=SAMPLES,
    records=RECORDS,
    range_v=1.0,
    offset_v=0.0,
    resolution_bits=14,
    sample_bits=16,
    calibration_date="2026-05-04",
    calibration_temperature_c=41.5,
)


class Session:
    """An acquisition that returns the given records."""

    def __init__(self, **changes):
        self.changes = changes
        self.channels = {"0": self}

    def initiate(self):
        return nullcontext()

    def fetch_into(self, buffer, timeout):
        assert timeout == 1.5
        written = buffer.reshape(RECORDS, SAMPLES)
        for index in range(self.changes.get("written", RECORDS)):
            written[index] = 4 * index + np.arange(SAMPLES)
        return [self._waveform(index, written[index]) for index in range(self.changes.get("told", RECORDS))]

    def _waveform(self, index, samples):
        info = {
            "relative_initial_x": 2e-6,
            "absolute_initial_x": 10.0 + 1e-3 * index,
            "x_increment": 1e-8,
            "gain": GAIN_V,
            "offset": 1e-3,
            "samples": samples,
        }
        info |= self.changes.get("every", {})
        if index == RECORDS - 1:
            info |= {name: self.changes[name] for name in info if name in self.changes}
        return SimpleNamespace(**info)


def test_a_sound_acquisition_is_handed_on():
    fetched = fetch_records(Session(), SETUP, WIRING, 1.5)
    assert fetched.records.dtype == np.int16
    assert fetched.records.shape == (RECORDS, SAMPLES)
    np.testing.assert_array_equal(fetched.records[2], 8 + np.arange(SAMPLES))
    assert (fetched.gain_v, fetched.offset_v) == (GAIN_V, 1e-3)
    assert fetched.codes == Codes(width_bits=16, step=4)
    np.testing.assert_array_equal(fetched.first_sample_s, np.full(RECORDS, 2e-6))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"samples": np.zeros(SAMPLES - 1)}, "asked for 4 records of 64 samples"),
        ({"told": RECORDS - 1}, "asked for 4 records of 64 samples"),
        ({"written": RECORDS - 1}, "left the buffer as it was"),
        ({"written": 0}, "left the buffer as it was"),
        ({"x_increment": 1.01e-8}, "samples are"),
        ({"x_increment": math.nan}, "samples are"),
        ({"relative_initial_x": 0.0}, r"a record starts 0\.0 s after its trigger"),
        ({"relative_initial_x": math.nan}, "a record starts nan s after its trigger"),
        ({"absolute_initial_x": 10.002}, "handed over twice"),
        ({"gain": 2.0 * GAIN_V}, "gain and offset differ"),
        ({"offset": math.inf}, "gain and offset differ"),
    ],
)
def test_an_inconsistent_acquisition_is_not_a_record(changes, message):
    with pytest.raises(ConnectionLostError, match=message):
        fetch_records(Session(**changes), SETUP, WIRING, 1.5)


@pytest.mark.parametrize(("name", "value"), [("gain", math.nan), ("gain", 1e-3), ("offset", math.nan)])
def test_an_invalid_scaling_is_refused(name, value):
    with pytest.raises(ConnectionLostError):
        fetch_records(Session(every={name: value}), SETUP, WIRING, 1.5)


def test_a_trigger_within_a_sample_or_two_is_the_firing_pulse():
    early = Session(relative_initial_x=2e-6 - 1.5e-8)
    assert fetch_records(early, SETUP, WIRING, 1.5).first_sample_s[-1] == 2e-6 - 1.5e-8


def test_a_time_stamp_that_rolled_over_is_no_fault():
    assert fetch_records(Session(absolute_initial_x=1e-6), SETUP, WIRING, 1.5).records.shape == (
        RECORDS,
        SAMPLES,
    )


def test_boards_without_time_stamps_report_zero():
    unstamped = Session(every={"absolute_initial_x": 0.0})
    assert fetch_records(unstamped, SETUP, WIRING, 1.5).records.shape == (RECORDS, SAMPLES)
