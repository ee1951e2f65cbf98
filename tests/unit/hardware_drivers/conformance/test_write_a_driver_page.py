"""The smallest driver keeps the rules, and without `disarm` breaks those that the page lists."""

import re
import tomllib
from pathlib import Path

import pytest
from support.offered_kinds import offer

from hardware_drivers.kinds import ROLES

pytest_plugins = ["pytester"]

ROOT = Path(__file__).parents[4]
PAGE = (ROOT / "docs/how-to/write-a-driver.md").read_text(encoding="utf-8")
PACKAGE, RIG, DRIVER, DOUBLE = (
    (ROOT / "examples/smallest_driver" / name).read_text(encoding="utf-8")
    for name in ("pyproject.toml", "rig.toml", "acme_scope.py", "acme_double.py")
)
(SOUND,) = re.findall(r"```text\n(.*?)```", PAGE, flags=re.DOTALL)
BROKEN = """\
kind: 10 kept, 0 broken
safety: 4 kept, 1 broken, 1 not tried
  broken: after an error nothing is armed[unplugged]
digitizer: 11 kept, 3 broken
  broken: records of one position have one shape and calibration
  broken: reading disarms
  broken: no strike times out and disarms
"""
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
