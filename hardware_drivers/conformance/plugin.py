"""Plugin of pytest: options that name an instrument, and a summary of the rules that passed or failed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from hardware_drivers.conformance.bench import Double
    from hardware_drivers.conformance.choice import ChosenInstrument

# Loaded by every pytest next to which solimon is installed: whatever is heavy comes with the suites.
_HERE = Path(__file__).parent
pytest.register_assert_rewrite(
    *(f"{__package__}.{file.stem}" for file in (*_HERE.glob("*_contract.py"), _HERE / "records.py"))
)

SUITES = "hardware_drivers.conformance.test_instrument"
RULE_TIMEOUT_S = 120.0
"""A rule whose call has not come back by then is broken: it has no bound."""
CHOSEN: pytest.StashKey[ChosenInstrument] = pytest.StashKey()
DOUBLE: pytest.StashKey[Double | None] = pytest.StashKey()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options ``--solimon-kind``, ``-config``, ``-double`` and ``-strike`` to pytest."""
    group = parser.getgroup("solimon", "an instrument against solimon's rules")
    group.addoption("--solimon-kind", metavar="NAME", help="kind of instrument, as its entry points call it")
    group.addoption(
        "--solimon-config",
        metavar="FILE",
        type=Path,
        help="TOML file with [rig.instruments.NAME] and [rig.positions.NAME] as for `solimon run`; without "
        "one the kind's own defaults are proved",
    )
    group.addoption(
        "--solimon-double",
        metavar="MODULE:NAME",
        help="a hardware_drivers.conformance.bench.Double that takes the instrument's place",
    )
    group.addoption(
        "--solimon-strike",
        action="store_true",
        help="let strikers of a real rig move and probes fire; only with a person at the rig",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Find kind, instrument and double that the options name, before collection, and stash them.

    Without ``--solimon-kind`` do nothing. Raise pytest's UsageError if one of them is not found.
    """
    kind, where = config.getoption("--solimon-kind"), config.getoption("--solimon-double")
    if not kind:
        return
    from hardware_drivers.conformance.choice import choose_instrument, import_double
    from hardware_drivers.errors import ConfigurationError

    try:
        config.stash[CHOSEN] = choose_instrument(kind, config.getoption("--solimon-config"))
        config.stash[DOUBLE] = import_double(where) if where else None
    except ConfigurationError as error:
        raise pytest.UsageError(str(error)) from error


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Parametrize the suites' rules that use ``fault``: one test for each fault of the double."""
    if metafunc.module.__name__ == SUITES and "fault" in metafunc.fixturenames:
        metafunc.parametrize("fault", _list_faults(metafunc.config))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect the suites and rules that the instrument cannot be tested by; set the timeout of each rule.

    ``items`` is changed. The timeout of `RULE_TIMEOUT_S` needs pytest-timeout. Raise UsageError if suites are
    collected without ``--solimon-kind``.
    """
    ours = [item for item in items if _find_suite_role(item) is not None]
    if not ours:
        return
    if CHOSEN not in config.stash:
        raise pytest.UsageError("which instrument? give --solimon-kind NAME, as its entry points call it")
    out = [item for item in ours if not _is_requested(item, config)]
    items[:] = [item for item in items if item not in out]
    config.hook.pytest_deselected(items=out)
    for item in ours:
        item.user_properties.append(("solimon_suite", _find_suite_role(item)))
        if config.pluginmanager.has_plugin("timeout") and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(RULE_TIMEOUT_S))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print for each suite the numbers of passed, failed and skipped rules, and the names of failed ones.

    Then print the roles and faults that were not tested. Without a rule that ran, print nothing.
    """
    rules_by_suite: dict[str, dict[str, list[str]]] = {}
    for outcome in ("passed", "failed", "error", "skipped"):
        for report in terminalreporter.getreports(outcome):
            suite = dict(getattr(report, "user_properties", ())).get("solimon_suite")
            if suite is not None:
                rules = rules_by_suite.setdefault(str(suite), {}).setdefault(outcome, [])
                # test_reading_disarms is the rule "reading disarms"
                rules.append(report.nodeid.rpartition("::")[2].removeprefix("test_").replace("_", " "))
    if not rules_by_suite:
        return
    chosen = config.stash[CHOSEN]
    terminalreporter.section(f"solimon's rules: {chosen.offer.name}, {chosen.offer.distributions[0]}")
    for suite, by_outcome in rules_by_suite.items():
        broken = [*by_outcome.get("failed", []), *by_outcome.get("error", [])]
        untried = len(by_outcome.get("skipped", []))
        counts = f"{suite}: {len(by_outcome.get('passed', []))} kept, {len(broken)} broken"
        terminalreporter.line(f"{counts}, {untried} not tried" if untried else counts)
        for rule in broken:
            terminalreporter.line(f"  broken: {rule}", red=True)
    if missing := [role for role in chosen.offer.roles if role not in chosen.serves]:
        terminalreporter.line(f"not proved: {', '.join(missing)}; no position of the configuration names it")
    if not _list_faults(config):
        terminalreporter.line("not proved: what it does when it fails; no double knows how")


def _list_faults(config: pytest.Config) -> tuple[str, ...]:
    """Return the names of the faults that the chosen double can inject; empty without a double."""
    double = config.stash.get(DOUBLE, None)
    return () if double is None else double.faults


def _is_requested(item: pytest.Item, config: pytest.Config) -> bool:
    """Return whether the chosen instrument has the role of the test's suite.

    False for a rule with ``fault`` if no double injects faults; suites ``kind`` and ``safety`` always apply.
    """
    if "fault" in getattr(item, "fixturenames", ()) and not _list_faults(config):
        return False
    return _find_suite_role(item) in {"kind", "safety", *config.stash[CHOSEN].serves}


def _find_suite_role(item: pytest.Item) -> str | None:
    """Return the role of the suite of a test, ``kind`` or ``safety``; None for a test of other modules."""
    cls = getattr(item, "cls", None)
    return cls.suite if cls is not None and cls.__module__ == SUITES else None
