"""Every rule, applied to the instrument that the options of the command name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from typing import ClassVar

import pytest
from pydantic import TypeAdapter

from hardware_drivers.conformance.bench import Bench, CoilLevels, Keys, MachineClock, Order, Strike
from hardware_drivers.conformance.choice import ChosenInstrument
from hardware_drivers.conformance.climate_probe_contract import ClimateProbeContract
from hardware_drivers.conformance.digitizer_contract import OVERRUN_S, SHORT_TIMEOUT_S, DigitizerContract
from hardware_drivers.conformance.kind_contract import KindContract, Open
from hardware_drivers.conformance.plugin import CHOSEN, DOUBLE
from hardware_drivers.conformance.power_supply_contract import PowerSupplyContract
from hardware_drivers.conformance.pulse_echo_unit_contract import PulseEchoUnitContract
from hardware_drivers.conformance.safety_contract import SafetyContract
from hardware_drivers.conformance.striker_contract import StrikerContract
from hardware_drivers.instruments import ClimateProbe, Digitizer, PowerSupply, PulseEchoUnit, Striker
from hardware_drivers.kinds import Kind, Opened, Opening
from hardware_drivers.measurement import ShotKey

NOT_ALLOWED = "this moves a striker or fires a probe: give --solimon-strike, with a person at the rig"
TIMEOUT_S = 30.0
"""Of a read: a person who strikes by hand needs some seconds."""


class OnTheBench:
    """Fixtures of the suites, from the options."""

    suite: ClassVar[str]

    @pytest.fixture
    def bench(self, pytestconfig: pytest.Config) -> Iterator[Bench]:
        """Yield the bench of the double, left at the end of the rule; without a double yield an empty one."""
        double = pytestconfig.stash[DOUBLE]
        if double is None:
            yield Bench()
            return
        with double.bench() as bench:
            yield bench

    @pytest.fixture
    def chosen(self, pytestconfig: pytest.Config) -> ChosenInstrument:
        """Return the instrument, not opened, that the options of the command name."""
        return pytestconfig.stash[CHOSEN]

    @pytest.fixture
    def kind(self, chosen: ChosenInstrument) -> Kind[object]:
        """Return the kind under test."""
        return chosen.kind

    @pytest.fixture
    def table(self, chosen: ChosenInstrument, bench: Bench) -> Mapping[str, object]:
        """Return the instrument's configured parameters, with those of the running double in their place."""
        return {**chosen.table, **bench.parameters}

    @pytest.fixture
    def parameters(self, kind: Kind[object], table: Mapping[str, object]) -> object:
        """Return the parameters validated from the table; pydantic's ValidationError if it is invalid."""
        return TypeAdapter(kind.parameters).validate_python(table)

    @pytest.fixture
    def opening(self, chosen: ChosenInstrument, pytestconfig: pytest.Config) -> Opening:
        """Return the context in which the instrument is opened, with the machine's clock.

        Requests to a person are printed on the terminal.
        """
        capture = pytestconfig.pluginmanager.getplugin("capturemanager")

        def ask(request: str) -> None:
            """Print a request to a person past pytest's capture; an empty one prints nothing."""
            if request:
                with capture.global_and_fixture_disabled():
                    print(f"\n  {request}", flush=True)

        return Opening(clock=MachineClock(), serves=chosen.serves, ask=ask, experiment=chosen.configuration)

    @pytest.fixture
    def open_kind(self, kind: Kind[object], parameters: object, opening: Opening) -> Open:
        """Return a function whose call gives the context manager that opens the instrument."""
        return lambda: kind.open(parameters, opening)

    @pytest.fixture
    def opened(self, open_kind: Open) -> Iterator[Opened]:
        """Yield the opened instrument; close it at the end of the rule. Instrument errors pass through."""
        with open_kind() as opened:
            yield opened

    @pytest.fixture
    def allowed(self, pytestconfig: pytest.Config) -> None:
        """Skip the rule, which moves or fires equipment, unless there is a double or ``--solimon-strike``."""
        if pytestconfig.stash[DOUBLE] is None and not pytestconfig.getoption("--solimon-strike"):
            pytest.skip(NOT_ALLOWED)

    @pytest.fixture
    def keys(self, chosen: ChosenInstrument) -> Keys:
        """Return the keys of shots 0 and 1 of set 0 at the first position of the suite's role."""
        (position, *_) = next(names for role, names in chosen.serves.items() if role == self.suite)
        return tuple(ShotKey(position=position, set_index=0, shot_index=i) for i in (0, 1))

    @pytest.fixture
    def unknown_key(self) -> ShotKey:
        """Return the key of a shot at a position that no rig has (``nowhere``)."""
        return ShotKey(position="nowhere", set_index=0, shot_index=0)

    @pytest.fixture
    def timeout_s(self) -> float:
        """Return a timeout in s, long enough for a person who strikes by hand."""
        return TIMEOUT_S

    @pytest.fixture
    def coil_levels(self, bench: Bench) -> CoilLevels:
        """Return the bench's function that reads the switchings of coils; skip the rule if it has none."""
        if bench.coil_levels is None:
            pytest.skip("it has no coil, or what its coils did is unknown: a double's Bench.coil_levels")
        return bench.coil_levels


