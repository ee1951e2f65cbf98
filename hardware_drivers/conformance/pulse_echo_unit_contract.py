"""Rules for every pulse-echo unit: inherit `PulseEchoUnitContract` and provide its fixtures."""

from __future__ import annotations

import math

import pytest

from hardware_drivers.conformance.bench import Keys
from hardware_drivers.conformance.records import require_storable_record
from hardware_drivers.errors import ConfigurationError
from hardware_drivers.instruments import Echo, PulseEchoUnit
from hardware_drivers.measurement import ShotKey


class PulseEchoUnitContract:
    """Rules for a pulse-echo unit: fire, average, return.

    A class that inherits the rules provides these fixtures.

    Fixtures
    --------
    pulse_echo : PulseEchoUnit
        The instrument under test.
    keys : Keys
        Two shots of one position that the instrument knows.
    unknown_key : ShotKey
        A shot of a position that the instrument does not know.
    """

    @pytest.fixture
    def timeout_s(self) -> float:
        """Return a timeout in s, long enough for a record of all averages."""
        return 1.0

    def test_is_a_pulse_echo_unit(self, pulse_echo: PulseEchoUnit) -> None:
        """Check that the instrument has the methods of `PulseEchoUnit`."""
        assert isinstance(pulse_echo, PulseEchoUnit)

    def test_a_record_starts_at_the_firing_pulse_and_names_its_receiver(
        self, pulse_echo: PulseEchoUnit, keys: Keys, timeout_s: float
    ) -> None:
        """Check that a record can be stored, has no pre-trigger, and has gain (dB), offset (V) and averages.

        Its counts are not all equal.
        """
        echo = pulse_echo.acquire(keys[0], timeout_s)
        assert isinstance(echo, Echo)
        assert echo.waveform.pretrigger_samples == 0
        require_storable_record(echo)
        assert echo.waveform.counts.min() < echo.waveform.counts.max()
        assert echo.averages >= 1
        assert math.isfinite(echo.gain_db)
        assert math.isfinite(echo.offset_v)

    def test_records_of_one_position_have_one_shape(
        self, pulse_echo: PulseEchoUnit, keys: Keys, timeout_s: float
    ) -> None:
        """Check that two records agree in shape, sample rate, gain, offset and number of averages."""
        first, second = (pulse_echo.acquire(key, timeout_s) for key in keys)
        assert first.waveform.counts.shape == second.waveform.counts.shape
        assert first.waveform.sample_rate_hz == second.waveform.sample_rate_hz
        assert (first.gain_db, first.offset_v, first.averages) == (
            second.gain_db,
            second.offset_v,
            second.averages,
        )

    def test_an_unknown_position_is_refused_by_name(
        self, pulse_echo: PulseEchoUnit, unknown_key: ShotKey, timeout_s: float
    ) -> None:
        """Check that acquiring at an unknown position raises ConfigurationError with its name."""
        with pytest.raises(ConfigurationError, match=unknown_key.position):
            pulse_echo.acquire(unknown_key, timeout_s)

    def test_a_timeout_of_zero_is_refused(self, pulse_echo: PulseEchoUnit, keys: Keys) -> None:
        """Check that a timeout of 0 s raises ConfigurationError with the name ``timeout_s``."""
        with pytest.raises(ConfigurationError, match="timeout_s"):
            pulse_echo.acquire(keys[0], 0.0)
