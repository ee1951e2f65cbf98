"""Lower bound of the detectable wall loss: an oracle's median depth next to that of `diagnoses.py`.

    python benchmarks/diagnosis_bound.py            a minute on one core
    python benchmarks/diagnosis_bound.py --json

The oracle knows the true covariances of a level's memory, wander, shots and re-seats, when each re-seat came,
the model's own curve and how fast the wall corrodes; it is spared temperature and tails. Either it knows when
corrosion begins as well, or only that it does some time in the first `LATEST_ONSET` sets after the baseline,
each as likely. It calls WALL where the likelihood ratio of growth (mean over the times when it may begin)
against health passes 1 / rate: of all tests that call at most this part of the healthy runs so (Ville's
inequality), none is faster by more than the overshoot of a set. What it cannot name no assessment can.
"""

from __future__ import annotations

import argparse
import json
import os
from itertools import pairwise

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import scipy
from diagnoses import AFTER, BASELINE, CORROSION, MODELS, SHOTS, electronic_sd, model_slopes

from analysis.diagnosis.slopes import DEPTHS
from simulator.experiment.seating import compute_source_effects
from simulator.numerics.arrays import FloatArray
from simulator.parameters.environmental_variability import NUISANCE
from simulator.parameters.experiment import ScatterParameters

FALSE_RATE = 0.01
"""Of healthy runs of `AFTER` sets that may be called WALL."""
UNKNOWN_MEAN = 0.3
"""SD of where a transducer's logarithms lie before its baseline is seen: anywhere."""
LATEST_ONSET, STEP = 240, 4
"""Sets after the baseline at which corrosion may begin; tried every few."""
HISTORIES, RUNS = 100, 10
"""Of re-seats, and runs with each."""
SETS = BASELINE + AFTER


def covariances(level: str, model: str) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return covariances of set, drift, shots and re-seats in a set's seven logarithms, each shape (7, 7)."""
    found, sources, scatter = (
        model_slopes(model),
        compute_source_effects(level, MODELS[model][0]),
        ScatterParameters(),
    )
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
    return of(sources.set_sd), of(sources.wander_sd), alone, of(sources.reseat_sd)


def whitening(level: str, model: str) -> tuple[FloatArray, FloatArray]:
    """Return the whitening of all sets' logarithms, shape (7 n, 7 n), and a root of re-seats'."""
    sizes = NUISANCE[level]
    of_set, of_wander, alone, of_reseat = covariances(level, model)
    apart = np.arange(SETS)
    periods_h = np.geomspace(sizes.shortest_wander_h, sizes.longest_wander_h, 400)
    wander = np.cos(2.0 * np.pi * apart[:, None] / periods_h).mean(axis=1)
    memory = sizes.plate_stiffness.memory**apart
    rows = [scipy.linalg.toeplitz(row) for row in (memory, wander, apart == 0, np.ones(apart.size))]
    each = (of_set, of_wander, alone, UNKNOWN_MEAN**2 * np.eye(len(alone)))
    whole = sum(np.kron(in_time, one) for in_time, one in zip(rows, each, strict=True))
    factor = scipy.linalg.cholesky(whole, lower=True, overwrite_a=True, check_finite=False)
    white = scipy.linalg.solve_triangular(factor, np.eye(len(factor)), lower=True, check_finite=False)
    variances, directions = np.linalg.eigh(of_reseat)
    return white, directions * np.sqrt(np.maximum(variances, 0.0))


def growths(model: str, onsets: FloatArray) -> FloatArray:
    """Return the change of all logarithms by corrosion from so many sets after the baseline.

    Shape (7 n, k).
    """
    since = np.arange(SETS)[:, None] - BASELINE - onsets
    depths = np.minimum(CORROSION.depth * np.clip(since / AFTER, 0.0, None), DEPTHS[-1])
    curve = model_slopes(model).wall
    change = np.stack([np.interp(depths, [0.0, *DEPTHS], column) for column in curve.T], axis=1)
    return change.reshape(-1, onsets.size)


