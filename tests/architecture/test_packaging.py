"""Pinned packages, also for other systems, and the table of licences."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from support.licences import EXTRAS, OURS, brought, installed, needs, rows

ROOT = Path(__file__).parents[2]
PINS = {
    canonicalize_name(pin.name): pin
    for pin in map(Requirement, re.findall(r"^[^#\n]+", (ROOT / "constraints.txt").read_text(), re.MULTILINE))
}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
TESTED_ON = re.findall(r'"(3\.\d+)"', (ROOT / ".github/workflows/tests.yml").read_text(encoding="utf-8"))
SYSTEMS = {
    "linux": {"sys_platform": "linux", "platform_system": "Linux", "os_name": "posix"},
    "windows": {"sys_platform": "win32", "platform_system": "Windows", "os_name": "nt"},
}


def test_everything_installed_is_pinned():
    here = installed()
    for name in brought():
        version = here[name].version
        assert name in PINS, f"{name}=={version} is missing in constraints.txt"
        assert str(PINS[name].specifier) == f"=={version}"


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("python", sorted(set(TESTED_ON)))
def test_packages_for_another_system_are_pinned_for_it(system, python):
    """By what the installed packages say that they need there."""
    here = {**SYSTEMS[system], "python_version": python, "python_full_version": f"{python}.0"}
    found = {(name, str(wanted)): wanted for extra in EXTRAS for name, wanted in needs(extra, here)}
    for (name, text), wanted in found.items():
        needed = canonicalize_name(wanted.name)
        if needed == OURS:
            continue
        assert needed in PINS, f"{name} needs {text} on {system}: pin it"
        marker = PINS[needed].marker
        assert marker is None or marker.evaluate(here), f"{name} needs {needed} on {system}, too"
        version = str(PINS[needed].specifier).removeprefix("==")
        assert wanted.specifier.contains(version, prereleases=True), f"{name} needs {text}"
    assert len(found) > 100


def test_classifiers_name_the_versions_that_the_tests_run_on():
    named = {
        item.rpartition(" ")[2]
        for item in PROJECT["classifiers"]
        if re.fullmatch(r"Programming Language :: Python :: 3\.\d+", item)
    }
    assert named == set(TESTED_ON)
    assert PROJECT["requires-python"] == f">={min(TESTED_ON)}"


def test_licences_are_listed_as_the_packages_state_them():
    page = (ROOT / "docs/reference/licences.md").read_text(encoding="utf-8")
    listed = {name: row for row, name in re.findall(r"^(\| ([a-z0-9-]+) \|.*\|)$", page, flags=re.MULTILINE)}
    for name, row in rows().items():
        assert listed.get(name) == row, "`python -m support.licences` in tests/ prints the table"
    # Of the others some are for another system, some for pre-commit.
    assert set(PINS) == set(listed)
    assert set(EXTRAS) == set(PROJECT["optional-dependencies"])
