"""The day-one suite must not rot until somebody has boards: its wireless part runs on doubles of them."""

import json
import os
import re
from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from support.daqmx_brains import in_a_process, running_brain
from support.daqmx_rig import (
    QUICK_PULSE_S,
    QUICK_TWIN,
    board,
    coil_pulses_s,
    parameters_of,
    quick_description,
)
from support.niscope_rig import preload
from support.waiting import ended

from simulator.doubles.doors.library import why_unavailable
from simulator.parameters.electronics import NoiseParameters

ROOT = Path(__file__).parents[2]
DESCRIPTION = replace(
    quick_description(board(), positions="BCD"), twin=replace(QUICK_TWIN, noise=NoiseParameters())
)


def run_pytest(environment: Mapping[str, str], printed: Path) -> None:
    """Child: `pytest -m hardware` where this environment holds."""
    for name in [name for name in os.environ if name.startswith("SOLIMON_TEST_")]:
        del os.environ[name]
    os.environ.update(environment)
    os.chdir(ROOT)
    if environment:
        preload("nidaqmx")
    # What was loaded before the fork has plain asserts; they are none of these tests'.
    quiet = ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
    with printed.open("w", encoding="utf-8") as file, redirect_stdout(file):
        pytest.main(
            [
                "-p",
                "no:cacheprovider",
                "-p",
                "no:xdist",
                "-p",
                "no:hypothesispytest",
                *quiet,
                "-m",
                "hardware",
                "tests/hardware",
            ]
        )


def day_one(environment: Mapping[str, str], folder: Path) -> tuple[dict[str, int], str]:
    """How many tests ended how, and what was printed."""
    ended(in_a_process(run_pytest, environment, folder / "printed.txt"), "the hardware tests' end")
    printed = (folder / "printed.txt").read_text(encoding="utf-8")
    counts = re.findall(r"(\d+) (passed|failed|skipped|error)", printed.splitlines()[-1])
    return {state: int(number) for number, state in counts}, printed


def test_without_a_rig_every_test_is_skipped_with_its_reason(tmp_path: Path) -> None:
    counts, printed = day_one({}, tmp_path)
    assert set(counts) == {"skipped"}
    assert "SOLIMON_TEST_HARDWARE names no configuration of a real rig" in printed


@pytest.mark.skipif(bool(why_unavailable()), reason=why_unavailable() or "the library can be built")
def test_what_needs_no_wire_passes_on_doubles_and_strikes_each_transducer_thrice(tmp_path: Path) -> None:
    config = tmp_path / "laboratory.json"
    with running_brain(DESCRIPTION) as doubles:
        values = {
            "clock": {"kind": "wall"},
            "positions": {name: {"method": "solitary_wave"} for name in DESCRIPTION.transducers},
            "rig": {"kind": "daqmx", "daqmx": asdict(parameters_of(DESCRIPTION, doubles))},
        }
        config.write_text(json.dumps(values), encoding="utf-8")
        rig = {"SOLIMON_TEST_HARDWARE": str(config), "SOLIMON_TEST_STRIKE": "yes"}
        counts, printed = day_one({**doubles.client_environment(environment={}), **rig}, tmp_path)
        record = doubles.control.record()
    # Eight need no wire; the other ten ask for the loopback.
    assert counts == {"passed": 8, "skipped": 10}, printed
    assert printed.count("SOLIMON_TEST_LOOPBACK is not set") > 0
    # The double times a pulse in whole nanoseconds.
    assert coil_pulses_s(record) == [pytest.approx(QUICK_PULSE_S, abs=1e-8)] * 9
