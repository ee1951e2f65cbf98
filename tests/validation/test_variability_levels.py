"""The study of variability levels: the documented command prints the assessed sets."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "nuisance_levels.py"


@pytest.mark.slow
def test_a_short_study_assesses_every_set_after_the_baseline_and_detects_the_wall():
    command = [
        sys.executable,
        str(SCRIPT),
        "--seeds",
        "1",
        "--levels",
        "laboratory",
        "--hours",
        "110",
        "--json",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    runs = {row["position"]: row for row in json.loads(done.stdout)["runs"]}
    # 150 sets to 75 h, then one an hour; of B and C those after 100 h, of D those after the baseline's 48.
    assert {name: row["judged"] for name, row in runs.items()} == {"B": 10, "C": 10, "D": 137}
    assert {row["strikes"] for row in runs.values()} == {1850}
    for row in runs.values():
        assert sum(row["eigenvalues"]) == pytest.approx(5.0, rel=1e-9), "the trace of a correlation"
    # A tenth of the wall and more is gone, and D's is whole: what lies beyond the limits differs by far.
    assert runs["B"]["f_percent"] > 50.0
    assert runs["D"]["f_percent"] < 10.0
    assert runs["D"]["f_percent"] <= runs["D"]["paper_percent"]
