"""WALL by the diagnosis alone, by the posterior of the wall's loss alone, and by both, on the same sets.

    python benchmarks/wall_diagnoses.py                          some hours on one core
    python benchmarks/wall_diagnoses.py --runs 20 --levels plant --cases re-seat "bead wear" --json

Runs are those of `diagnoses.py`, with the features of the posterior, too: a baseline of 200 sets, one an
hour, then 300 sets. The posterior (`analysis.wall`) has the bank of the shipped configurations, with curves
of the three models among others. By the posterior alone it is WALL where more than 10 % are lost with a
probability of 90 %; by both as in the recorder: the diagnosis knows that probability after the set before
(`analysis.diagnosis.diagnose`). Its limits were chosen on even seeds from 50 on at `plant`; this shows odd
ones.
"""

from __future__ import annotations

import argparse
import json
import math
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from diagnoses import BASELINE, CASES, CORROSION, HEALTHY, MODELS, RESEAT, diagnose_sets, percent, sets_of

from analysis.diagnosis.hypotheses import COUPLING, SENSOR
from analysis.diagnosis.slopes import COMPONENTS
from analysis.wall import posterior
from analysis.wall.bank import FEATURES, Bank, load_bank
from analysis.wall.calibration import calibrate
from analysis.wall.thickness import LOST, Pool, WallModel, estimate_thickness
from daq_service.assessment.wall_bank import SHIPPED_BANK
from simulator.numerics.arrays import FloatArray
from simulator.parameters.environmental_variability import NUISANCE

NAMES = (*COMPONENTS, *(name for name in FEATURES if name not in COMPONENTS))
OF_DIAGNOSIS, OF_POSTERIOR = slice(len(COMPONENTS)), [NAMES.index(name) for name in FEATURES]
PROBABILITY = 0.9
RULES = ("diagnosis", "posterior", "both")


@lru_cache(maxsize=1)
def shipped() -> tuple[Bank, FloatArray]:
    """Return the shipped bank and the changes that its hypotheses predict."""
    bank = load_bank(SHIPPED_BANK)
    return bank, posterior.predict_changes(bank)


def follow_loss(sets: FloatArray) -> tuple[Callable[[int, str], float], list[float]]:
    """Return what adds a set to the filter and returns the probability of a loss, and the list of these.

    ``sets`` are ln features from the first set of the baseline.
    """
    bank, changes = shipped()
    middle_h = 0.5 * (BASELINE - 1)
    wall = WallModel(
        hypotheses=posterior.compare(calibrate(bank, sets[:BASELINE]), changes),
        curves=posterior.list_curves(bank),
        initial_m=bank.thickness_m,
        baseline_h=middle_h,
        minimum_m=None,
    )
    state, pool, found = posterior.begin(len(changes), middle_h), Pool(), [0.0]

    def add(index: int, cause: str) -> float:
        nonlocal state, pool
        other, before = cause if cause in (SENSOR, COUPLING) else "", state
        state, pool, _ = estimate_thickness(wall, state, pool, sets[index], float(index), other_cause=other)
        found.append(found[-1] if state is before else posterior.compute_exceedance(state, LOST))
        return found[-1]

    return add, found


def call_run(case: str, level: str, model: str, seed: int) -> dict[str, Any]:
    """Return the depth at which each rule first calls WALL in one run; None: never."""
    logs, confirmations, depths = sets_of(CASES[case], level, model, seed, NAMES)
    of_diagnosis = logs[:, OF_DIAGNOSIS], confirmations[:, OF_DIAGNOSIS]
    find_loss, found = follow_loss(shipped()[0].sound + logs[:, OF_POSTERIOR])
    alone = diagnose_sets(CASES[case], level, model, seed, *of_diagnosis, depths)
    both = diagnose_sets(CASES[case], level, model, seed, *of_diagnosis, depths, find_loss=find_loss)
    lost = [d for d, one in zip(depths[BASELINE:].tolist(), found[1:], strict=True) if one >= PROBABILITY]
    first = alone["first_wall_depth"], next(iter(lost), None), both["first_wall_depth"]
    of_rule = dict(zip(RULES, first, strict=True))
    return {"case": case, "level": level, "model": model, "seed": seed, **of_rule}


def show(rows: list[dict[str, Any]]) -> None:
    """Print the share of runs called WALL by each rule, and the median depth of the corrosion runs."""
    print(f"{'level':11s}{'case':13s}{'runs':>5s}" + "".join(f"{rule + ', WALL %':>22s}" for rule in RULES))
    for level, case in dict.fromkeys((row["level"], row["case"]) for row in rows):
        own = [row for row in rows if (row["level"], row["case"]) == (level, case)]
        shares = [percent([row[rule] is not None for row in own]) for rule in RULES]
        print(f"{level:11s}{case:13s}{len(own):5d}" + "".join(f"{share:22.1f}" for share in shares))
        if case == CORROSION.name:
            first = [[math.inf if row[rule] is None else row[rule] for row in own] for rule in RULES]
            print(f"{'':11s}{'median depth':18s}" + "".join(f"{np.median(one):22.3f}" for one in first))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200, help="of each case and level, over all models")
    parser.add_argument("--first-seed", type=int, default=51, help="then every other one")
    parser.add_argument("--levels", nargs="+", default=list(NUISANCE), choices=list(NUISANCE))
    shown = [HEALTHY.name, RESEAT.name, CORROSION.name]
    parser.add_argument("--cases", nargs="+", default=shown, choices=list(CASES), metavar="CASE")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    models = list(MODELS)
    todo = [
        (case, level, models[seed % len(models)], seed)
        for level in options.levels
        for case in options.cases
        for seed in range(options.first_seed, options.first_seed + 2 * options.runs, 2)
    ]
    with ProcessPoolExecutor(options.workers) as executor:
        rows = list(executor.map(call_run, *zip(*todo, strict=True), chunksize=4))
    if options.json:
        print(json.dumps({"runs": rows}))
    else:
        show(rows)


if __name__ == "__main__":
    main()
