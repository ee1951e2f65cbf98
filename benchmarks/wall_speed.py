"""Time and memory of the wall thickness: one set of each of 1,000 sensors, in two processes.

    python benchmarks/wall_speed.py [--sensors N] [--workers N] [--json]

Each sensor has an estimator of its own, as in the recorder, calibrated to a baseline of 48 sets, and a state
after one to ten sets, when most losses are possible and states are largest. The set completes a step of the
filter. The peak memory is that of all processes together, each with bank and stored states.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from wall_thickness import BASELINE, HOURS, draw_healthy_sets

from analysis.statistics.rules import AlarmRule
from analysis.wall import posterior
from analysis.wall.bank import FEATURES, load_bank
from analysis.wall.estimator import WallEstimator
from daq_service.assessment.wall_bank import SHIPPED_BANK

DRAWN_SENSORS, MOST_SETS = 20, 10


@dataclass(frozen=True, slots=True)
class SetValues:
    """Features of a set by name, and its hour."""

    due_h: float
    values: dict[str, float | None]


def time_sensors(sensors: int) -> dict[str, float]:
    """Return elapsed and CPU seconds of a set of each sensor, and the peak memory of this process."""
    bank = load_bank(SHIPPED_BANK)
    opened = bank, posterior.predict_changes(bank)

    def make_estimator() -> WallEstimator:
        return WallEstimator(lambda: opened, AlarmRule(k=3, n=5), 5e-3, baseline_id=1, is_first=True)

    ready = []
    for seed in range(min(DRAWN_SENSORS, sensors)):
        rows = np.exp(draw_healthy_sets(bank, "workshop", seed)).tolist()
        sets = [
            SetValues(h, dict(zip(FEATURES, row, strict=True))) for h, row in zip(HOURS, rows, strict=True)
        ]
        baseline, own, track = sets[:BASELINE], make_estimator(), None
        for k in range(BASELINE, BASELINE + MOST_SETS):
            track, _ = own.add_set(track, baseline, sets[k])
            ready.append((track, baseline, sets[k + 1]))
    fleet = [(make_estimator(), *ready[k % len(ready)]) for k in range(sensors)]
    for own, track, baseline, one in fleet:  # calibrates
        own.add_set(track, baseline, one)
    elapsed_s, cpu_s = time.perf_counter(), time.process_time()
    found = [own.add_set(track, baseline, one)[0] for own, track, baseline, one in fleet]
    return {
        "elapsed_s": time.perf_counter() - elapsed_s,
        "cpu_s": time.process_time() - cpu_s,
        "largest_state_kb": max(1e-3 * one.packed.nbytes for one in found if one is not None),
        "memory_gb": 1e-6 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sensors", type=int, default=1000)
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    given = parser.parse_args()
    parts = [len(part) for part in np.array_split(np.arange(given.sensors), given.workers)]
    with ProcessPoolExecutor(given.workers) as executor:
        found = list(executor.map(time_sensors, parts))
    result = {
        "sensors": given.sensors,
        "elapsed_s": round(max(one["elapsed_s"] for one in found), 1),
        "cpu_s_per_set": round(sum(one["cpu_s"] for one in found) / given.sensors, 4),
        "largest_state_kb": round(max(one["largest_state_kb"] for one in found)),
        "memory_gb": round(sum(one["memory_gb"] for one in found), 2),
    }
    print(
        json.dumps(result) if given.json else "\n".join(f"{key:18s} {value}" for key, value in result.items())
    )


if __name__ == "__main__":
    main()
