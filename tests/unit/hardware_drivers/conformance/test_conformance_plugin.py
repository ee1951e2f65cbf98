"""The installed plugin, run on kinds of instruments that break one rule: it names the rule, and no other."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from types import ModuleType

import pytest
from pydantic import BaseModel, ConfigDict
from support.broken_instruments import KEYS, SoundDigitizer, SoundStriker
from support.offered_kinds import offer

from hardware_drivers.conformance.bench import Bench, Double
from hardware_drivers.conformance.kind_contract import KindContract
from hardware_drivers.errors import BusyError, ConfigurationError, ConnectionLostError
from hardware_drivers.kinds import Finding, Kind, Opened

pytest_plugins = ["pytester"]

CONFIGURATION = f"""
[rig.instruments.mine]
kind = "scripted"

[rig.positions.{KEYS[0].position}]
digitizer = "mine"
striker = "mine"
"""
TWO_INSTRUMENTS = """
[rig.instruments.mine]
kind = "scripted"

[rig.instruments.hammer]
kind = "scripted-hammer"

[rig.positions.C]
digitizer = "mine"
striker = "hammer"
"""
OFFERED = {
    "scripted": {"digitizer": "scripted_kind:KIND", "striker": "scripted_kind:KIND"},
    "scripted-hammer": {"striker": "scripted_kind:HAMMER"},
}


class Cable:
    """Cable of a scripted instrument that its double can pull."""

    def __init__(self):
        self.pulled = False
        self.held = False

    def require(self):
        if self.pulled:
            raise ConnectionLostError("the cable is pulled; plug it in")


class Digitizer(SoundDigitizer):
    """Sound digitizer at a cable."""

    def __init__(self, cable):
        super().__init__()
        self.cable = cable

    def arm(self, key):
        super().arm(key)
        self.require_cable()

    def read(self, timeout_s):
        if self.armed is not None:
            self.require_cable()
        return super().read(timeout_s)

    def require_cable(self):
        try:
            self.cable.require()
        except ConnectionLostError:
            self.disarm()
            raise


class Striker(SoundStriker):
    """Sound striker at a cable; a coil without power is off."""

    def __init__(self, cable):
        super().__init__()
        self.cable = cable

    def strike(self, key):
        if key.position != KEYS[0].position:
            raise ConfigurationError(f"no striker at {key.position}")
        self.cable.require()
        self.levels += [(key.position, True), (key.position, False)]


class RaisesTheVendorsError(Digitizer):
    def arm(self, key):
        try:
            super().arm(key)
        except ConnectionLostError as error:
            raise OSError(f"errno 5: {error}") from error


class StaysArmedWhenUnplugged(Digitizer):
    def require_cable(self):
        self.cable.require()


class LeavesTheCoilOnWhenUnplugged(Striker):
    def strike(self, key):
        super().strike(key) if not self.cable.pulled else self.lose(key)

    def lose(self, key):
        self.levels.append((key.position, True))
        self.cable.require()


class Parameters(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
    range_v: float = 5.0


class TakesAnyKey(Parameters):
    model_config = ConfigDict(extra="ignore", frozen=True)


class CanBeChanged(Parameters):
    model_config = ConfigDict(extra="forbid", frozen=False)


def kind_of(
    *,
    digitizer=Digitizer,
    striker=Striker,
    parameters=Parameters,
    identity=None,
    closes=True,
    opening_raises=ConnectionLostError,
    leaving_raises=ConnectionLostError,
    remedy="look at it",
):
    """A sound kind but for what is given, its double, and a kind that strikes for it."""
    digitizers, strikers, cable = [], [], Cable()

    @contextmanager
    def open_it(parameters, opening):
        if cable.pulled:
            raise opening_raises("the cable is pulled")
        if cable.held:
            raise BusyError("it is open already")
        cable.held = True
        digitizers.append(digitizer(cable))
        strikers.append(striker(cable))
        try:
            yield Opened(
                digitizer=digitizers[-1],
                striker=strikers[-1],
                identity={"maker": "test"} if identity is None else identity,
            )
        finally:
            cable.held = not closes
            if cable.pulled:
                raise leaving_raises("the cable is pulled")

    def check(parameters, opening):
        yield Finding(subject="it", check="sound", state="warn", detail="so so", remedy=remedy)

    @contextmanager
    def fault(name):
        cable.pulled = True
        try:
            yield
        finally:
            cable.pulled = False

    def strike(key):
        digitizers[-1].strike(key)

    @contextmanager
    def bench():
        cable.held = False
        strikers.clear()
        yield Bench(
            strike=strike,
            coil_levels=lambda: [level for each in strikers for level in each.levels],
            fault=fault,
        )

    class Hammer(SoundStriker):
        def strike(self, key):
            digitizers[-1].strike(key)

    @contextmanager
    def open_hammer(parameters, opening):
        assert opening.serves == {"striker": ("C",)}
        yield Opened(striker=Hammer())

    return (
        Kind(parameters=parameters, open=open_it, check=check),
        Double(bench=bench, faults=("unplugged",)),
        Kind(parameters=Parameters, open=open_hammer, check=check),
    )


@pytest.fixture
def prove(pytester, monkeypatch):
    """Install a kind for this process and run the one command on it."""
    offer(monkeypatch, pytester.path / "site", OFFERED)
    # The other plugins that are installed here would be imported again for each run.
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    configuration = pytester.path / "rig.toml"
    configuration.write_text(CONFIGURATION)

    def run(*options, **broken):
        module = ModuleType("scripted_kind")
        module.KIND, module.DOUBLE, module.HAMMER = kind_of(**broken)
        monkeypatch.setitem(sys.modules, "scripted_kind", module)
        command = ["--pyargs", "hardware_drivers.conformance", "--solimon-kind", "scripted"]
        plugins = [
            "--tb=line",
            "--assert=plain",
            "-p",
            "no:cacheprovider",
            "-p",
            "hardware_drivers.conformance.plugin",
        ]
        return pytester.runpytest_inprocess(*plugins, *command, *options)

    return run


WITH_DOUBLE = ("--solimon-config", "rig.toml", "--solimon-double", "scripted_kind:DOUBLE")


def broken_rules(result):
    """Rules that the summary names, by suite."""
    return [line.removeprefix("  broken: ") for line in result.outlines if line.startswith("  broken: ")]


def test_a_sound_instrument_keeps_every_rule(prove):
    result = prove(*WITH_DOUBLE)
    assert result.ret == 0
    result.stdout.fnmatch_lines(
        [
            "*solimon's rules: scripted, lab-drivers 1.2*",
            "kind: 10 kept, 0 broken",
            "safety: 6 kept, 0 broken",
            "digitizer: 14 kept, 0 broken",
            "striker: 7 kept, 0 broken",
        ]
    )


@pytest.mark.parametrize(
    ("broken", "rules"),
    [
        ({"parameters": TakesAnyKey}, ["unknown parameters are refused"]),
        ({"parameters": CanBeChanged}, ["parameters cannot be changed"]),
        ({"identity": {"maker": ""}}, ["the identity is reported"]),
        ({"remedy": ""}, ["a check returns findings with remedies"]),
        (
            {"closes": False},
            [
                "it can be opened again after closing",
                "an error passes through and it can be opened again",
                "it is safe after an interruption",
                "after a fault it can be opened again[unplugged]",
            ],
        ),
        ({"leaving_raises": OSError}, ["after a fault it can be opened again[unplugged]"]),
        ({"opening_raises": OSError}, ["opening fails by errors of hardware drivers only[unplugged]"]),
        (
            {"digitizer": RaisesTheVendorsError},
            [
                "calls fail by errors of hardware drivers only[unplugged]",
                "after a fault it can be opened again[unplugged]",
            ],
        ),
        ({"digitizer": StaysArmedWhenUnplugged}, ["after an error nothing is armed[unplugged]"]),
        ({"striker": LeavesTheCoilOnWhenUnplugged}, ["after an error every coil is off[unplugged]"]),
    ],
    ids=lambda given: (
        "-".join(str(getattr(value, "__name__", key)) for key, value in given.items())
        if isinstance(given, dict)
        else ""
    ),
)
def test_a_broken_rule_is_named_and_no_other(prove, broken, rules):
    result = prove(*WITH_DOUBLE, **broken)
    assert result.ret == 1
    assert sorted(broken_rules(result)) == sorted(rules)
    for rule in rules:
        result.stdout.fnmatch_lines([f"FAILED *::test_{rule.replace(' ', '_').replace('[', '[[]')}*"])


def test_nothing_moves_on_a_real_instrument_without_permission(prove):
    result = prove("--solimon-config", "rig.toml", "-rs", striker=MovesInEarnest)
    assert result.ret == 0
    result.stdout.fnmatch_lines(
        ["striker: 0 kept, 0 broken, 7 not tried", "not proved: what it does when it fails*"]
    )
    result.stdout.fnmatch_lines(["*--solimon-strike*"])


class MovesInEarnest(Striker):
    def strike(self, key):
        raise AssertionError("a striker moved")


def test_the_striker_of_the_position_strikes_with_permission(prove):
    result = prove("--solimon-config", "rig.toml", "--solimon-strike", striker=MovesInEarnest)
    assert "a strike on an armed digitizer is recorded" in broken_rules(result)
    assert "a striker moved" in result.stdout.str()


def test_another_instrument_of_the_position_strikes_for_a_digitizer(prove, pytester):
    (pytester.path / "beside.toml").write_text(TWO_INSTRUMENTS)
    result = prove("--solimon-config", "beside.toml", "--solimon-strike")
    assert result.ret == 0
    result.stdout.fnmatch_lines(
        ["digitizer: 14 kept, 0 broken", "not proved: striker; no position of the configuration names it"]
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--solimon-kind", "nobodys"], "no installed package offers the kind 'nobodys'"),
        (["--solimon-config", "missing.toml"], "missing.toml cannot be read"),
        (["--solimon-config", "other.toml"], "has 0 instruments of the kind 'scripted'"),
        (["--solimon-config", "broken.toml"], "is no TOML file"),
        (["--solimon-double", "scripted_kind:NONE"], "no double 'scripted_kind:NONE'"),
        (["--solimon-double", "scripted_kind:KIND"], "scripted_kind:KIND is a Kind"),
    ],
)
def test_wrong_options_are_reported_before_anything_is_opened(prove, pytester, options, message):
    (pytester.path / "other.toml").write_text("[rig.instruments]")
    (pytester.path / "broken.toml").write_text("[rig")
    result = prove(*options)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines([f"*{message}*"])


@pytest.mark.parametrize(("module", "is_light"), [("hardware_drivers.errors", True), ("numpy.random", False)])
def test_a_kind_whose_module_imports_its_package_is_refused(module, is_light):
    kind = Kind(parameters=Parameters, open=None, check=None, packages=lambda parameters: ["NumPy"])
    rule = KindContract().test_reading_a_configuration_imports_none_of_its_packages
    if is_light:
        rule(kind, Parameters(), module)
        return
    with pytest.raises(AssertionError, match="imports them too"):
        rule(kind, Parameters(), module)
