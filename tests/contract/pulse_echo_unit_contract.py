"""What every pulse-echo unit must do: inherit `PulseEchoUnitContract` and give its fixtures."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hardware_drivers.errors import ConfigurationError
from hardware_drivers.instruments import Echo, PulseEchoUnit
from hardware_drivers.measurement import ShotKey

TIMEOUT_S = 1.0


class PulseEchoUnitContract:
    """Fire, average, return."""

    @pytest.fixture
    def pulse_echo(self) -> PulseEchoUnit:
        """Return the instrument under test."""
        raise NotImplementedError

    @pytest.fixture
    def keys(self) -> tuple[ShotKey, ShotKey]:
        """Return two shots of one position the instrument knows."""
        raise NotImplementedError

    @pytest.fixture
    def unknown_key(self) -> ShotKey:
        """Return a shot of a position the instrument does not know."""
        raise NotImplementedError

    def test_is_a_pulse_echo_unit(self, pulse_echo):
        assert isinstance(pulse_echo, PulseEchoUnit)

    def test_a_record_starts_at_the_firing_pulse_and_names_its_receiver(self, pulse_echo, keys):
        echo = pulse_echo.acquire(keys[0], TIMEOUT_S)
        assert isinstance(echo, Echo)
        assert echo.waveform.pretrigger_samples == 0
        assert echo.waveform.counts.dtype in (np.int16, np.int32)
        assert np.ptp(echo.waveform.counts) > 0
        assert echo.averages >= 1
        assert math.isfinite(echo.gain_db)
        assert math.isfinite(echo.offset_v)
        assert all(isinstance(value, float) for value in echo.truth.values())

    def test_records_of_one_position_have_one_shape(self, pulse_echo, keys):
        first, second = (pulse_echo.acquire(key, TIMEOUT_S) for key in keys)
        assert first.waveform.counts.shape == second.waveform.counts.shape
        assert first.waveform.sample_rate_hz == second.waveform.sample_rate_hz
        assert (first.gain_db, first.offset_v, first.averages) == (
            second.gain_db,
            second.offset_v,
            second.averages,
        )

    def test_an_unknown_position_is_refused_by_name(self, pulse_echo, unknown_key):
        with pytest.raises(ConfigurationError, match=unknown_key.position):
            pulse_echo.acquire(unknown_key, TIMEOUT_S)
