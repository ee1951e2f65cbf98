"""Rules for every power supply: inherit `PowerSupplyContract` and provide its fixtures."""

from __future__ import annotations

import math

import pytest

from hardware_drivers.conformance.bench import Order
from hardware_drivers.errors import ConfigurationError
from hardware_drivers.instruments import PowerSupply
from hardware_drivers.measurement import SupplyReading

TIMEOUT_S = 10.0


class PowerSupplyContract:
    """Rules for a supply: it measures, switches off, and switches on only by `energise` within the caps.

    A class that inherits the rules provides these fixtures.

    Fixtures
    --------
    supply : PowerSupply
        The instrument under test, its output switched on by the test's own means.
    """

    @pytest.fixture
    def caps(self) -> Order:
        """Return the configured caps: voltage in V, current limit in A."""
        return 12.0, 2.0

    @pytest.fixture
    def order(self) -> Order:
        """Return a command, voltage in V and current limit in A, within the caps.

        The load must not reach that current limit.
        """
        return 8.0, 1.5

    def test_is_a_power_supply(self, supply: PowerSupply) -> None:
        """Check that the instrument has the methods of `PowerSupply`."""
        assert isinstance(supply, PowerSupply)

    def test_a_reading_is_measured_and_dated(self, supply: PowerSupply) -> None:
        """Check that a reading has finite voltage and current, a time stamp, and the output on."""
        reading = supply.read(TIMEOUT_S)
        assert isinstance(reading, SupplyReading)
        assert reading.output_on
        assert math.isfinite(reading.voltage_v)
        assert math.isfinite(reading.current_a)
        assert reading.stamp.utc_ns > 0

    def test_safe_means_off(self, supply: PowerSupply) -> None:
        """Check that the output is off after `make_safe`."""
        supply.make_safe()
        assert not supply.read(TIMEOUT_S).output_on

    def test_making_safe_is_harmless_when_off(self, supply: PowerSupply) -> None:
        """Check that a second `make_safe` raises nothing and leaves the output off."""
        supply.make_safe()
        supply.make_safe()
        assert not supply.read(TIMEOUT_S).output_on

    def test_reading_never_switches_it_on_again(self, supply: PowerSupply) -> None:
        """Check that three readings leave an output that is off as it is."""
        supply.make_safe()
        assert not any(supply.read(TIMEOUT_S).output_on for _ in range(3))

    def test_energise_switches_on_at_the_requested_values(self, supply: PowerSupply, order: Order) -> None:
        """Check that `energise` switches on; voltage within 1 %, current positive and not above the limit."""
        supply.make_safe()
        voltage_v, current_limit_a = order
        supply.energise(voltage_v, current_limit_a)
        reading = supply.read(TIMEOUT_S)
        assert reading.output_on
        # Bench supplies set and measure within 0.1 % + 10 mV; 1 % separates 8 V from any other command.
        assert reading.voltage_v == pytest.approx(voltage_v, rel=0.01)
        assert 0.0 < reading.current_a <= current_limit_a

    def test_a_command_replaces_the_previous_one(self, supply: PowerSupply, order: Order) -> None:
        """Check that a second `energise` sets its own voltage, within 1 %."""
        voltage_v, current_limit_a = order
        supply.energise(voltage_v, current_limit_a)
        supply.energise(voltage_v / 2, current_limit_a)
        assert supply.read(TIMEOUT_S).voltage_v == pytest.approx(voltage_v / 2, rel=0.01)  # as above

    def test_it_stays_off_above_the_caps(self, supply: PowerSupply, caps: Order, order: Order) -> None:
        """Check that a command above a cap, not positive or NaN raises ConfigurationError with the value.

        The output stays off.
        """
        supply.make_safe()
        voltage_v, current_limit_a = order
        for refused in (
            (caps[0] * 1.001, current_limit_a),
            (voltage_v, caps[1] * 1.001),
            (-voltage_v, current_limit_a),
            (voltage_v, 0.0),
            (math.nan, current_limit_a),
        ):
            with pytest.raises(ConfigurationError) as refusal:
                supply.energise(*refused)
            value = next(value for value in refused if value not in order)
            assert f"{value:g}" in str(refusal.value), "the message names the refused value"
            assert not supply.read(TIMEOUT_S).output_on

    def test_the_identity_is_reported(self, supply: PowerSupply) -> None:
        """Check that a supply reports maker and model, as texts, and the same in a second query."""
        identity = supply.identity()
        assert identity["maker"]
        assert identity["model"]
        assert all(isinstance(text, str) for text in identity.values())
        assert supply.identity() == identity

    def test_a_timeout_of_zero_is_refused(self, supply: PowerSupply) -> None:
        """Check that a read timeout of 0 s raises ConfigurationError with the name ``timeout_s``."""
        with pytest.raises(ConfigurationError, match="timeout_s"):
            supply.read(0.0)
