"""Fleet assessment: fraction of false raises, fraction of sick sensors found, and speed.

    python benchmarks/fleet.py [--fleets N] [--sensors N] [--json]
    python benchmarks/fleet.py --speed

Fleets of sensors with memory, heavy tails and a weather that moves all of them, of which none, 1 % or 10 %
become sick (7 SD in 300 sets, beginning anywhere): the false discovery rate, next to raising whatever alarms
within the budget of each sensor. With `--speed`: 1,000 sensors of 8,766 sets by `solimon assess`, next to one
that calls the same assessment for one table after another. About ten minutes on two cores, each.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from support.healthy_sequences import P, healthy

from analysis.statistics.design import Budget
from analysis.statistics.sequence import assess_sequence
from daq_service.cli.offline.fleet import assess_fleet
from daq_service.cli.offline.table_file import TableFile
from simulator.numerics.one_thread import use_one_blas_thread

SETS = 2_000
SICK = (0.0, 0.01, 0.1)
KINDS = ("independent", "AR .6", "t5", "unequal memory")
BASELINES = (48, 200)
WEATHER_SD = 2.0
NAMES = tuple("abcde")


def fleet(kind: str, n: int, sensors: int, sick: int, gain_sd: float, random: Any) -> list[np.ndarray]:
    """Return the tables of a fleet, the sick ones first."""
    hours = np.arange(n + SETS)
    season = WEATHER_SD * np.sin(2 * np.pi * hours / SETS) + 0.5 * np.sin(2 * np.pi * hours / 24)
    tables = []
    for k in range(sensors):
        vectors = healthy(kind, n + SETS, random)
        vectors += (season * (1.0 + gain_sd * random.standard_normal()))[:, None] * np.linspace(1, 0.2, P)
        if k < sick:
            direction = random.standard_normal(P)
            begin = n + random.integers(0, SETS - 900)
            ramp = np.clip((hours - begin) / 300.0, 0.0, 1.0)
            vectors += 7.0 * ramp[:, None] * direction / np.linalg.norm(direction)
        tables.append(vectors)
    return tables


def assess_random_fleet(task: tuple[str, int, int, float, float, int]) -> dict[str, float]:
    """Assess one fleet, and count."""
    kind, n, sensors, share, gain_sd, seed = task
    sick = round(share * sensors)
    random = np.random.default_rng([seed, n, sick, sensors])
    tables = fleet(kind, n, sensors, sick, gain_sd, random)
    paths = [Path(str(k)) for k in range(sensors)]
    in_baseline = np.arange(n + SETS) < n

    def read(path: Path) -> TableFile:
        return TableFile(vectors=tables[int(path.name)], names=NAMES, in_baseline=in_baseline)

    def mapped(one: Any, of: Iterable[Any]) -> Iterable[Any]:
        return map(one, of)

    with use_one_blas_thread():
        alone = [list(assess_sequence(x, in_baseline, NAMES, textbooks=False).onsets) for x in tables]
        report = assess_fleet(paths, read, mapped, Budget(), 0.1, alone)
    raised = {int(one["file"]) for one in report["raised"]}
    by_budget = {k for k, rows in enumerate(alone) if rows}
    return {
        "false": _count_false(raised, sick),
        "found": len([k for k in raised if k < sick]) / sick if sick else float("nan"),
        "false by each budget": _count_false(by_budget, sick),
        "shared named": float(bool(report["shared"])),
        "promised": float(report["fdr_guaranteed"]),
    }


def _count_false(raised: set[int], sick: int) -> float:
    return len([k for k in raised if k >= sick]) / max(1, len(raised))


def measure(fleets: int, sensors: int, gain_sd: float, mapped: Any) -> dict[str, Any]:
    """Return everything that `main` prints."""
    found = {}
    for kind, n, share in product(KINDS, BASELINES, SICK):
        tasks = [(kind, n, sensors, share, gain_sd, seed) for seed in range(fleets)]
        outcomes = list(mapped(assess_random_fleet, tasks))
        found[f"{kind}, n = {n}, {share:.0%} sick"] = {
            key: float(np.mean([one[key] for one in outcomes])) for key in outcomes[0]
        }
        of_false = [one["false"] for one in outcomes]
        found[f"{kind}, n = {n}, {share:.0%} sick"]["standard error"] = float(
            np.std(of_false) / np.sqrt(len(of_false))
        )
    return found


def measure_speed() -> dict[str, float]:
    """Time 1,000 tables by clock and processor: a busy machine increases the first only."""
    with tempfile.TemporaryDirectory() as folder:
        random = np.random.default_rng(1)
        paths = [Path(folder) / f"sensor_{k:04d}.npy" for k in range(1000)]
        for path in paths:
            np.save(path, random.standard_normal((200 + 8_766, P)))
        took = {}
        for words in ([], ["--fleet"]):
            command = ["solimon", "assess", *map(str, paths), "--baseline-rows", "200", "--json", "--no-rows"]
            start_s, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run([*command, *words], check=True, capture_output=True)
            name = " ".join(["solimon assess", *words])
            took[name] = time.perf_counter() - start_s
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            took[f"{name}, processor"] = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        start_s = time.perf_counter()
        for path in paths:
            vectors = np.load(path)
            assess_sequence(vectors, np.arange(len(vectors)) < 200, NAMES, textbooks=False)
        took["one after another"] = time.perf_counter() - start_s
        return took


def main() -> None:
    """Print the measurements."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--fleets", type=int, default=20)
    parser.add_argument("--sensors", type=int, default=100)
    parser.add_argument("--gain-sd", type=float, default=0.0, help="how unlike the weather moves the sensors")
    parser.add_argument("--speed", action="store_true")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.speed:
        took = measure_speed()
        ratio = took["one after another"] / took["solimon assess"]
        print(json.dumps(took) if options.json else "\n".join(f"{k:36}{v:7.1f} s" for k, v in took.items()))
        if not options.json:
            print(f"{'ratio':36}{ratio:7.2f}")
        return
    with ProcessPoolExecutor() as executor:
        found = measure(options.fleets, options.sensors, options.gain_sd, executor.map)
    if options.json:
        print(json.dumps(found))
        return
    print(
        f"{'fleet':34}  false of raised   +-      sick found   false, each within its budget   weather named"
        "   promised"
    )
    for name, report in found.items():
        print(
            f"{name:34}{report['false']:17.3f}   {report['standard error']:5.3f}{report['found']:13.2f}"
            f"{report['false by each budget']:32.2f}{report['shared named']:16.2f}{report['promised']:11.2f}"
        )


if __name__ == "__main__":
    main()
