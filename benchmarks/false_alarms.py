"""False alarms of `solimon assess` on healthy sequences with autocorrelation, heavy tails and slow drift.

    python benchmarks/false_alarms.py [--runs N] [--json]

For baselines of 48 and 200 sets: the rate of the default limit (nominal .27 %), the alarms of the default
chart in five years (24 sets per day, a budget of one), and how often it says that its rate is not promised;
the median delay to a slow change; how often bad sets of a baseline are named, and healthy ones. Next to them
the paper's limit and the plain F limit on the same sequences. About ten minutes on two cores with 100 runs.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from support.healthy_sequences import NAMES, P, healthy

from analysis.statistics.baseline_check import find_anomalies
from analysis.statistics.design import Budget
from analysis.statistics.sequence import Assessed, assess_sequence

FIVE_YEARS = round(Budget().run_length)
BASELINES = (48, 200)
RAMP_SD, RAMP_SETS = 7.0, 300
DELAYED = ("independent", "unequal memory")
LIMITS = ("default", "f_predictive", "paper_mean_3sd")
FEATURES = [f"feature {k}" for k in range(P)]


def assessed_sequence(vectors: Any, n: int) -> Assessed:
    """Assess a sequence whose first ``n`` sets are the baseline."""
    return assess_sequence(vectors, np.arange(len(vectors)) < n, FEATURES, textbooks=False)


def assess_healthy(task: tuple[str, int, int]) -> dict[str, float]:
    """Assess five years of one healthy sensor."""
    name, n, seed = task
    found = assessed_sequence(healthy(name, n + FIVE_YEARS, np.random.default_rng([seed, n])), n)
    rates = {limit: 100.0 * found.count[limit] / FIVE_YEARS for limit in LIMITS}
    return {**rates, "alarms": len(found.onsets), "not promised": bool(found.rate_not_verified_reason)}


def delay_sets(task: tuple[str, int, int]) -> float:
    """Count the sets from the start of a ramp in a random direction to the alarm; infinite: none."""
    name, n, seed = task
    random = np.random.default_rng([seed, n])
    vectors = healthy(name, n + 2 * RAMP_SETS, random)
    direction = random.standard_normal(P)
    ramp = RAMP_SD * np.arange(1, 2 * RAMP_SETS + 1) / RAMP_SETS
    vectors[n:] += ramp[:, None] * direction / np.linalg.norm(direction)
    onsets = assessed_sequence(vectors, n).onsets
    return float(onsets[0] - n + 1) if onsets else float("inf")


BAD = ("healthy", "8 sets 8 SD off alike", "one set 10 SD off", "trend of 3 SD each")


def is_fault_named(task: tuple[str, int, int]) -> bool:
    """Return whether the check names the kind of a baseline's fault (of a healthy one: any)."""
    fault, n, seed = task
    random = np.random.default_rng([seed, n])
    vectors = random.standard_normal((n, P))
    direction = random.standard_normal(P)
    direction /= np.linalg.norm(direction)
    rows = random.permutation(n)
    if fault == BAD[1]:
        vectors[rows[:8]] += 8.0 * direction
    elif fault == BAD[2]:
        vectors[rows[0]] += 10.0 * direction
    elif fault == BAD[3]:
        vectors += 3.0 * np.linspace(0.0, 1.0, n)[:, None]
    kinds = {one.kind for one in find_anomalies(vectors)}
    wanted = {BAD[1]: "group", BAD[2]: "outlier", BAD[3]: "trend"}.get(fault)
    return bool(kinds) if wanted is None else wanted in kinds


def measure(runs: int, each: Callable[..., Any]) -> dict[str, Any]:
    """Return everything that `main` prints; ``each`` maps a function over tasks."""
    found: dict[str, Any] = {"healthy": {}, "delay_sets": {}, "named": {}}
    for n in BASELINES:
        for name in NAMES:
            outcomes = list(each(assess_healthy, [(name, n, seed) for seed in range(runs)]))
            means = {key: float(np.mean([one[key] for one in outcomes])) for key in outcomes[0]}
            found["healthy"][f"{name}, n = {n}"] = means
            print(f"{name}, n = {n}", file=sys.stderr)
        for name in DELAYED:
            delays = list(each(delay_sets, [(name, n, seed) for seed in range(3 * runs)]))
            found["delay_sets"][f"{name}, n = {n}"] = float(np.median(delays))
    for fault in BAD:
        found["named"][fault] = float(
            np.mean(list(each(is_fault_named, [(fault, 48, seed) for seed in range(5 * runs)])))
        )
    return found


def main() -> None:
    """Print the measurements."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with ProcessPoolExecutor() as executor:
        found = measure(options.runs, lambda function, tasks: executor.map(function, tasks, chunksize=4))
    if options.json:
        print(json.dumps(found))
        return
    print(f"{'healthy sensor':24}{'default':>9}{'F':>8}{'paper':>8}  %   alarms in 5 years   not promised")
    for name, means in found["healthy"].items():
        rates = f"{means['default']:9.3f}{means['f_predictive']:8.3f}{means['paper_mean_3sd']:8.2f}"
        print(f"{name:24}{rates}      {means['alarms']:8.2f}            {100 * means['not promised']:6.0f} %")
    for name, sets in found["delay_sets"].items():
        print(f"a ramp of {RAMP_SD:g} SD in {RAMP_SETS} sets, {name}: alarm after {sets:.0f} sets (median)")
    for fault, share in found["named"].items():
        print(f"baseline of 48 sets, {fault}: named in {100 * share:.1f} %")


if __name__ == "__main__":
    main()
