"""A record is believed only if it is whole and passes its own trigger level where the trigger is."""

from types import SimpleNamespace

import numpy as np
import pytest

from hardware_drivers.daqmx.acquisition import Acquisition, _read_calibration
from hardware_drivers.daqmx.parameters import TransducerWiring
from hardware_drivers.errors import ConnectionLostError
from hardware_drivers.measurement import Calibration

SAMPLES, PRETRIGGER, RATE_HZ = 4_000, 1_000, 10e6
VOLTS_A_CODE = 5.1 / 2**15
LEVEL_V = 0.25


def acquisition(volts, *, triggered=True):
    """Return an acquisition whose reader delivers these volts."""

    def read(buffer, _samples, _timeout_s):
        buffer[0] = np.rint(volts / VOLTS_A_CODE)
        return volts.size

    return Acquisition(
        position="B",
        board=SimpleNamespace(label="PXIe-6386 01E16086"),
        task=None,
        reader=SimpleNamespace(read_int16=read),
        buffer=np.zeros((1, SAMPLES), dtype=np.int16),
        part_samples=SAMPLES,
        sample_rate_hz=RATE_HZ,
        pretrigger_samples=PRETRIGGER,
        calibration=Calibration(
            coefficients_v=np.array([0.0, VOLTS_A_CODE]), resolution_bits=16, range_v=5.0
        ),
        trigger_level_v=LEVEL_V,
        triggered=triggered,
        settings={},
    )


def wave(delay_samples=0):
    """Half a sine of 100 us that passes the level at the trigger, or so many samples later."""
    rise = np.arcsin(LEVEL_V / 2.5) / np.pi * 1_000
    phase = (np.arange(SAMPLES) - PRETRIGGER - delay_samples + rise) / 1_000
    return np.where((phase > 0.0) & (phase < 1.0), 2.5 * np.sin(np.pi * np.clip(phase, 0.0, 1.0)), 0.0)


@pytest.mark.parametrize("delay_samples", [-90, 0, 90])
def test_an_edge_near_its_trigger_is_believed(delay_samples):
    # Comparator and ADC may differ by the 10 us that the module allows: 100 samples.
    waveform = acquisition(wave(delay_samples)).read(1.0)
    assert waveform.pretrigger_samples == PRETRIGGER
    # Half a code of rounding.
    np.testing.assert_allclose(waveform.volts(), wave(delay_samples), rtol=0.0, atol=0.51 * VOLTS_A_CODE)


@pytest.mark.parametrize("volts", [np.zeros(SAMPLES), wave(500), wave(-500), np.full(SAMPLES, -1.0)])
def test_a_record_without_its_edge_is_not_the_one_that_triggered(volts):
    with pytest.raises(ConnectionLostError, match=r"whose level is 0\.25 V"):
        acquisition(volts).read(1.0)


def test_an_untriggered_record_has_no_edge_to_look_for():
    assert acquisition(np.zeros(SAMPLES), triggered=False).read(1.0).pretrigger_samples == 0


def test_a_record_keeps_its_counts_when_the_buffer_is_used_again():
    made = acquisition(wave())
    first = made.read(1.0)
    made.buffer[:] = 0
    assert first.counts.max() > 10_000


def test_volts_follow_the_polynomial_that_the_board_returns():
    polynomial_v = [1e-3, 1.02 * VOLTS_A_CODE, 1e-12, -1e-17]
    channel = SimpleNamespace(ai_dev_scaling_coeff=polynomial_v, ai_resolution=16.0)
    board = SimpleNamespace(label="PXIe-6386 01E16086", calibration_date="2026-01-12")
    calibration = _read_calibration(channel, TransducerWiring(board_serial="01E16086"), board)
    assert calibration.coefficients_v.tolist() == polynomial_v
