"""Rows per second of a sweep: a loop of single shots against threads and processes.

    python benchmarks/sweep_speed.py [--workers N] [--rows N] [--json]

Three sweeps of the paper's plate, its reduction kept on disk: depths (one chain), a grid of depths and
drop heights, and Zener's model. The loop prepares every shot again, as one call of the simulator for each
row would. Executors are started before they are timed, and every run has depths of its own: nothing it
computes is remembered. The best of several runs counts. Takes about a minute on two cores.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable

# Small dense problems: BLAS threads only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import threading
from concurrent.futures import Executor
from functools import partial

from daq_service.cli.sweep.execution import compute_plan_rows
from daq_service.cli.sweep.plan import Model, Plan, build_plan
from daq_service.cli.sweep.shot import compute_zener_impact, summarise_coupled_shot
from daq_service.cli.sweep.specification import parse_axis
from daq_service.processes.executors import count_usable_cores, open_executor
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import ShotModel

BASE = ChainParameters(), PlateParameters(), CorrosionParameters()


SWEEPS = ("depths", "depths x heights", "zener")
RUNS = 2


def plan_sweep(sweep: str, rows: int, run: int) -> Plan:
    """Plan a sweep whose depths no other run has."""
    shift = 1e-4 * (run + 1)
    side = max(2, round(rows**0.5))
    count = {"depths": rows, "depths x heights": side, "zener": max(2, rows // 5)}[sweep]
    specifications = [f"corrosion.depth_fraction={shift}:{0.8 + shift}:{count}"]
    if sweep == "depths x heights":
        specifications.append(f"chain.drop_height_m=0.003:0.008:{side}")
    model: Model = "zener" if sweep == "zener" else "coupled"
    return build_plan(model, BASE, [parse_axis(text) for text in specifications])


def seconds(work: Callable[[], object]) -> float:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


def run_loop(plan: Plan) -> None:
    for row in plan.rows:
        assert row.specimen is not None
        if plan.model == "zener":
            compute_zener_impact(*row.specimen)
        else:
            summarise_coupled_shot(row.specimen, ShotModel(*row.specimen).shot(contact_forces=True))


def run_sweep(plan: Plan, executor: Executor, workers: int) -> None:
    kept: list[int] = []
    compute_plan_rows(
        plan,
        plan.rows,
        executor,
        workers=workers,
        keep=lambda outcomes: kept.extend(outcome.index for outcome in outcomes),
        stop=threading.Event(),
    )
    assert len(kept) == len(plan.rows)


def measure(sweep: str, rows: int, workers: int) -> dict[str, float]:
    numbers = iter(range(1000))

    def best(work: Callable[[Plan], None]) -> float:
        return max(
            len(plan.rows) / seconds(partial(work, plan))
            for plan in [plan_sweep(sweep, rows, next(numbers)) for _ in range(RUNS)]
        )

    result = {"rows": float(len(plan_sweep(sweep, rows, 0).rows)), "loop_per_s": best(run_loop)}
    kinds: list[tuple[str, int]] = [("threads", 1), ("threads", workers), ("processes", workers)]
    for kind, count in kinds:
        with open_executor(kind, count) as executor:
            work = partial(run_sweep, executor=executor, workers=count)
            result[f"{kind}_start_s"] = seconds(partial(work, plan_sweep(sweep, 40 * count, next(numbers))))
            result[f"{kind}_{count}_per_s"] = best(work)
    return result


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--workers", type=int, default=count_usable_cores(), help="default: one for each core"
    )
    parser.add_argument("--rows", type=int, default=400, help="of each sweep, about (default: 400)")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()
    run_loop(plan_sweep("depths", 2, 999))  # compiles, reduces
    results = {name: measure(name, arguments.rows, arguments.workers) for name in SWEEPS}
    if arguments.json:
        print(json.dumps(results))
        return 0
    for name, result in results.items():
        print(f"{name}: {result['rows']:.0f} rows")
        for key, value in result.items():
            if key.endswith("_per_s"):
                label = key.removesuffix("_per_s").replace("_", " ")
                print(f"  {label:12s} {value:7.0f} a second, x {value / result['loop_per_s']:.2f}")
        print(f"  starting the processes takes {result['processes_start_s']:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
