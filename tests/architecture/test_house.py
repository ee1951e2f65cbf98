"""The map holds: few rooms at each level, no circle; the counts come from `benchmarks/house.py`."""

import json
import os
import re
import runpy
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import grimp

ROOT = Path(__file__).parents[2]
MOST_ANY = {"daq_service": 260, "simulator": 259, "analysis": 6, "hardware_drivers": 36}
"""Of each package; lower a number with the code, never raise it."""
MOST_MAPPINGS = {"daq_service": 60, "simulator": 14, "analysis": 3, "hardware_drivers": 1}
"""``dict[str, Any]`` of each package, likewise."""
MOST_ROOMS = 18
"""Of a level: what a newcomer takes in at a glance; the client must be found at the top (decision 33)."""


def test_each_level_has_few_rooms_and_no_circle():
    command = [sys.executable, "benchmarks/house.py", "--levels"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    levels = json.loads(done.stdout)
    assert {"daq_service", "simulator", "simulator.doubles", "analysis", "hardware_drivers"} <= levels.keys()
    crowded = {level: found for level, found in levels.items() if found["rooms"] > MOST_ROOMS}
    assert crowded == {}
    assert [level for level, found in levels.items() if found["floors"] is None] == []


def test_the_number_of_untyped_values_does_not_rise():
    house = runpy.run_path(str(ROOT / "benchmarks/house.py"))
    for count, most in ((house["anys"], MOST_ANY), (house["bare_mappings"], MOST_MAPPINGS)):
        found = {
            package: sum(count(path.read_text("utf-8")) for path in (ROOT / package).rglob("*.py"))
            for package in house["PACKAGES"]
        }
        assert all(found[package] <= most[package] for package in house["PACKAGES"]), found


def test_no_circle_among_files():
    """`graphlib.CycleError` names the circle."""
    graph = grimp.build_graph("daq_service", "hardware_drivers", "analysis", "simulator", cache_dir=None)
    imports = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    assert len(imports) > 500
    TopologicalSorter(imports).prepare()


def test_no_circle_among_the_scripts_of_the_page():
    page = ROOT / "daq_service/web/dashboard"
    pattern = re.compile(r"^(?:import|export)\b[^;]*?[\"'](\.[^\"']+\.js)[\"']", flags=re.MULTILINE)
    imports = {
        path: [(path.parent / name).resolve() for name in pattern.findall(path.read_text(encoding="utf-8"))]
        for path in page.rglob("*.js")
    }
    assert sum(map(len, imports.values())) > 50
    TopologicalSorter(imports).prepare()
