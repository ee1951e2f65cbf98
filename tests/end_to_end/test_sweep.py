"""`solimon simulate --sweep` as a whole process: killed, interrupted, and through the command line."""

import os
import re
import signal
import subprocess
from pathlib import Path

import pytest
from click.testing import CliRunner
from support.command_line import SOLIMON, first_match

from daq_service.cli.main import cli

LIMIT_S = 120.0
"""Far beyond any of these runs, on a loaded machine too: a hang ends in an error, not in silence."""

ROWS = 50
# Zener's model, because its rows take some 20 ms: time to be stopped in the middle.
SLOW = ("--model", "zener", "--sweep", f"corrosion.depth_fraction=0:0.5:{ROWS}")


def started(*arguments):
    # A session of its own: a signal can reach all of its processes at once, as a terminal's does.
    return subprocess.Popen(
        [*SOLIMON, "simulate", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        start_new_session=True,
    )


def simulate(*arguments):
    return CliRunner().invoke(cli, ["simulate", *arguments])


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the table of an undisturbed sweep, computed in one thread."""
    path = tmp_path_factory.mktemp("whole") / "table.csv"
    done = simulate(*SLOW, "--workers", "1", "--out", str(path))
    assert done.exit_code == 0, done.output
    return path


def test_a_sweep_killed_and_interrupted_goes_on_and_ends_with_the_same_bytes(whole, tmp_path):
    output = tmp_path / "table.csv"
    arguments = (*SLOW, "--workers", "1", "--out", str(output))
    with started(*arguments, "--executor", "processes") as process:
        first_match(process.stderr, r"\((1\d) %\)")
        process.kill()
        # Ends only when its worker has ended, too: that holds the other end of these pipes.
        process.communicate(timeout=LIMIT_S)
    assert not output.exists()
    finished = ROWS // 10
    if os.name != "nt":  # Windows has no signal of a terminal to send
        with started(*arguments, "--executor", "processes") as process:
            assert finished <= int(
                first_match(process.stderr, rf"^(\d+) of {ROWS} rows were finished before$")[1]
            )
            first_match(process.stderr, r"\(([34]\d) %\)")
            os.killpg(process.pid, signal.SIGINT)
            _, errors = process.communicate(timeout=LIMIT_S)
        assert process.returncode == 130, errors
        assert "Traceback" not in errors
        kept = re.search(rf"(\d+) of {ROWS} rows are kept in (.*); the same command goes on", errors)
        assert kept
        assert kept[2] == f"{output}.work"
        finished = int(kept[1])
    done = simulate(*arguments)
    assert done.exit_code == 0, done.output
    match = re.search(rf"^(\d+) of {ROWS} rows were finished before$", done.stderr, flags=re.MULTILINE)
    assert match, done.stderr
    assert finished <= int(match[1]) < ROWS
    assert output.read_bytes() == whole.read_bytes()
    assert Path(f"{output}.json").read_bytes() == Path(f"{whole}.json").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["table.csv", "table.csv.json"]


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setenv("SOLIMON_PLATE__ELEMENTS_PER_EDGE", "16")


@pytest.mark.usefixtures("quick")
def test_depths_is_short_for_a_sweep_of_the_depth(tmp_path):
    short, long = tmp_path / "short.csv", tmp_path / "long.csv"
    assert simulate("--depths", "0:0.8:3", "--out", str(short)).exit_code == 0
    assert simulate("--sweep", "corrosion.depth_fraction=0:0.8:3", "--out", str(long)).exit_code == 0
    assert short.read_bytes() == long.read_bytes()
