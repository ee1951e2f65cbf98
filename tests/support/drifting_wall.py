"""A test with real records on disk: the wall at B changes, at C a hole opens."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from hardware_drivers.measurement import Waveform
from support.life_of_a_test import run
from support.memory_line import Line, memory_settings
from support.synthetic_records import Scene

BASELINE_SETS, FIRST_SILENT = 15, 21
RAISED = {("B", "transducer_change"): 23, ("C", "no_reflection"): 22}
"""Set with which each alarm is raised: what came within so few sets looks like a contact."""


@cache
def record_of(position: str, set_index: int, shot_index: int) -> Waveform:
    """Return the record of a shot; the same key gives the same record."""
    later = max(0, set_index - BASELINE_SETS) if position == "B" else 0
    reflects = position == "B" or set_index < FIRST_SILENT
    scene = Scene(
        # From set to set the chain rests a little differently; the drift of three sets is as large.
        tof_s=330e-6 + 0.4e-6 * (7 * set_index % 5 - 2) + 0.8e-6 * later,
        amplitude_ratio=0.5 if reflects else 0.0,
        ssw_fraction=0.08 if reflects else 0.0,
        noise_fraction=0.004,
        n_samples=8000,
    )
    return scene.waveform([ord(position), set_index, shot_index])


def drifting_wall(folder: Path) -> Line:
    """Record 25 scheduled sets; the first 15 are the baseline."""
    settings = memory_settings(
        schedule={"phases": [{"until_h": 12.5, "interval_h": 0.5}], "shots_per_set": 3},
        baseline={"hours": 7.5, "minimum_sets": 15},
        alarms={"decides_by": "k_of_n"},
    )
    settings = settings.model_copy(update={"positions": {name: settings.positions[name] for name in "BC"}})
    line = Line(folder, settings, lambda key: record_of(key.position, key.set_index, key.shot_index))
    run(line)
    return line
