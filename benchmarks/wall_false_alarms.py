"""False alarms of the wall thickness from waves: sound walls with stated minima, over years of sets.

    python benchmarks/wall_false_alarms.py                     an hour on one core
    python benchmarks/wall_false_alarms.py --sensors 10 --levels plant --workers 2 --json

Healthy runs are those of `diagnoses.py`, with a set an hour for a year after the baseline of 200, their
re-seats included. The recorder's own steps estimate the wall, with the diagnosis of each set. Printed by
level and minimum: alarms by 3 of 5 steps per transducer-year, next to the budget of the control chart; and
how often an interval of 90 % excludes the sound wall.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from diagnoses import BASELINE, HEALTHY, MODELS, RULE, diagnose_sets, sets_of
from wall_diagnoses import NAMES, OF_DIAGNOSIS, OF_POSTERIOR, shipped

from analysis.diagnosis.hypotheses import COUPLING, SENSOR
from analysis.statistics.design import Budget
from analysis.statistics.rules import AlarmState
from analysis.wall import posterior
from analysis.wall.calibration import calibrate
from analysis.wall.thickness import Pool, WallModel, WallThickness, estimate_thickness, update_alarm
from simulator.parameters.environmental_variability import NUISANCE

YEAR_H = 8766
LOSSES = (0.05, 0.1, 0.2)
"""Of the stated minima, as fractions of the wall."""


def run_sensor(level: str, seed: int) -> dict[str, float]:
    """Return alarms of a sound sensor in a year by minimum, steps, and steps that exclude the sound wall."""
    model, (bank, changes) = list(MODELS)[seed % len(MODELS)], shipped()
    sets = sets_of(HEALTHY, level, model, seed, NAMES, YEAR_H)
    of_diagnosis = sets[0][:, OF_DIAGNOSIS], sets[1][:, OF_DIAGNOSIS], sets[2]
    causes = diagnose_sets(HEALTHY, level, model, seed, *of_diagnosis)["causes"]
    logs = bank.sound + sets[0][:, OF_POSTERIOR]
    hypotheses = posterior.compare(calibrate(bank, logs[:BASELINE]), changes)
    middle_h = 0.5 * (BASELINE - 1)
    wall = WallModel(
        hypotheses=hypotheses,
        curves=posterior.list_curves(bank),
        initial_m=bank.thickness_m,
        baseline_h=middle_h,
    )
    state, pool = posterior.begin(len(changes), middle_h), Pool()
    alarms = dict.fromkeys(LOSSES, AlarmState())
    found = dict.fromkeys([str(loss) for loss in LOSSES], 0.0) | {"steps": 0.0, "excluded": 0.0, "bad": 0.0}
    for k, cause in enumerate(causes, BASELINE):
        other = cause if cause in (SENSOR, COUPLING) else ""
        state, pool, one = estimate_thickness(wall, state, pool, logs[k], float(k), other_cause=other)
        if one is None or one.quality == "bad":
            found["bad"] += one is not None
            continue
        found["steps"] += 1
        found["excluded"] += posterior.estimate_loss(state).low > 0.0
        for loss, alarm in alarms.items():
            step = WallThickness(below_minimum_probability=posterior.compute_exceedance(state, loss))
            alarms[loss] = update_alarm(alarm, step, RULE)
            found[str(loss)] += alarms[loss].active and not alarm.active
    return found


def summarize(level: str, rows: list[dict[str, float]]) -> Iterator[tuple[str, float]]:
    """Yield what is printed of a level."""
    for loss in LOSSES:
        mean = float(np.mean([row[str(loss)] for row in rows]))
        yield f"{level}, alarms per transducer-year, minimum at {loss:.0%} loss", round(mean, 3)
    steps = sum(row["steps"] for row in rows)
    yield (
        f"{level}, steps that exclude the sound wall, %",
        round(100.0 * sum(row["excluded"] for row in rows) / steps, 2),
    )
    share = sum(row["bad"] for row in rows) / len(rows) / YEAR_H
    yield f"{level}, sets not explained by a wall, %", round(100.0 * share, 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sensors", type=int, default=50, help="of each level")
    parser.add_argument("--levels", nargs="+", default=list(NUISANCE), choices=list(NUISANCE))
    parser.add_argument("--first-seed", type=int, default=50)
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    given = parser.parse_args()
    results: dict[str, float] = {"budget, alarms per transducer-year": Budget().alarms_per_year}
    with ProcessPoolExecutor(given.workers) as executor:
        for level in given.levels:
            seeds = range(given.first_seed, given.first_seed + given.sensors)
            results |= summarize(level, list(executor.map(run_sensor, [level] * given.sensors, seeds)))
    if given.json:
        print(json.dumps(results))
    else:
        print("\n".join(f"{name:70s} {value}" for name, value in results.items()))


if __name__ == "__main__":
    main()
