"""A simulated test needs no vendor's package, driver or compiler."""

import json
import os
import subprocess
import sys

from support.small_experiment import SMALL

PROGRAM = """
import importlib.abc, sys

class Refuses(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("nidaqmx", "serial", "pyvisa", "niscope", "nitclk", "grpc", "nptdms"):
            print("asked for", name)
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Refuses())
from daq_service.cli.main import main
sys.argv = ["solimon", "record", *sys.argv[1:]]
main()
"""


def test_a_simulated_test_needs_no_vendor_package_and_no_compiler(tmp_path):
    config = tmp_path / "simulated.json"
    settings = {**SMALL, "schedule": {**SMALL["schedule"], "end_h": 1.0}}
    config.write_text(json.dumps(settings), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, config, "--data-dir", tmp_path / "data"],
        env={
            **os.environ,
            "PATH": str(tmp_path),
        },  # no compiler and no tool of binutils: ctypes finds no library
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    # On a busy machine it reports what it compiles once.
    once = ("preparing the twin's plates",)
    messages = [line for line in done.stderr.splitlines() if not line.startswith(once)]
    assert (done.returncode, done.stdout) == (0, "")
    assert messages == ["hour 0.5, 1 of 2 sets", "hour 1.0, 2 of 2 sets"]
