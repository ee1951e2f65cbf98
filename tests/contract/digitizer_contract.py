"""What every digitizer must do: inherit `DigitizerContract` and give its fixtures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hardware_drivers.errors import AcquisitionTimeoutError, ConfigurationError
from hardware_drivers.instruments import Acquired, Digitizer
from hardware_drivers.measurement import ShotKey

TIMEOUT_S = 1.0
"""Long enough for any instrument to deliver what has been struck."""
SHORT_TIMEOUT_S = 0.01
"""Waiting for a strike that never comes."""


class DigitizerContract:
    """Arm, strike, read; everything else is refused or harmless."""

    @pytest.fixture
    def digitizer(self) -> Digitizer:
        """Return the instrument under test, disarmed."""
        raise NotImplementedError

    @pytest.fixture
    def strike(self, digitizer: Digitizer) -> Callable[[ShotKey], None]:
        """Return what makes the key's transducer trigger the digitizer under test."""
        raise NotImplementedError

    @pytest.fixture
    def keys(self) -> tuple[ShotKey, ShotKey]:
        """Return two shots of one position the instrument knows."""
        raise NotImplementedError

    @pytest.fixture
    def unknown_key(self) -> ShotKey:
        """Return a shot of a position the instrument does not know."""
        raise NotImplementedError

    def test_is_a_digitizer(self, digitizer):
        assert isinstance(digitizer, Digitizer)

    def test_a_strike_on_an_armed_digitizer_is_recorded(self, digitizer, strike, keys):
        digitizer.arm(keys[0])
        strike(keys[0])
        acquired = digitizer.read(TIMEOUT_S)
        assert isinstance(acquired, Acquired)
        waveform = acquired.waveform
        assert waveform.counts.dtype in (np.int16, np.int32)
        assert 0 < waveform.pretrigger_samples < waveform.counts.size
        assert not waveform.counts.flags.writeable
        assert np.ptp(waveform.counts) > 0
        assert all(isinstance(value, float) for value in acquired.truth.values())

    def test_records_of_one_position_have_one_shape_and_calibration(self, digitizer, strike, keys):
        waveforms = []
        for key in keys:
            digitizer.arm(key)
            strike(key)
            waveforms.append(digitizer.read(TIMEOUT_S).waveform)
        first, second = waveforms
        assert first.counts.shape == second.counts.shape
        assert first.counts.dtype == second.counts.dtype
        assert first.sample_rate_hz == second.sample_rate_hz
        assert first.pretrigger_samples == second.pretrigger_samples
        np.testing.assert_array_equal(first.calibration.coefficients_v, second.calibration.coefficients_v)

    def test_an_unknown_position_is_refused_by_name(self, digitizer, unknown_key):
        with pytest.raises(ConfigurationError, match=unknown_key.position):
            digitizer.arm(unknown_key)
        with pytest.raises(ConfigurationError):
            digitizer.read(SHORT_TIMEOUT_S)

    def test_arming_twice_is_refused(self, digitizer, keys):
        digitizer.arm(keys[0])
        with pytest.raises(ConfigurationError):
            digitizer.arm(keys[1])

    def test_reading_unarmed_is_refused(self, digitizer):
        with pytest.raises(ConfigurationError):
            digitizer.read(SHORT_TIMEOUT_S)

    def test_reading_disarms(self, digitizer, strike, keys):
        digitizer.arm(keys[0])
        strike(keys[0])
        digitizer.read(TIMEOUT_S)
        with pytest.raises(ConfigurationError):
            digitizer.read(SHORT_TIMEOUT_S)
        digitizer.arm(keys[1])

    def test_no_strike_times_out_and_disarms(self, digitizer, keys):
        digitizer.arm(keys[0])
        with pytest.raises(AcquisitionTimeoutError):
            digitizer.read(SHORT_TIMEOUT_S)
        with pytest.raises(ConfigurationError):
            digitizer.read(SHORT_TIMEOUT_S)
        digitizer.arm(keys[0])

    def test_a_strike_before_arming_is_lost(self, digitizer, strike, keys):
        strike(keys[0])
        digitizer.arm(keys[0])
        with pytest.raises(AcquisitionTimeoutError):
            digitizer.read(SHORT_TIMEOUT_S)

    def test_disarming_forgets_the_strike(self, digitizer, strike, keys):
        digitizer.arm(keys[0])
        strike(keys[0])
        digitizer.disarm()
        digitizer.arm(keys[1])
        with pytest.raises(AcquisitionTimeoutError):
            digitizer.read(SHORT_TIMEOUT_S)

    def test_disarming_is_harmless_at_any_time(self, digitizer, keys):
        digitizer.disarm()
        digitizer.disarm()
        digitizer.arm(keys[0])
        digitizer.disarm()
        digitizer.disarm()
        with pytest.raises(ConfigurationError):
            digitizer.read(SHORT_TIMEOUT_S)
        digitizer.arm(keys[0])
