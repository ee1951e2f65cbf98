"""Rules for every climate probe: inherit `ClimateProbeContract` and provide its fixtures."""

from __future__ import annotations

import pytest

from hardware_drivers.errors import ConfigurationError
from hardware_drivers.instruments import ClimateProbe
from hardware_drivers.measurement import ClimateReading

TIMEOUT_S = 10.0


class ClimateProbeContract:
    """Rules for a climate probe: it measures air temperature and humidity, with time stamps.

    A class that inherits the rules provides these fixtures.

    Fixtures
    --------
    climate : ClimateProbe
        The instrument under test in the air of `air`.
    """

    TOLERANCE = (1.0, 0.05)
    """How far the probe may be off: of the order of a good sensor's error."""

    @pytest.fixture
    def air(self) -> tuple[float, float]:
        """Return temperature in degrees Celsius and relative humidity (0 to 1) at the probe."""
        return 22.0, 0.45

    def test_is_a_climate_probe(self, climate: ClimateProbe) -> None:
        """Check that the instrument has the methods of `ClimateProbe`."""
        assert isinstance(climate, ClimateProbe)

    def test_a_reading_is_in_degrees_celsius_and_a_fraction(
        self, climate: ClimateProbe, air: tuple[float, float]
    ) -> None:
        """Check that a reading (degrees Celsius, humidity 0 to 1) is within `TOLERANCE` of the true air."""
        reading = climate.read(TIMEOUT_S)
        assert isinstance(reading, ClimateReading)
        assert abs(reading.temperature_c - air[0]) <= self.TOLERANCE[0]
        assert abs(reading.relative_humidity - air[1]) <= self.TOLERANCE[1]

    def test_readings_are_dated_in_order(self, climate: ClimateProbe) -> None:
        """Check that three readings have UTC, the same boot, and monotonic times that do not decrease."""
        stamps = [climate.read(TIMEOUT_S).stamp for _ in range(3)]
        assert all(stamp.utc_ns > 0 for stamp in stamps)
        assert len({stamp.boot_id for stamp in stamps}) == 1
        times = [stamp.mono_ns for stamp in stamps]
        assert times == sorted(times)

    def test_a_timeout_of_zero_is_refused(self, climate: ClimateProbe) -> None:
        """Check that a read timeout of 0 s raises ConfigurationError with the name ``timeout_s``."""
        with pytest.raises(ConfigurationError, match="timeout_s"):
            climate.read(0.0)
