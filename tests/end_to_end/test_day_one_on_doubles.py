"""The part of the day-one suite without wires runs on doubles of the boards."""

import json
import os
import re
from contextlib import contextmanager, redirect_stdout
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from support.daqmx_models import in_a_process, running_brain
from support.daqmx_rig import (
    QUICK_PULSE_S,
    QUICK_TWIN,
    board,
    coil_pulses_s,
    parameters_of,
    quick_description,
)
from support.niscope_rig import description as probe_description
from support.niscope_rig import parameters as probe_parameters
from support.niscope_rig import preload, why_no_niscope
from support.serial_rig import NO_TERMINALS, SerialRig
from support.waiting import ended

from simulator.doubles.serial.supply import Cell
from simulator.doubles.transports.library import find_unavailability_reason
from simulator.parameters.electronics import NoiseParameters

ROOT = Path(__file__).parents[2]
PROBE = probe_description()
DESCRIPTION = replace(
    quick_description(board(), positions="BCD"),
    twin=replace(QUICK_TWIN, noise=NoiseParameters()),
    scopes=PROBE.scopes,
    probes=PROBE.probes,
)
LOAD_OHM = 100.0
NO_LIBRARY = find_unavailability_reason() or why_no_niscope()
LIBRARY = pytest.mark.skipif(bool(NO_LIBRARY), reason=NO_LIBRARY or "the libraries can be built")
TERMINALS = pytest.mark.skipif(bool(NO_TERMINALS), reason=NO_TERMINALS or "there are pseudo terminals")


@contextmanager
def bench_supply(folder, resistance_ohm):
    """Run a supply with a resistor at its output, and a driver without their parameters."""
    with SerialRig(folder) as bench:
        load = Cell(counter_voltage_v=0.0, resistance_ohm=resistance_ohm, rise_per_h=0.0)
        bench.instruments.supply_link.do(lambda: setattr(bench.instruments.supply, "cell", load))
        bench.supply.close()
        yield bench


def run_pytest(environment, printed, files="tests/hardware"):
    """Run `pytest -m hardware` in a child with this environment."""
    for name in [name for name in os.environ if name.startswith("SOLIMON_TEST_")]:
        del os.environ[name]
    os.environ.update(environment)
    os.chdir(ROOT)
    if environment:
        preload("nidaqmx")
        preload("niScope")
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
                files,
            ]
        )


def day_one(environment, folder, files="tests/hardware"):
    """Return the number of tests by outcome, and the output."""
    ended(in_a_process(run_pytest, environment, folder / "printed.txt", files), "the hardware tests' end")
    printed = (folder / "printed.txt").read_text(encoding="utf-8")
    counts = re.findall(r"(\d+) (passed|failed|skipped|error)", printed.splitlines()[-1])
    return {state: int(number) for number, state in counts}, printed


def test_without_a_rig_every_test_is_skipped_with_its_reason(tmp_path):
    counts, printed = day_one({}, tmp_path)
    assert set(counts) == {"skipped"}
    assert "SOLIMON_TEST_HARDWARE names no configuration of a real rig" in printed


def configured(folder, rig):
    """Write the configuration of a laboratory with these instruments."""
    config = folder / "laboratory.json"
    positions = {name: {"method": "solitary_wave"} for name in DESCRIPTION.transducers}
    probes = {name: {"method": "pulse_echo"} for name in DESCRIPTION.probes}
    values = {
        "clock": {"kind": "wall"},
        "positions": {**positions, **probes},
        "rig": {"kind": "daqmx", "niscope": asdict(probe_parameters()), **rig},
    }
    config.write_text(json.dumps(values), encoding="utf-8")
    return config


@LIBRARY
@TERMINALS
def test_checks_without_a_wire_pass_on_doubles_and_strike_each_transducer_thrice(tmp_path):
    with running_brain(DESCRIPTION) as doubles, bench_supply(tmp_path, LOAD_OHM) as bench:
        boards = asdict(parameters_of(DESCRIPTION, doubles))
        config = configured(tmp_path, {"daqmx": boards, "supply": asdict(bench.supply_parameters)})
        rig = {
            "SOLIMON_TEST_HARDWARE": str(config),
            "SOLIMON_TEST_STRIKE": "yes",
            "SOLIMON_TEST_LOAD_OHM": str(LOAD_OHM),
        }
        libraries = doubles.client_environment("nidaqmx", "niScope", environment={})
        counts, printed = day_one({**libraries, **rig}, tmp_path)
        record = doubles.control.record()
        switched = bench.switched()
    # Of the boards eight need no wire, of the probes four, of the supply seven; ten ask for the loopback.
    assert counts == {"passed": 8 + 4 + 7, "skipped": 10}, printed
    assert printed.count("SOLIMON_TEST_LOOPBACK is not set") > 0
    # The double times a pulse in whole nanoseconds.
    assert coil_pulses_s(record) == [pytest.approx(QUICK_PULSE_S, abs=1e-8)] * 9
    assert switched == [(True, "command"), (False, "command")] * 5


@LIBRARY
@TERMINALS
def test_a_supply_with_another_load_than_configured_fails_and_stays_off(tmp_path):
    with bench_supply(tmp_path, 0.5 * LOAD_OHM) as bench:
        boards = asdict(parameters_of(DESCRIPTION, None))
        config = configured(tmp_path, {"daqmx": boards, "supply": asdict(bench.supply_parameters)})
        rig = {"SOLIMON_TEST_HARDWARE": str(config), "SOLIMON_TEST_LOAD_OHM": str(LOAD_OHM)}
        counts, printed = day_one(rig, tmp_path, "tests/hardware/test_drive_supply.py")
        switched = bench.switched()
    # Twice the current where the voltage is held, half of the voltage where the limit holds.
    assert counts == {"failed": 2, "passed": 5}, printed
    assert switched[-1] == (False, "command")


@LIBRARY
@TERMINALS
def test_nothing_is_energized_without_a_configured_load(tmp_path):
    with bench_supply(tmp_path, LOAD_OHM) as bench:
        boards = asdict(parameters_of(DESCRIPTION, None))
        config = configured(tmp_path, {"daqmx": boards, "supply": asdict(bench.supply_parameters)})
        rig = {"SOLIMON_TEST_HARDWARE": str(config)}
        counts, printed = day_one(rig, tmp_path, "tests/hardware/test_drive_supply.py")
        assert bench.switched() == []
    assert counts == {"passed": 2, "skipped": 5}, printed
    assert "SOLIMON_TEST_LOAD_OHM is not set" in printed
