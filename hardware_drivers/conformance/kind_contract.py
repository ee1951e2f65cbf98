"""Rules for every kind of instrument, independent of its roles: `KindContract`."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, suppress
from importlib.metadata import packages_distributions

import pytest
from pydantic import TypeAdapter, ValidationError

from hardware_drivers.errors import InstrumentError
from hardware_drivers.instruments import ClimateProbe, Digitizer, PowerSupply, PulseEchoUnit, Striker
from hardware_drivers.kinds import Finding, Kind, Opened, Opening, Role

PROTOCOLS: Mapping[Role, type] = {
    "digitizer": Digitizer,
    "striker": Striker,
    "pulse_echo": PulseEchoUnit,
    "supply": PowerSupply,
    "climate": ClimateProbe,
}
NO_KEY = "solimon_knows_no_such_key"
Open = Callable[[], AbstractContextManager[Opened]]


class KindContract:
    """Rules for a kind: parameters reject unknown keys; it can be opened, closed and opened again.

    A class that inherits the rules provides these fixtures.

    Fixtures
    --------
    kind : Kind[object]
        The kind under test.
    table : Mapping[str, object]
        Its parameters as a configuration gives them.
    module : str
        The module that its entry points name.
    opening : Opening
        The opening of the instrument under test.
    """

    @pytest.fixture
    def parameters(self, kind: Kind[object], table: Mapping[str, object]) -> object:
        """Return the parameters validated from the table; pydantic's ValidationError if it is not valid."""
        return TypeAdapter(kind.parameters).validate_python(table)

    @pytest.fixture
    def open_kind(self, kind: Kind[object], parameters: object, opening: Opening) -> Open:
        """Return a function whose call gives the context manager that opens the instrument."""
        return lambda: kind.open(parameters, opening)

    def test_unknown_parameters_are_refused(self, kind: Kind[object], table: Mapping[str, object]) -> None:
        """Check that an unknown key raises pydantic's ValidationError with the name of the key."""
        with pytest.raises(ValidationError, match=NO_KEY):
            TypeAdapter(kind.parameters).validate_python({**table, NO_KEY: 1})

    def test_parameters_cannot_be_changed(self, parameters: object) -> None:
        """Check that assigning any parameter raises AttributeError or pydantic's ValidationError."""
        for name in TypeAdapter(type(parameters)).dump_python(parameters):
            with pytest.raises((AttributeError, ValidationError)):
                setattr(parameters, name, getattr(parameters, name))

    def test_parameters_are_the_same_after_they_were_stored(
        self, kind: Kind[object], parameters: object
    ) -> None:
        """Check that parameters stored as JSON and read again give the same JSON."""
        adapter = TypeAdapter(kind.parameters)
        stored = adapter.dump_json(parameters)
        assert adapter.dump_json(adapter.validate_json(stored)) == stored

    def test_the_kind_describes_its_parameters_correctly(
        self, kind: Kind[object], parameters: object
    ) -> None:
        """Check that ``reached_by`` names parameters, packages are texts, the longest call is >= 0 s."""
        keys = TypeAdapter(kind.parameters).dump_python(parameters)
        assert all(path.partition(".")[0] in keys for path in kind.reached_by), "reached_by names parameters"
        assert all(isinstance(name, str) and name for name in kind.packages(parameters))
        longest_s = kind.longest_call_s(parameters)
        assert math.isfinite(longest_s)
        assert longest_s >= 0.0

    def test_reading_a_configuration_imports_none_of_its_packages(
        self, kind: Kind[object], parameters: object, module: str
    ) -> None:
        """Check in a new process that importing the kind's module imports none of its packages."""
        needed = {_normalize(name) for name in kind.packages(parameters)}
        if not needed:
            return
        heavy = [name for name, by in packages_distributions().items() if needed & set(map(_normalize, by))]
        program = f"import {module}, sys; print(*(name for name in {heavy!r} if name in sys.modules))"
        command = [sys.executable, "-c", program]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert done.stdout.split() == [], f"importing {module} imports them too; import them in `open`"

    def test_an_opened_instrument_has_the_requested_roles(self, open_kind: Open, opening: Opening) -> None:
        """Check that the opened instrument has each requested role and the methods of its Protocol."""
        with open_kind() as opened:
            for role in opening.serves:
                assert isinstance(getattr(opened, role), PROTOCOLS[role]), f"it opens no {role}"

    def test_the_identity_is_reported(self, open_kind: Open) -> None:
        """Check that all names and values of the identity are texts that are not empty."""
        with open_kind() as opened:
            identity = opened.identity
        assert all(isinstance(text, str) and text for item in identity.items() for text in item), identity

    def test_a_check_returns_findings_with_remedies(
        self, kind: Kind[object], parameters: object, opening: Opening
    ) -> None:
        """Check that the kind's check yields findings, each with a remedy unless its state is ``ok``.

        An InstrumentError may end the check.
        """
        found: list[Finding] = []
        with suppress(InstrumentError):  # ends the look as a failed finding
            found.extend(kind.check(parameters, opening))
        assert all(isinstance(finding, Finding) for finding in found)
        assert [finding for finding in found if finding.state != "ok" and not finding.remedy] == []

    def test_it_can_be_opened_again_after_closing(self, open_kind: Open, opening: Opening) -> None:
        """Check that the instrument opens three times in succession with all requested roles."""
        for _ in range(3):
            with open_kind() as opened:
                assert all(getattr(opened, role) is not None for role in opening.serves)

    def test_an_error_passes_through_and_it_can_be_opened_again(
        self, open_kind: Open, opening: Opening
    ) -> None:
        """Check that an error raised while it is open passes through its closing, and that it opens again."""
        with pytest.raises(_FailureAtTheRigError), open_kind():
            raise _FailureAtTheRigError
        with open_kind() as opened:
            assert all(getattr(opened, role) is not None for role in opening.serves)


class _FailureAtTheRigError(Exception):
    """Any error elsewhere while the instrument is open."""


def _normalize(distribution: str) -> str:
    """Normalize a distribution's name for comparison: lower case, hyphens for underscores."""
    return distribution.lower().replace("_", "-")