def up_to_each(values: FloatArray) -> FloatArray:
    """Sum over the sets up to each one after the baseline, shape (7 n, ...) to (AFTER, ...)."""
    return np.asarray(values.reshape(SETS, -1, *values.shape[1:]).sum(axis=1).cumsum(axis=0)[BASELINE:])


def log_ratios(grown: FloatArray, seen: FloatArray, places: FloatArray | None) -> FloatArray:
    """Return the log likelihood of each growth over that of health after each set, shape (AFTER, k, runs).

    Parameters
    ----------
    grown, seen
        Whitened, shapes (7 n, k) and (7 n, runs).
    places
        What the re-seats add, unknown numbers of variance 1 times these columns, shape (7 n, m).
    """
    squared = up_to_each(grown**2)
    log_likelihood_ratios = np.stack([up_to_each(grown * one[:, None]) for one in seen.T], axis=2)
    if places is not None:  # the inverse of identity + places places^T, by Woodbury
        inner = np.linalg.inv(np.eye(places.shape[1]) + up_to_each(places[:, :, None] * places[:, None]))
        of_grown = up_to_each(places[:, :, None] * grown[:, None])
        through = inner @ of_grown
        squared = squared - (of_grown * through).sum(axis=1)
        log_likelihood_ratios = log_likelihood_ratios - through.transpose(0, 2, 1) @ up_to_each(
            places[:, :, None] * seen[:, None]
        )
    return np.asarray(log_likelihood_ratios - 0.5 * squared[:, :, None])


def depths_of_oracle(level: str, model: str) -> dict[str, list[float]]:
    """Return the depths at which the oracle detects walls that corrode from the end of the baseline."""
    random, (white, root) = np.random.default_rng(0), whitening(level, model)
    onsets = {
        "onset known": np.zeros(1),
        "onset unknown": np.arange(0.0, LATEST_ONSET, STEP),
    }
    grown = {name: white @ growths(model, growth_of_onset) for name, growth_of_onset in onsets.items()}
    found: dict[str, list[float]] = {name: [] for name in onsets}
    for _ in range(HISTORIES):
        reseats = random.poisson(NUISANCE[level].reseats_per_1000_h * SETS / 1_000.0)
        edges = [*np.unique(random.integers(1, SETS, reseats)).tolist(), SETS]
        seen = grown["onset known"] + random.standard_normal((len(white), RUNS))
        places = None
        if reseats:
            columns = [
                white[:, 7 * first : 7 * last] @ np.tile(root, (last - first, 1))
                for first, last in pairwise(edges)
            ]
            places = np.hstack(columns)
            seen = seen + places @ random.standard_normal((places.shape[1], RUNS))
        for name, growth_of_onset in grown.items():
            ratio = scipy.special.logsumexp(log_ratios(growth_of_onset, seen, places), axis=1) - np.log(
                growth_of_onset.shape[1]
            )
            passed = ratio > -np.log(FALSE_RATE)
            first = np.where(passed.any(axis=0), passed.argmax(axis=0), AFTER)
            found[name] += (CORROSION.depth * first / AFTER).tolist()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--levels", default=",".join(NUISANCE))
    parser.add_argument("--models", default=",".join(MODELS))
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    models = options.models.split(",")
    medians: dict[str, dict[str, dict[str, float]]] = {}
    for level in options.levels.split(","):
        depths = {model: depths_of_oracle(level, model) for model in models}
        medians[level] = {
            name: {model: float(np.median(depths[model][name])) for model in models}
            | {"all": float(np.median([depth for model in models for depth in depths[model][name]]))}
            for name in depths[models[0]]
        }
    if options.json:
        print(json.dumps({"false_rate": FALSE_RATE, "median_depth": medians}))
        return
    print(f"median depth at which an oracle names the wall, {100 * FALSE_RATE:g} % of healthy runs called so")
    for level, by_name in medians.items():
        for name, by_model in by_name.items():
            log_likelihood_ratios = "  ".join(f"{model} {depth:.3f}" for model, depth in by_model.items())
            print(f"{level:11s}{name:15s}{log_likelihood_ratios}")


if __name__ == "__main__":
    main()
