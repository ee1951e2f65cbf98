"""The day-one suite must not rot until somebody has boards: its wireless part runs on doubles of them."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from support.daqmx_rig import (
    QUICK_PULSE_S,
    QUICK_TWIN,
    board,
    coil_pulses_s,
    parameters_of,
    quick_description,
)

from simulator.doubles.doors.control import running_doubles
from simulator.doubles.doors.library import why_unavailable
from simulator.parameters.electronics import NoiseParameters

ROOT = Path(__file__).parents[2]
DESCRIPTION = replace(
    quick_description(board(), positions="BCD"), twin=replace(QUICK_TWIN, noise=NoiseParameters())
)
LIMIT_S = 120.0


def day_one(environment: Mapping[str, str]) -> tuple[dict[str, int], str]:
    """How many tests ended how, and what was printed."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-m", "hardware", "tests/hardware"],
        env={**environment},
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    counts = re.findall(r"(\d+) (passed|failed|skipped|error)", done.stdout.splitlines()[-1])
    return {state: int(number) for number, state in counts}, done.stdout


def test_without_a_rig_every_test_is_skipped_with_its_reason() -> None:
    bare = {name: text for name, text in os.environ.items() if not name.startswith("SOLIMON_TEST_")}
    counts, printed = day_one(bare)
    assert set(counts) == {"skipped"}
    assert "SOLIMON_TEST_HARDWARE names no configuration of a real rig" in printed


@pytest.mark.skipif(bool(why_unavailable()), reason=why_unavailable() or "the library can be built")
def test_what_needs_no_wire_passes_on_doubles_and_strikes_each_transducer_once(tmp_path: Path) -> None:
    config = tmp_path / "laboratory.json"
    with running_doubles(DESCRIPTION) as doubles:
        values = {
            "clock": {"kind": "wall"},
            "positions": {name: {"method": "solitary_wave"} for name in DESCRIPTION.transducers},
            "rig": {"kind": "daqmx", "daqmx": asdict(parameters_of(DESCRIPTION, doubles))},
        }
        config.write_text(json.dumps(values), encoding="utf-8")
        rig = {"SOLIMON_TEST_HARDWARE": str(config), "SOLIMON_TEST_STRIKE": "yes"}
        counts, printed = day_one({**doubles.client_environment(), **rig})
        record = doubles.control.record()
    # Six need no wire; the other eight ask for the loopback.
    assert counts == {"passed": 6, "skipped": 8}, printed
    assert printed.count("SOLIMON_TEST_LOOPBACK is not set") > 0
    # The double times a pulse in whole nanoseconds.
    assert coil_pulses_s(record) == [pytest.approx(QUICK_PULSE_S, abs=1e-8)] * 3
