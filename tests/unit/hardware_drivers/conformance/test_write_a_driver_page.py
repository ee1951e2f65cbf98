"""The driver of the page for those who write one: it keeps the rules, and breaks those that the page says."""

import re
import tomllib
from pathlib import Path

import pytest
from support.offered_kinds import offer

from hardware_drivers.kinds import ROLES

pytest_plugins = ["pytester"]

PAGE = (Path(__file__).parents[4] / "docs/how-to/write-a-driver.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(python|toml|sh|text)\n(.*?)```", PAGE, flags=re.DOTALL)
PACKAGE, RIG = (text for language, text in BLOCKS if language == "toml")
DRIVER, DOUBLE = (text for language, text in BLOCKS if language == "python")
SOUND, BROKEN = (text for language, text in BLOCKS if language == "text")
(COMMAND,) = re.findall(r"^pytest (.+)$", PAGE, flags=re.MULTILINE)
DISARMING = "        finally:\n            self.disarm()\n        range_v"


@pytest.mark.parametrize(
    ("driver", "expected"),
    [
        pytest.param(DRIVER, SOUND, id="as it stands"),
        pytest.param(
            DRIVER.replace(DISARMING, "        finally:\n            pass\n        range_v"),
            BROKEN,
            id="never disarmed",
        ),
    ],
)
def test_the_command_of_the_page_prints_its_documented_output(driver, expected, pytester, monkeypatch):
    assert DISARMING in DRIVER
    package = tomllib.loads(PACKAGE)["project"]
    offered = {
        name: {role: module}
        for role in ROLES
        for name, module in package["entry-points"].get(f"solimon.{role}", {}).items()
    }
    offer(monkeypatch, pytester.path / "site", offered, distribution=package["name"])
    pytester.makepyfile(acme_scope=driver, acme_double=DOUBLE)
    monkeypatch.syspath_prepend(pytester.path)
    (pytester.path / "rig.toml").write_text(RIG, encoding="utf-8")
    # The other plugins that are installed here would be imported again for each run.
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    plugins = [
        "--tb=line",
        "--assert=plain",
        "-p",
        "no:cacheprovider",
        "-p",
        "hardware_drivers.conformance.plugin",
    ]
    result = pytester.runpytest_inprocess(*plugins, *COMMAND.split())
    output = result.outlines[result.outlines.index(expected.splitlines()[0]) :]
    assert output[: len(expected.splitlines())] == expected.splitlines()
    assert result.ret == (1 if expected == BROKEN else 0)
