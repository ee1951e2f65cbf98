"""What every striker must do: inherit `StrikerContract` and give its fixtures."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from hardware_drivers.errors import ConfigurationError
from hardware_drivers.instruments import Striker
from hardware_drivers.measurement import ShotKey

ON, OFF = True, False


class StrikerContract:
    """One pulse a strike, of the right coil, and off afterwards whatever happens."""

    @pytest.fixture
    def striker(self) -> Striker:
        """Return the instrument under test, every coil off."""
        raise NotImplementedError

    @pytest.fixture
    def coil_levels(self, striker: Striker) -> Callable[[], Sequence[tuple[str, bool]]]:
        """Return what reads all switchings so far, oldest first: position, on or off."""
        raise NotImplementedError

    @pytest.fixture
    def keys(self) -> tuple[ShotKey, ShotKey]:
        """Return shots of two positions the instrument knows."""
        raise NotImplementedError

    @pytest.fixture
    def unknown_key(self) -> ShotKey:
        """Return a shot of a position the instrument does not know."""
        raise NotImplementedError

    def test_is_a_striker(self, striker):
        assert isinstance(striker, Striker)

    def test_a_strike_is_one_pulse_of_its_own_coil(self, striker, coil_levels, keys):
        for key in keys:
            before = len(coil_levels())
            striker.strike(key)
            assert list(coil_levels())[before:] == [(key.position, ON), (key.position, OFF)]

    def test_an_unknown_position_is_refused_by_name_and_nothing_moves(
        self, striker, coil_levels, unknown_key
    ):
        with pytest.raises(ConfigurationError, match=unknown_key.position):
            striker.strike(unknown_key)
        assert list(coil_levels()) == []

    def test_making_safe_is_harmless_at_any_time(self, striker, coil_levels, keys):
        striker.make_safe()
        striker.make_safe()
        assert all(level is OFF for _, level in coil_levels())
        striker.strike(keys[0])
        striker.make_safe()
        assert coil_levels()[-1] == (keys[0].position, OFF)

    def test_making_safe_does_not_end_the_experiment(self, striker, coil_levels, keys):
        striker.make_safe()
        striker.strike(keys[0])
        assert (keys[0].position, ON) in coil_levels()
