"""How shallow a wall anybody can name: the oracle's median depth beside that of `verdicts.py`.

    python benchmarks/verdict_bound.py            a minute on one core
    python benchmarks/verdict_bound.py --json

The oracle knows the true covariances of a level's memory, wander and shots, the model's own curve, when
corrosion begins and how fast it grows; it is spared re-seats, temperature and tails. It calls WALL where the
likelihood ratio of growth against health passes 1 / rate: of all tests that call at most this part of the
healthy runs so (Ville's inequality), none is faster by more than the overshoot of a set. What it cannot name
no verdict can.
"""

from __future__ import annotations

import argparse
import json
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import scipy
from verdicts import AFTER, BASELINE, CORROSION, MODELS, SHOTS, electronic_sd, judged

from analysis.causes.slopes import DEPTHS
from simulator.experiment.seating import _sources
from simulator.numerics.arrays import FloatArray
from simulator.parameters.experiment import ScatterParameters
from simulator.parameters.nuisance import NUISANCE

FALSE_RATE = 0.01
"""Of healthy runs of `AFTER` sets that may be called WALL."""
UNKNOWN_MEAN = 0.3
"""SD of where a transducer's logarithms lie before its baseline is seen: anywhere."""
RUNS = 4000


def covariances(level: str, model: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of set, wander and shots in a set's seven logarithms, each shape (7, 7)."""
    found, sources, scatter = judged(model), _sources(level, MODELS[model][0]), ScatterParameters()
    to_features = found.of_place.T @ sources.effect

    def of(sd: FloatArray) -> FloatArray:
        return np.asarray((to_features * sd**2) @ to_features.T)

    n = MODELS[model][0].bodies
    drop, tilt = found.of_place[2 * n], found.of_place[2 * n + 2]
    drop_sd = np.hypot(
        scatter.set_drop_height_sd_fraction, scatter.shot_drop_height_sd_fraction / np.sqrt(SHOTS)
    )
    alone = drop_sd**2 * np.outer(drop, drop) + scatter.set_tilt_sd_rad**2 * np.outer(tilt, tilt)
    alone += of(sources.shot_sd / np.sqrt(SHOTS)) + np.diag(electronic_sd() ** 2)
    return of(sources.set_sd), of(sources.wander_sd), alone


def information(level: str, model: str) -> FloatArray:
    """Squared distance between growing and healthy that the sets up to each tell, shape (AFTER,)."""
    sizes, found = NUISANCE[level], judged(model)
    of_set, of_wander, alone = covariances(level, model)
    apart = np.arange(BASELINE + AFTER)
    periods_h = np.geomspace(sizes.shortest_wander_h, sizes.longest_wander_h, 400)
    wander = np.cos(2.0 * np.pi * apart[:, None] / periods_h).mean(axis=1)
    memory = sizes.plate_stiffness.memory**apart
    rows = [scipy.linalg.toeplitz(row) for row in (memory, wander, apart == 0, np.ones(apart.size))]
    each = (of_set, of_wander, alone, UNKNOWN_MEAN**2 * np.eye(len(alone)))
    whole = sum(np.kron(in_time, one) for in_time, one in zip(rows, each, strict=True))
    depths = CORROSION.depth * np.clip((apart - BASELINE) / AFTER, 0.0, None)
    change = np.stack([np.interp(depths, [0.0, *DEPTHS], column) for column in found.wall.T], axis=1)
    factor = scipy.linalg.cholesky(whole, lower=True, overwrite_a=True, check_finite=False)
    told = scipy.linalg.solve_triangular(factor, change.ravel(), lower=True, check_finite=False)
    return np.cumsum((told**2).reshape(change.shape).sum(axis=1))[BASELINE:]


def depth_of_oracle(level: str, model: str) -> float:
    """Median depth at which the likelihood ratio passes its limit."""
    squared = information(level, model)
    steps = np.diff(squared, prepend=0.0)
    random = np.random.default_rng(0)
    log_ratio = np.cumsum(0.5 * steps + np.sqrt(steps) * random.standard_normal((RUNS, AFTER)), axis=1)
    passed = log_ratio > -np.log(FALSE_RATE)
    first = np.where(passed.any(axis=1), passed.argmax(axis=1), AFTER)
    return float(CORROSION.depth * np.median(first) / AFTER)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--levels", default=",".join(NUISANCE))
    parser.add_argument("--models", default=",".join(MODELS))
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    found = {
        level: {model: depth_of_oracle(level, model) for model in options.models.split(",")}
        for level in options.levels.split(",")
    }
    if options.json:
        print(json.dumps({"false_rate": FALSE_RATE, "median_depth": found}))
        return
    print(f"median depth at which an oracle names the wall, {100 * FALSE_RATE:g} % of healthy runs called so")
    for level, by_model in found.items():
        print(f"{level:11s}" + "  ".join(f"{model} {depth:.3f}" for model, depth in by_model.items()))


if __name__ == "__main__":
    main()
