"""Rules for every striker: inherit `StrikerContract` and provide its fixtures."""

from __future__ import annotations

import pytest

from hardware_drivers.conformance.bench import CoilLevels, Keys
from hardware_drivers.errors import ConfigurationError
from hardware_drivers.instruments import Striker
from hardware_drivers.measurement import ShotKey

ON, OFF = True, False


class StrikerContract:
    """Rules for a striker: one pulse per strike, of the right coil, and off afterwards after any error.

    A class that inherits the rules provides these fixtures.

    Fixtures
    --------
    striker : Striker
        The instrument under test, every coil off.
    coil_levels : CoilLevels
        A function that reads all switchings, oldest first: position, on or off.
    keys : Keys
        A shot of each of up to two positions that the striker knows.
    unknown_key : ShotKey
        A shot of a position that the instrument does not know.
    """

    def test_is_a_striker(self, striker: Striker) -> None:
        """Check that the instrument has the methods of `Striker`."""
        assert isinstance(striker, Striker)

    def test_a_strike_is_one_pulse_of_its_own_coil(
        self, striker: Striker, coil_levels: CoilLevels, keys: Keys
    ) -> None:
        """Check that each strike switches the coil of its position on once, then off, and no other."""
        for key in keys:
            before = len(coil_levels())
            striker.strike(key)
            assert list(coil_levels())[before:] == [(key.position, ON), (key.position, OFF)]

    def test_an_unknown_position_is_refused_by_name(self, striker: Striker, unknown_key: ShotKey) -> None:
        """Check that a strike at an unknown position raises ConfigurationError with its name."""
        with pytest.raises(ConfigurationError, match=unknown_key.position):
            striker.strike(unknown_key)

    def test_a_refused_strike_moves_nothing(
        self, striker: Striker, coil_levels: CoilLevels, unknown_key: ShotKey
    ) -> None:
        """Check that a strike at an unknown position is refused and switches no coil on."""
        before = len(coil_levels())
        with pytest.raises(ConfigurationError):
            striker.strike(unknown_key)
        assert not any(level for _, level in coil_levels()[before:])

    def test_making_safe_twice_is_harmless(self, striker: Striker) -> None:
        """Check that a second `make_safe` raises nothing."""
        striker.make_safe()
        striker.make_safe()

    def test_making_safe_is_never_a_pulse(
        self, striker: Striker, coil_levels: CoilLevels, keys: Keys
    ) -> None:
        """Check that `make_safe` switches no coil on, and that the struck coil is off after it."""
        before = len(coil_levels())
        striker.make_safe()
        assert all(level is OFF for _, level in coil_levels()[before:])
        striker.strike(keys[0])
        striker.make_safe()
        assert coil_levels()[-1] == (keys[0].position, OFF)

    def test_making_safe_does_not_end_the_test(
        self, striker: Striker, coil_levels: CoilLevels, keys: Keys
    ) -> None:
        """Check that the striker strikes again after `make_safe`."""
        striker.make_safe()
        striker.strike(keys[0])
        assert (keys[0].position, ON) in coil_levels()
