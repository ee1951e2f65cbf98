"""Coverage of the bounds of the probability of detection, in simulated studies.

    python benchmarks/detection_probability.py                 2,000 studies each, four minutes on one core
    python benchmarks/detection_probability.py --studies 200 --json

A study has 6, 10 or 20 sensors. The loss at detection is lognormal; none, 10 or 30 % of the sensors are
censored, either at one loss that all tests reach, or at random ones. The signal has a random effect of the
sensor that is 0.2, 1 or 2 times its scatter between sets. A bound covers if it is at least the true a90.
Studies with too few detections have no bound: they are refused, and counted. At the end: ten looks at each
sensor pooled as if they were independent, which `solimon pod` refuses.

Exit code 1 if a bound covers in less than 93 % of the studies that have one.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Iterator
from functools import partial

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from analysis.statistics import detection_probability as pod

Z90 = 1.2815515655446004
SENSORS = (6, 10, 20)
LEAST_COVERAGE = 0.93
LOOKS = 10


def cover_losses(random: np.random.Generator, n: int, censored: float, kind: str) -> bool | None:
    """Return whether the bound of one study covers; None if the study is refused."""
    score = math.inf if not censored else -float(pod.ndtri(censored))
    spread = 0.7 if kind == "random" else 0.0
    values = random.standard_normal(n)
    limits = score * math.hypot(1.0, spread) + spread * random.standard_normal(n)
    observed = values <= limits
    if observed.sum() < pod.FEWEST_DETECTIONS:
        return None
    return pod.bound_quantile(np.minimum(values, limits), observed, 0.9) >= Z90


def cover_signals(random: np.random.Generator, n: int, between: float) -> bool:
    """Return whether the bound of the signal response covers in one study of ten looks at each sensor."""
    within = 0.15
    loss_m = np.tile(np.geomspace(0.2e-3, 2e-3, LOOKS), n)
    noise = np.repeat(between * within * random.standard_normal(n), LOOKS)
    signal = 1e3 * loss_m * np.exp(noise + within * random.standard_normal(n * LOOKS))
    found = pod.fit_signal_response(np.repeat(np.arange(n), LOOKS).tolist(), loss_m, signal, 0.6)
    return found.a90_95_m >= 0.6e-3 * math.exp(Z90 * within * math.hypot(1.0, between))


def cover_pooled(random: np.random.Generator, n: int, correlation: float) -> bool:
    """Return whether the bound covers that takes ten looks at each sensor for independent ones."""
    shared = np.repeat(random.standard_normal(n), LOOKS)
    looks = math.sqrt(correlation) * shared + math.sqrt(1.0 - correlation) * random.standard_normal(n * LOOKS)
    return pod.bound_quantile(looks, np.ones(looks.size, dtype=bool), 0.9) >= Z90


def all_studies() -> Iterator[tuple[str, int, partial[bool | None]]]:
    """Yield name, number of sensors and one random study of each kind."""
    for n in SENSORS:
        yield "loss at detection, complete", n, partial(cover_losses, n=n, censored=0.0, kind="common")
        for censored in (0.1, 0.3):
            for kind in ("common", "random"):
                study = partial(cover_losses, n=n, censored=censored, kind=kind)
                yield f"loss at detection, {censored:.0%} censored at {kind} losses", n, study
        for between in (0.2, 1.0, 2.0):
            yield (
                f"signal, sensors scatter {between:g} x sets",
                n,
                partial(cover_signals, n=n, between=between),
            )
        for correlation in (0.5, 0.9):
            study = partial(cover_pooled, n=n, correlation=correlation)
            yield f"pooled looks, correlation {correlation:g}", n, study


def main() -> int:
    parser = argparse.ArgumentParser(description="Coverage of a90/95 in simulated studies")
    parser.add_argument("--studies", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=20261128)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    results = []
    for index, (name, n, study) in enumerate(all_studies()):
        random = np.random.default_rng([options.seed, index])
        covered = [study(random) for _ in range(options.studies)]
        bounds = [one for one in covered if one is not None]
        coverage = float(np.mean(bounds))
        results.append({"study": name, "sensors": n, "coverage": coverage, "refused": covered.count(None)})
        if not options.json:
            print(f"{name:48} {n:3d} sensors: {coverage:.1%}, {covered.count(None)} refused", flush=True)
    if options.json:
        print(json.dumps(results))
    claimed = [one["coverage"] for one in results if not one["study"].startswith("pooled")]
    return int(min(claimed) < LEAST_COVERAGE)


if __name__ == "__main__":
    sys.exit(main())
