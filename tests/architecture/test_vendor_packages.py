"""No vendor's package, driver or compiler is needed until a rig asks for it; then the remedy is named."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass

import pytest
from support.small_experiment import SMALL

PROGRAM = """
import contextlib, io, json, sys
import importlib.abc
from daq_service.cli.main import main

class Refuses(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        package = name.partition(".")[0]
        if package in vendors and package in missing:
            asked.append(package)
            raise ModuleNotFoundError(f"No module named {package!r}", name=package)

vendors = ("nidaqmx", "serial", "pyvisa", "niscope", "nitclk", "grpc", "nptdms")
sys.meta_path.insert(0, Refuses())
for config, folder, missing in json.load(sys.stdin):
    asked, said, code = [], io.StringIO(), 0
    missing = vendors if missing is None else missing
    sys.argv = ["solimon", "record", config, "--data-dir", folder]
    with contextlib.redirect_stderr(said):
        try:
            main()
        except SystemExit as end:
            code = end.code
    print(json.dumps([code, said.getvalue(), asked]))
"""
"""Commands in one process, each as if some of the vendors' packages were not installed."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """Output of `solimon record`, and the missing packages that it imported."""

    code: int
    stderr: str
    asked: list[str]


WIRED = {
    name: {
        "board_serial": "1",
        "input": f"ai{index}",
        "counter": f"ctr{index}",
        "output_terminal": f"PFI{12 + index}",
    }
    for index, name in enumerate("BCD")
}
PROBE = {"probes": {"A": {"resource": "PXI1Slot5"}}}
OVER_GRPC = {"transport": "grpc", "grpc_address": "localhost:1", "transducers": WIRED}
TDMS = {"source": "old.tdms", "format": "tdms"}
BY_GRPC = {"kind": "daqmx", "daqmx": OVER_GRPC, "niscope": PROBE}
BY_LIBRARY = {"kind": "daqmx", "daqmx": {"transducers": WIRED}, "niscope": PROBE}
COMMANDS = {
    # First, before anything of a vendor is imported. None: all of them are missing.
    "simulated": ({"schedule": {**SMALL["schedule"], "end_h": 1.0}}, None),
    "grpc": ({"rig": BY_GRPC, "clock": {"kind": "wall"}}, ["grpc"]),
    "library": ({"rig": BY_LIBRARY, "clock": {"kind": "wall"}}, []),
    "tdms": ({"rig": {"kind": "playback", "playback": TDMS}}, ["nptdms"]),
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "old.tdms").touch()
    (folder / "no-programs").mkdir()
    asked = []
    for name, (tables, missing) in COMMANDS.items():
        config = folder / f"{name}.json"
        config.write_text(json.dumps({**SMALL, **tables}), encoding="utf-8")
        asked.append((str(config), str(folder / name), missing))
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        input=json.dumps(asked),
        # No compiler, and no tool of binutils: ctypes finds no library.
        env={**os.environ, "PATH": str(folder / "no-programs")},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    records = map(json.loads, done.stdout.splitlines())
    return {name: Recorded(*one) for name, one in zip(COMMANDS, records, strict=True)}


def test_a_simulated_test_needs_no_vendor_package_and_no_compiler(recorded):
    done = recorded["simulated"]
    # On a busy machine it reports what it compiles once.
    once = ("compiling the twin's loops", "building the twin's plates")
    messages = [line for line in done.stderr.splitlines() if not line.startswith(once)]
    assert (done.code, messages, done.asked) == (0, ["hour 0.5, set 1 of 2", "hour 1.0, set 2 of 2"], [])


def test_a_missing_extra_is_named_with_its_remedy(recorded):
    done = recorded["grpc"]
    assert (done.code, done.asked) == (3, ["grpc"])
    assert "solimon[grpc]" in done.stderr


def test_a_missing_driver_is_named_with_its_remedy(recorded):
    done = recorded["library"]
    assert done.code == 3
    assert "NI-DAQmx" in done.stderr
    assert "install" in done.stderr


def test_a_recording_of_labview_needs_its_extra(recorded):
    done = recorded["tdms"]
    assert (done.code, done.asked) == (2, ["nptdms"])
    assert "solimon[tdms]" in done.stderr