class TestKind(OnTheBench, KindContract):
    """Rules of the kind itself: nothing strikes, nothing is energised."""

    suite = "kind"

    @pytest.fixture
    def module(self, chosen: ChosenInstrument) -> str:
        """Return the name of the module that the entry point of the kind's first role names."""
        return next(iter(chosen.offer.by_role.values())).module


class TestSafety(OnTheBench, SafetyContract):
    """Rules for interruptions, and for each fault that the double can inject."""

    suite = "safety"

    @pytest.fixture
    def open_kind(self, kind: Kind[object], parameters: object, opening: Opening, allowed: None) -> Open:
        """Return a function whose call gives the context manager that opens the instrument.

        The rule is skipped unless strikes are allowed.
        """
        return lambda: kind.open(parameters, opening)


class TestDigitizer(OnTheBench, DigitizerContract):
    """Rules of the digitizer: arm, strike, read."""

    suite = "digitizer"

    @pytest.fixture
    def digitizer(self, opened: Opened) -> Digitizer:
        """Return the digitizer, disarmed; AssertionError if the kind opened none."""
        assert opened.digitizer is not None
        return opened.digitizer

    @pytest.fixture
    def strike(
        self,
        chosen: ChosenInstrument,
        bench: Bench,
        opened: Opened,
        opening: Opening,
        keys: Keys,
        allowed: None,
    ) -> Iterator[Strike]:
        """Yield a function that makes the key's transducer strike; skip the rule if nothing can strike.

        It is that of the double, of the instrument itself, or of the position's striker, opened for the rule.
        """
        if bench.strike is not None:
            yield bench.strike
            return
        kind, table = chosen.strikers.get(keys[0].position, (None, {}))
        with ExitStack() as stack:
            if kind is None:
                pytest.skip("nothing strikes at its position: give it a striker, or Bench.strike of a double")
            elif kind is chosen.kind:
                striker = opened.striker
            else:
                parameters = TypeAdapter(kind.parameters).validate_python(table)
                striker_opening = replace(opening, serves={"striker": (keys[0].position,)})
                striker = stack.enter_context(kind.open(parameters, striker_opening)).striker
            assert striker is not None
            yield striker.strike

    @pytest.fixture
    def longest_read_s(self, kind: Kind[object], parameters: object) -> float:
        """Return the longest time in s of a read of `SHORT_TIMEOUT_S`, the kind's longest call included."""
        return SHORT_TIMEOUT_S + OVERRUN_S + kind.longest_call_s(parameters)


class TestStriker(OnTheBench, StrikerContract):
    """Rules of the striker: one pulse per strike."""

    suite = "striker"

    @pytest.fixture
    def striker(self, opened: Opened, allowed: None) -> Striker:
        """Return the opened striker, every coil off; the rule is skipped unless strikes are allowed."""
        assert opened.striker is not None
        return opened.striker

    @pytest.fixture
    def keys(self, chosen: ChosenInstrument) -> Keys:
        """Return the keys of shot 0 of set 0 at the first one or two positions of the striker."""
        names = chosen.serves["striker"][:2]
        return tuple(ShotKey(position=name, set_index=0, shot_index=0) for name in names)


class TestPulseEcho(OnTheBench, PulseEchoUnitContract):
    """Rules of the pulse-echo unit: fire, average, return."""

    suite = "pulse_echo"

    @pytest.fixture
    def pulse_echo(self, opened: Opened, allowed: None) -> PulseEchoUnit:
        """Return the opened pulse-echo unit; the rule is skipped unless firing is allowed."""
        assert opened.pulse_echo is not None
        return opened.pulse_echo


class TestSupply(OnTheBench, PowerSupplyContract):
    """Rules of the supply, off unless commanded; only a double may be energised in a test."""

    suite = "supply"

    @pytest.fixture
    def supply(self, opened: Opened, order: Order) -> PowerSupply:
        """Return the supply, switched on by the double's command; the rule is skipped without a double."""
        assert opened.supply is not None
        opened.supply.energise(*order)
        return opened.supply

    @pytest.fixture
    def caps(self, bench: Bench) -> Order:
        """Return the double's caps (V, A); skip the rule without a double."""
        return _require_double_value(bench.caps)

    @pytest.fixture
    def order(self, bench: Bench) -> Order:
        """Return a command (V, A) that the double accepts; skip the rule without a double."""
        return _require_double_value(bench.order)


def _require_double_value(order: Order | None) -> Order:
    """Return a value of the double (V, A); skip the rule if it is None, as without a double."""
    if order is None:
        pytest.skip("no rule switches a supply that is no double's: Bench.caps and Bench.order")
    return order


class TestClimate(OnTheBench, ClimateProbeContract):
    """Rules of the climate probe: temperature and humidity, with time stamps."""

    suite = "climate"

    @pytest.fixture
    def climate(self, opened: Opened) -> ClimateProbe:
        """Return the climate probe; AssertionError if the kind opened none."""
        assert opened.climate is not None
        return opened.climate

    @pytest.fixture
    def air(self, bench: Bench) -> tuple[float, float]:
        """Return the double's temperature (degrees Celsius) and humidity (0 to 1); skip without a double."""
        if bench.air is None:
            pytest.skip("the true air is unknown: a double's Bench.air")
        return bench.air
