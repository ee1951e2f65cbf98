"""The map holds: few rooms at each level, no circle; the counts come from `benchmarks/house.py`."""

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
MOST_ROOMS = 17
"""Of a level: what a newcomer takes in at a glance; the client must be found at the top (decision 33)."""


def test_each_level_has_few_rooms_and_no_circle() -> None:
    command = [sys.executable, "benchmarks/house.py", "--levels"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    levels = json.loads(done.stdout)
    assert {"daq_service", "simulator", "simulator.doubles", "analysis", "hardware_drivers"} <= levels.keys()
    crowded = {level: found for level, found in levels.items() if found["rooms"] > MOST_ROOMS}
    assert crowded == {}
    assert [level for level, found in levels.items() if found["floors"] is None] == []
