"""Drivers and vendors' libraries that end the process: no exit code of theirs ends a test."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.command_line import solimon_here
from support.offered_kinds import offer
from support.scripted_kinds import OFFERED, begin_script
from test_mixed_rigs import HAMMER, SCOPE, mixed, set_rows

from daq_service.cli import run as cli_run
from daq_service.processes.data_folder import prepare_data_folder, write_configuration

PLACES = {"C": ("scope", "hammer")}
DRIVER = """
import os
from pathlib import Path
from support import scripted_kinds
from support.scripted_kinds import HAMMER, SCOPE

ENDED, ENDINGS = Path(__file__).with_name("ended"), {endings!r}

def end(event):
    number = ENDED.stat().st_size if ENDED.exists() else 0
    if event == "read C" and number < len(ENDINGS):
        with ENDED.open("a") as file:
            file.write("x")
        exec(ENDINGS[number])

scripted_kinds.SCRIPT.fails = end
"""


@pytest.mark.parametrize(
    "endings",
    [
        ["os._exit(0)"],
        pytest.param(
            ["raise SystemExit(3)", "os._exit(130)", "raise KeyboardInterrupt", "os._exit(4)"],
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_driver_that_ends_the_recorder_costs_no_set(endings, tmp_path, monkeypatch):
    site, folder = tmp_path / "site", tmp_path / "data"
    offered = {"ending-scope": {"digitizer": "ending:SCOPE"}, "ending-hammer": {"striker": "ending:HAMMER"}}
    offer(monkeypatch, site, offered)
    (site / "ending.py").write_text(DRIVER.format(endings=endings), encoding="utf-8")
    settings = mixed({"scope": {"kind": "ending-scope"}, "hammer": {"kind": "ending-hammer"}}, PLACES)
    prepare_data_folder(folder)
    config = write_configuration(settings, folder)
    done = subprocess.run(
        [sys.executable, "-m", "daq_service.cli", "run", config, "--data-dir", folder, "--no-web"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(site), str(Path(__file__).parents[1])])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (site / "ended").read_text() == "x" * len(endings)
    assert set_rows(folder)["C"].state == "done"
    assert done.stderr.count("which it had not announced") == sum("os._exit" in ending for ending in endings)


@pytest.mark.parametrize(
    "ending", [SystemExit(0), SystemExit(3), KeyboardInterrupt(), GeneratorExit(), EOFError()], ids=repr
)
def test_an_exit_raised_by_a_driver_is_a_fault(ending, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(cli_run, "log_to_file", lambda path: None)  # its handlers stay as long as the process
    offer(monkeypatch, tmp_path / "site", OFFERED)
    folder = tmp_path / "data"
    prepare_data_folder(folder)
    config = write_configuration(mixed({"scope": SCOPE, "hammer": HAMMER}, PLACES), folder)

    def end(event):
        if event == "read C":
            raise ending

    begin_script().fails = end
    done = solimon_here("record", str(config), "--data-dir", str(folder), env=os.environ)
    assert done.returncode == 1
    assert f"a driver or library ended the work by {ending!r}; report it to its author" in done.stderr
    assert type(ending).__name__ in caplog.text, "with its traceback"
