"""Wall thickness after a re-seat of the chain or a fault of its sensor, of sound and of corroding walls.

    python benchmarks/wall_reseats.py                          half an hour on one core
    python benchmarks/wall_reseats.py --runs 4 --levels plant --json

Sets are those of `diagnoses.py`, one an hour for 600 h after the baseline of 200. At hour 200 the chain is
seated again, by `--times` the size of the level's own re-seats, in a sound wall and in one that corrodes
evenly to 40 %; sensor faults are those of `diagnoses.py`. The recorder's own steps estimate the wall.
Printed by level and case: coverage of 90 % intervals, intervals that exclude the sound wall, median upper end
of the loss, sets that no wall explains, and alarms of a minimum at 10 % loss;
next to them, in brackets, the same if re-seats are not looked for.
"""

from __future__ import annotations

import argparse
import json
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from unittest.mock import patch

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from diagnoses import (
    AFTER,
    BASELINE,
    CORROSION,
    HEALTHY,
    MODELS,
    RULE,
    SENSOR_FAULTS,
    Case,
    diagnose_sets,
    model_slopes,
    reseat_of,
    sets_of,
)
from wall_diagnoses import NAMES, OF_DIAGNOSIS, OF_POSTERIOR, shipped

from analysis.diagnosis.hypotheses import COUPLING, SENSOR
from analysis.statistics.rules import AlarmState
from analysis.wall import posterior
from analysis.wall.calibration import calibrate
from analysis.wall.thickness import Pool, WallModel, estimate_thickness, update_alarm
from simulator.numerics.arrays import FloatArray
from simulator.parameters.environmental_variability import NUISANCE

SETS, RESEAT_AT, LOSS = 2 * AFTER, BASELINE + 200, 0.1
RESEATED = {
    "re-seat, sound": replace(HEALTHY, name="re-seat, sound"),
    "re-seat, corroding": replace(CORROSION, name="re-seat, corroding", ramp=SETS),
}
CASES: dict[str, Case] = RESEATED | {case.name: case for case in SENSOR_FAULTS}
NEVER = 1e-300
COLUMNS = ("covered %", "excludes sound %", "upper end", "not explained %", "alarms")


def follow(level: str, case: Case, seed: int, times: float) -> list[list[float]]:
    """Return the `COLUMNS` of a run as the recorder has them, and if re-seats are not looked for."""
    model, (bank, changes) = list(MODELS)[seed % len(MODELS)], shipped()
    sets, confirming, depths = sets_of(case, level, model, seed, NAMES, SETS)
    if case.name in RESEATED:
        random, n = np.random.default_rng([seed, 1]), MODELS[model][0].bodies
        shift = times * reseat_of(level, random, n) @ model_slopes(model, NAMES).of_place
        sets[RESEAT_AT:] += shift
        confirming[RESEAT_AT:] += shift
    of_diagnosis = sets[:, OF_DIAGNOSIS], confirming[:, OF_DIAGNOSIS]
    causes = diagnose_sets(case, level, model, seed, *of_diagnosis, depths)["causes"]
    others = [cause if cause in (SENSOR, COUPLING) else "" for cause in causes]
    logs = bank.sound + sets[:, OF_POSTERIOR]
    wall = WallModel(
        hypotheses=posterior.compare(calibrate(bank, logs[:BASELINE]), changes),
        curves=posterior.list_curves(bank),
        initial_m=bank.thickness_m,
        baseline_h=0.5 * (BASELINE - 1),
        minimum_m=(1.0 - LOSS) * bank.thickness_m,
    )
    found = [count(wall, logs, depths, others)]
    with patch.object(posterior, "RESEAT_ODDS", NEVER):
        return [*found, count(wall, logs, depths, [""] * SETS)]


def count(wall: WallModel, logs: FloatArray, depths: FloatArray, others: list[str]) -> list[float]:
    """Return the `COLUMNS` of a run."""
    state, pool, alarm = posterior.begin(len(wall.curves), wall.baseline_h), Pool(), AlarmState()
    rows, refused, alarms = [], 0, 0
    for k, other in enumerate(others, BASELINE):
        state, pool, one = estimate_thickness(wall, state, pool, logs[k], float(k), other_cause=other)
        if one is None or one.quality == "bad":
            refused += one is not None
            continue
        loss = posterior.estimate_loss(state)
        rows.append([loss.low <= depths[k] <= loss.high, loss.low > 0.0, loss.high])
        active = alarm.active
        alarm = update_alarm(alarm, one, RULE)
        alarms += alarm.active and not active
    covered, excluded, high = np.array(rows, dtype=np.float64).T
    shares = [100.0 * covered.mean(), 100.0 * excluded.mean(), np.median(high), 100.0 * refused / SETS]
    return [*map(float, shares), float(alarms)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=10, help="of each level and case")
    parser.add_argument("--levels", nargs="+", default=list(NUISANCE), choices=list(NUISANCE))
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES), metavar="CASE")
    parser.add_argument("--times", type=float, default=4.0, help="size of a re-seat, in the level's own")
    parser.add_argument("--first-seed", type=int, default=50)
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    given = parser.parse_args()
    seeds, results = range(given.first_seed, given.first_seed + given.runs), {}
    with ProcessPoolExecutor(given.workers) as executor:
        for level in given.levels:
            for name in given.cases:
                todo = [[level] * given.runs, [CASES[name]] * given.runs, seeds, [given.times] * given.runs]
                known, unknown = np.mean(list(executor.map(follow, *todo)), axis=0)
                results[f"{level}, {name}"] = dict(zip(COLUMNS, known.tolist(), strict=True)) | {
                    f"{column}, not looked for": value
                    for column, value in zip(COLUMNS, unknown.tolist(), strict=True)
                }
                if not given.json:
                    pairs = zip(COLUMNS, known, unknown, strict=True)
                    text = "  ".join(f"{column} {one:.3g} ({other:.3g})" for column, one, other in pairs)
                    print(f"{f'{level}, {name}':32s}{text}", flush=True)
    if given.json:
        print(json.dumps(results))


if __name__ == "__main__":
    main()
