"""Causes of changes on a model whose slopes they never saw (at length: `benchmarks/diagnoses.py`)."""

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from daq_service.cli.offline.twin_line import simulate_assessed_sets
from daq_service.settings.file import load_settings

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "diagnoses.py"
STRONGER = {"damping_n_s_per_m": 9.0, "contact_damping_n_s_per_m": 70.0}
BASELINE_H, END_H = 200.0, 320.0
CORROSION = {"thinning": {"D": {"onset_h": 200.0, "reference_h": 500.0, "depth_fraction": 0.4}}}
WEAR = {"onset_h": 220.0, "ramp_h": 90.0, "radius_growth_fraction": 0.3}
WORN = {"thinning": {}, "faults": {"D": {"bead_wear": WEAR}}}


def benchmark(*arguments):
    command = [sys.executable, str(SCRIPT), "--models", "dashpots", "--levels", "laboratory", "--json"]
    done = subprocess.run([*command, *arguments], capture_output=True, text=True, check=True)
    runs: list[dict[str, Any]] = json.loads(done.stdout)["runs"]
    return runs


def test_a_thinning_wall_is_diagnosed_before_f_alarms_and_as_nothing_else():
    (run,) = benchmark("--only", "corrosion", "--runs", "1")
    assert run["first_wall_depth"] <= run["first_f_depth"]
    assert run["called"].keys() <= {"ok", "wall", "undetermined"}


@pytest.mark.slow
def test_healthy_runs_re_seats_and_faulty_sensors_are_not_diagnosed_as_walls():
    cases = "healthy,re-seat,gain step,tilt,bead wear,striker"
    runs = benchmark("--only", cases, "--runs", "5")
    assert len(runs) == 30
    assert [run for run in runs if run["called"].get("wall")] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("twin", "named", "never"), [(CORROSION, "wall", {"sensor", "coupling"}), (WORN, "sensor", {"wall"})]
)
def test_real_shots_separate_a_wall_change_from_worn_spheres(twin, named, never):
    schedule = {"phases": [{"until_h": END_H, "interval_h": 1.0}], "end_h": END_H}
    settings = load_settings(
        None,
        overrides={
            "twin": {"nuisance": "laboratory", **twin},
            "chain": STRONGER,
            "schedule": schedule,
            "baseline": {"hours": BASELINE_H},
        },
    )
    rows = [one.position_result.assessments[-1] for one in simulate_assessed_sets(settings, "D")]
    called = Counter(row.diagnosis for row in rows if not row.in_baseline)
    assert called[named] > 0.3 * called.total()
    assert not never & called.keys()
