"""The examples' drivers, installed as a laboratory would, by the command of their pages."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
COMMANDS = {
    re.findall(r"--solimon-kind (\S+)", command)[0]: (example, command)
    for example in ("block_scope", "manual_striker")
    for command in re.findall(
        r"^    (pytest --pyargs .+)$", (EXAMPLES / example / "README.md").read_text("utf-8"), re.MULTILINE
    )
}
KEPT = {
    "block-scope": {"kind": "10 kept", "digitizer": "14 kept", "safety": "9 kept"},
    "hand-striker": {"kind": "10 kept", "striker": "3 kept"},
    "relay-striker": {"kind": "10 kept", "striker": "7 kept", "safety": "13 kept"},
}
"""Fewest rules that each suite tries on a double: skipped ones prove nothing."""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Return a folder with both packages, which are nowhere else on the path."""
    site = tmp_path_factory.mktemp("site")
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-index", "--no-deps", "--no-build-isolation"]
    packages = []
    for example in ("block_scope", "manual_striker"):
        # Built from a copy: a build may write next to the sources.
        packages.append(tmp_path_factory.mktemp(example) / example)
        shutil.copytree(EXAMPLES / example, packages[-1], ignore=shutil.ignore_patterns("__pycache__"))
    done = subprocess.run(
        [*pip, "--no-compile", "--target", site, *packages], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return site


@pytest.mark.parametrize("kind", KEPT)
def test_an_example_keeps_every_rule_by_its_page_s_command(kind, site, tmp_path):
    example, command = COMMANDS[kind]
    for name in ("rig.toml", "tests"):
        source = EXAMPLES / example / name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, tmp_path / name)
    done = subprocess.run(
        # In addition to the suites its own tests, which are named after it.
        [
            sys.executable,
            "-m",
            *shlex.split(command),
            *tmp_path.glob(f"tests/test_{kind.replace('-', '_')}.py"),
        ],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    counts = dict(re.findall(r"^(\w+): (\d+ kept, \d+ broken.*)$", done.stdout, re.MULTILINE))
    assert {suite: counts[suite].partition(",")[0] for suite in KEPT[kind]} == KEPT[kind]
    assert all(", 0 broken" in line for line in counts.values())
    assert f"solimon's rules: {kind}, solimon-{example.replace('_', '-')} 0.1.0" in done.stdout
    assert re.search(r"^tests.test_\w+\.py \.+", done.stdout, re.MULTILINE), "its own tests ran, too"
