"""WALL by the diagnosis, by the posterior of the wall's loss, and by either, on the same simulated sets.

    python benchmarks/wall_diagnoses.py                          some hours on one core
    python benchmarks/wall_diagnoses.py --runs 20 --levels plant --cases re-seat "bead wear" --json
    python benchmarks/wall_diagnoses.py --loss 0.05 --probability 0.95

Runs are those of `diagnoses.py`, with the features of the posterior, too: a baseline of 200 sets, one an
hour, then 300 sets. The posterior (`analysis.wall`) has the bank of the shipped configurations, with curves
of the three models among others. By the posterior it is WALL where the loss exceeds `--loss` with a
probability of `--probability`, which were chosen on seeds 0 to 49. Either is enough, or the posterior counts
where the diagnosis is undetermined.
"""

from __future__ import annotations

import argparse
import json
import math
import os
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from diagnoses import BASELINE, CASES, CORROSION, HEALTHY, MODELS, RESEAT, diagnose_sets, percent, sets_of

from analysis.diagnosis.diagnose import UNDETERMINED
from analysis.diagnosis.hypotheses import COUPLING, SENSOR, WALL
from analysis.diagnosis.slopes import COMPONENTS
from analysis.wall import posterior
from analysis.wall.bank import FEATURES, Bank, load_bank
from analysis.wall.calibration import calibrate
from analysis.wall.thickness import Pool, WallModel, estimate_thickness
from daq_service.assessment.wall_bank import SHIPPED_BANK
from simulator.numerics.arrays import FloatArray
from simulator.parameters.environmental_variability import NUISANCE

NAMES = (*COMPONENTS, *(name for name in FEATURES if name not in COMPONENTS))
OF_DIAGNOSIS, OF_POSTERIOR = slice(len(COMPONENTS)), [NAMES.index(name) for name in FEATURES]
LOSS, PROBABILITY = 0.1, 0.9
RULES = ("diagnosis", "posterior", "either", "undetermined")


@lru_cache(maxsize=1)
def shipped() -> tuple[Bank, FloatArray]:
    """Return the shipped bank and the changes that its hypotheses predict."""
    bank = load_bank(SHIPPED_BANK)
    return bank, posterior.predict_changes(bank)


def exceedances(sets: FloatArray, causes: list[str], loss: float) -> list[float]:
    """Return the probability of more than a loss after each set since the baseline.

    ``sets`` are ln features from the first set of the baseline, ``causes`` the diagnoses after it.
    """
    bank, changes = shipped()
    wall = WallModel(
        hypotheses=posterior.compare(calibrate(bank, sets[:BASELINE]), changes),
        curves=posterior.list_curves(bank),
        initial_m=bank.thickness_m,
        baseline_h=0.5 * (BASELINE - 1),
        minimum_m=bank.thickness_m * (1.0 - loss),
    )
    state, pool = posterior.begin(len(changes), 0.5 * (BASELINE - 1)), Pool()
    found = [0.0]
    for index, cause in enumerate(causes, BASELINE):
        other = cause if cause in (SENSOR, COUPLING) else ""
        state, pool, one = estimate_thickness(wall, state, pool, sets[index], float(index), other_cause=other)
        new = None if one is None else one.below_minimum_probability
        found.append(found[-1] if new is None else new)
    return found[1:]


def call_run(case: str, level: str, model: str, seed: int, loss: float, probability: float) -> dict[str, Any]:
    """Return the depth at which each rule first calls WALL in one run; None: never."""
    logs, confirmations, depths = sets_of(CASES[case], level, model, seed, NAMES)
    of_diagnosis = logs[:, OF_DIAGNOSIS], confirmations[:, OF_DIAGNOSIS]
    causes = diagnose_sets(CASES[case], level, model, seed, *of_diagnosis, depths)["causes"]
    exceeds = exceedances(shipped()[0].sound + logs[:, OF_POSTERIOR], causes, loss)
    called = {
        "diagnosis": [cause == WALL for cause in causes],
        "posterior": [one >= probability for one in exceeds],
    }
    pairs = list(zip(*called.values(), strict=True))
    called["either"] = [any(both) for both in pairs]
    called["undetermined"] = [
        named or (lost and cause == UNDETERMINED) for cause, (named, lost) in zip(causes, pairs, strict=True)
    ]
    after = depths[BASELINE:].tolist()
    first = {
        rule: next((d for d, wall in zip(after, called[rule], strict=True) if wall), None) for rule in RULES
    }
    return {"case": case, "level": level, "model": model, "seed": seed, **first}


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
    parser.add_argument("--first-seed", type=int, default=50)
    parser.add_argument("--levels", nargs="+", default=list(NUISANCE), choices=list(NUISANCE))
    shown = [HEALTHY.name, RESEAT.name, CORROSION.name]
    parser.add_argument("--cases", nargs="+", default=shown, choices=list(CASES), metavar="CASE")
    parser.add_argument("--loss", type=float, default=LOSS, help="fraction of the wall")
    parser.add_argument("--probability", type=float, default=PROBABILITY)
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    models = list(MODELS)
    todo = [
        (case, level, models[seed % len(models)], seed, options.loss, options.probability)
        for level in options.levels
        for case in options.cases
        for seed in range(options.first_seed, options.first_seed + options.runs)
    ]
    with ProcessPoolExecutor(options.workers) as executor:
        rows = list(executor.map(call_run, *zip(*todo, strict=True), chunksize=4))
    if options.json:
        print(json.dumps({"runs": rows}))
    else:
        show(rows)


if __name__ == "__main__":
    main()
