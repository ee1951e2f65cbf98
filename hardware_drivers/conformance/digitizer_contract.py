"""Rules for every digitizer: inherit `DigitizerContract` and provide its fixtures."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

from hardware_drivers.conformance.bench import Keys, Strike
from hardware_drivers.conformance.records import require_storable_record
from hardware_drivers.errors import AcquisitionTimeoutError, ConfigurationError
from hardware_drivers.instruments import Acquired, Digitizer
from hardware_drivers.measurement import ShotKey

SHORT_TIMEOUT_S = 0.01
"""Waiting for a strike that never comes."""
OVERRUN_S = 20.0
"""A read may end so much later on a busy machine; one that waits for the strike itself never ends."""


def _acquire_record(digitizer: Digitizer, strike: Strike, key: ShotKey, timeout_s: float) -> Acquired:
    """Arm for a shot, strike it, and read and return its record; errors of the instrument pass through.

    ``timeout_s`` bounds the read.
    """
    digitizer.arm(key)
    strike(key)
    return digitizer.read(timeout_s)


class DigitizerContract:
    """Rules for a digitizer: arm, strike, read; everything else is rejected or harmless.

    A class that inherits the rules provides these fixtures.

    Fixtures
    --------
    digitizer : Digitizer
        The instrument under test, disarmed.
    strike : Strike
        A function that makes the key's transducer trigger the digitizer under test.
    keys : Keys
        Two shots of one position that the instrument knows.
    unknown_key : ShotKey
        A shot of a position that the instrument does not know.
    """

    @pytest.fixture
    def timeout_s(self) -> float:
        """Return a timeout in s, long enough for the instrument to deliver a struck record."""
        return 1.0

    @pytest.fixture
    def longest_read_s(self) -> float:
        """Return the longest time in s that a read of `SHORT_TIMEOUT_S` may take."""
        return SHORT_TIMEOUT_S + OVERRUN_S

    @pytest.fixture
    def monotonic_s(self) -> Callable[[], float]:
        """Return the function that reads the monotonic clock (s) by which reads are timed."""
        return time.monotonic

    def test_is_a_digitizer(self, digitizer: Digitizer) -> None:
        """Check that the instrument has the methods of `Digitizer`."""
        assert isinstance(digitizer, Digitizer)

    def test_a_strike_on_an_armed_digitizer_is_recorded(
        self, digitizer: Digitizer, strike: Strike, keys: Keys, timeout_s: float
    ) -> None:
        """Check that a strike gives a record with a pre-trigger and counts that are not all equal."""
        acquired = _acquire_record(digitizer, strike, keys[0], timeout_s)
        assert isinstance(acquired, Acquired)
        waveform = acquired.waveform
        assert 0 < waveform.pretrigger_samples < waveform.counts.size
        assert waveform.counts.min() < waveform.counts.max()

    def test_counts_are_read_only_codes_of_their_calibration(
        self, digitizer: Digitizer, strike: Strike, keys: Keys, timeout_s: float
    ) -> None:
        """Check that a record can be stored and its counts are within the codes of the ADC's resolution."""
        acquired = _acquire_record(digitizer, strike, keys[0], timeout_s)
        require_storable_record(acquired)
        lowest, highest = acquired.waveform.calibration.full_scale_counts
        counts = acquired.waveform.counts
        assert lowest <= counts.min() <= counts.max() <= highest, "codes fit the resolution"

    def test_records_of_one_position_have_one_shape_and_calibration(
        self, digitizer: Digitizer, strike: Strike, keys: Keys, timeout_s: float
    ) -> None:
        """Check that two records agree in shape, type, sample rate, pre-trigger and calibration."""
        first, second = (_acquire_record(digitizer, strike, key, timeout_s).waveform for key in keys)
        assert first.counts.shape == second.counts.shape
        assert first.counts.dtype == second.counts.dtype
        assert first.sample_rate_hz == second.sample_rate_hz
        assert first.pretrigger_samples == second.pretrigger_samples
        np.testing.assert_array_equal(first.calibration.coefficients_v, second.calibration.coefficients_v)

    def test_an_unknown_position_is_refused_by_name(self, digitizer: Digitizer, unknown_key: ShotKey) -> None:
        """Check that arming for an unknown position raises ConfigurationError with its name, unarmed."""
        with pytest.raises(ConfigurationError, match=unknown_key.position):
            digitizer.arm(unknown_key)
        with pytest.raises(ConfigurationError):
            digitizer.read(SHORT_TIMEOUT_S)

    def test_arming_twice_is_refused(self, digitizer: Digitizer, keys: Keys) -> None:
        """Check that arming an armed digitizer raises ConfigurationError."""
        digitizer.arm(keys[0])
        with pytest.raises(ConfigurationError):
            digitizer.arm(keys[1])

    def test_reading_unarmed_is_refused(self, digitizer: Digitizer) -> None:
        """Check that reading an unarmed digitizer raises ConfigurationError."""
        with pytest.raises(ConfigurationError):
            digitizer.read(SHORT_TIMEOUT_S)

    def test_reading_disarms(
        self, digitizer: Digitizer, strike: Strike, keys: Keys, timeout_s: float
    ) -> None:
        """Check that after reading a record a second read is refused and the digitizer can be armed again."""
        _acquire_record(digitizer, strike, keys[0], timeout_s)
        with pytest.raises(ConfigurationError):
            digitizer.read(SHORT_TIMEOUT_S)
        digitizer.arm(keys[1])

    def test_no_strike_times_out_and_disarms(self, digitizer: Digitizer, keys: Keys) -> None:
        """Check that a read without a strike raises AcquisitionTimeoutError and disarms."""
        digitizer.arm(keys[0])
        with pytest.raises(AcquisitionTimeoutError):
            digitizer.read(SHORT_TIMEOUT_S)
        with pytest.raises(ConfigurationError):
            digitizer.read(SHORT_TIMEOUT_S)
        digitizer.arm(keys[0])

    def test_waiting_is_bounded_by_its_timeout(
        self,
        digitizer: Digitizer,
        keys: Keys,
        longest_read_s: float,
        monotonic_s: Callable[[], float],
    ) -> None:
        """Check that a read without a strike ends within ``longest_read_s``."""
        digitizer.arm(keys[0])
        began_s = monotonic_s()
        with pytest.raises(AcquisitionTimeoutError):
            digitizer.read(SHORT_TIMEOUT_S)
        took_s = monotonic_s() - began_s
        assert took_s <= longest_read_s, f"read({SHORT_TIMEOUT_S:g}) came back after {took_s:.1f} s"

    def test_a_timeout_of_zero_is_refused(self, digitizer: Digitizer, keys: Keys) -> None:
        """Check that a read timeout of 0 s raises ConfigurationError with the name ``timeout_s``."""
        digitizer.arm(keys[0])
        with pytest.raises(ConfigurationError, match="timeout_s"):
            digitizer.read(0.0)

    def test_a_strike_before_arming_is_lost(self, digitizer: Digitizer, strike: Strike, keys: Keys) -> None:
        """Check that a strike before arming is not returned by a later read."""
        strike(keys[0])
        digitizer.arm(keys[0])
        with pytest.raises(AcquisitionTimeoutError):
            digitizer.read(SHORT_TIMEOUT_S)

    def test_disarming_forgets_the_strike(self, digitizer: Digitizer, strike: Strike, keys: Keys) -> None:
        """Check that a strike before disarming is not returned by a later read."""
        digitizer.arm(keys[0])
        strike(keys[0])
        digitizer.disarm()
        digitizer.arm(keys[1])
        with pytest.raises(AcquisitionTimeoutError):
            digitizer.read(SHORT_TIMEOUT_S)

    def test_disarming_is_harmless_at_any_time(self, digitizer: Digitizer, keys: Keys) -> None:
        """Check that disarming twice, armed or not, raises nothing; then reads are refused, arming works."""
        digitizer.disarm()
        digitizer.disarm()
        digitizer.arm(keys[0])
        digitizer.disarm()
        digitizer.disarm()
        with pytest.raises(ConfigurationError):
            digitizer.read(SHORT_TIMEOUT_S)
        digitizer.arm(keys[0])
