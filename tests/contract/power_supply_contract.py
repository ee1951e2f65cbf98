"""What every power supply must do: inherit `PowerSupplyContract` and give its fixtures."""

from __future__ import annotations

import math

import pytest

from hardware_drivers.instruments import PowerSupply
from hardware_drivers.measurement import SupplyReading

TIMEOUT_S = 1.0


class PowerSupplyContract:
    """Measure; switch off; never on by itself."""

    @pytest.fixture
    def supply(self) -> PowerSupply:
        """Return the instrument under test, its output switched on by the test's own means."""
        raise NotImplementedError

    def test_is_a_power_supply(self, supply):
        assert isinstance(supply, PowerSupply)

    def test_a_reading_is_measured_and_dated(self, supply):
        reading = supply.read(TIMEOUT_S)
        assert isinstance(reading, SupplyReading)
        assert reading.output_on
        assert math.isfinite(reading.voltage_v)
        assert math.isfinite(reading.current_a)
        assert reading.stamp.utc_ns > 0

    def test_safe_means_off(self, supply):
        supply.make_safe()
        assert not supply.read(TIMEOUT_S).output_on

    def test_making_safe_is_harmless_when_off(self, supply):
        supply.make_safe()
        supply.make_safe()
        assert not supply.read(TIMEOUT_S).output_on

    def test_reading_never_switches_it_on_again(self, supply):
        supply.make_safe()
        assert not any(supply.read(TIMEOUT_S).output_on for _ in range(3))
