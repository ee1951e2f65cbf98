"""Rows a second of a sweep: a loop of single shots against threads and processes.

    python benchmarks/sweep_speed.py [--workers N] [--rows N] [--json]

Three sweeps of the paper's plate, each reduction kept: depths (one chain), a grid of depths and drop
heights, and Zener's model. The loop prepares every shot anew, as one call of the simulator for each row
would; processes are timed with and without their start. Takes about a minute on two cores.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterable

# Small dense problems: BLAS threads only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import threading
from concurrent.futures import Executor

from daq_service.sweep.execution import ExecutorKind, compute, opened_executor, usable_cores
from daq_service.sweep.plan import Model, Plan, make_plan
from daq_service.sweep.shot import coupled_numbers, zener_numbers
from daq_service.sweep.specification import parse_axis
from simulator.chain_parameters import ChainParameters
from simulator.coupled_model import ShotModel
from simulator.plate_parameters import CorrosionParameters, PlateParameters

BASE = ChainParameters(), PlateParameters(), CorrosionParameters()


def sweeps(rows: int) -> dict[str, Plan]:
    def planned(model: Model, *specifications: str) -> Plan:
        return make_plan(model, BASE, [parse_axis(text) for text in specifications])

    side = max(2, round(rows**0.5))
    return {
        "depths": planned("coupled", f"corrosion.depth_fraction=0:0.8:{rows}"),
        "depths x heights": planned(
            "coupled", f"corrosion.depth_fraction=0:0.8:{side}", f"chain.drop_height_m=0.003:0.008:{side}"
        ),
        "zener": planned("zener", f"corrosion.depth_fraction=0:0.8:{max(2, rows // 5)}"),
    }


def seconds(work: Callable[[], object]) -> float:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


def loop(plan: Plan) -> None:
    for row in plan.rows:
        assert row.specimen is not None
        if plan.model == "zener":
            zener_numbers(*row.specimen)
        else:
            coupled_numbers(ShotModel(*row.specimen).shot())


def computed(plan: Plan, executor: Executor, workers: int) -> None:
    kept: list[int] = []
    compute(
        plan,
        plan.rows,
        executor,
        workers=workers,
        keep=lambda outcomes: kept.extend(outcome.index for outcome in outcomes),
        stop=threading.Event(),
    )
    assert len(kept) == len(plan.rows)


def measure(plan: Plan, workers: int) -> dict[str, float]:
    rows = len(plan.rows)
    loop_s = seconds(lambda: loop(plan))
    result = {"rows": float(rows), "loop_per_s": rows / loop_s}
    kinds: Iterable[tuple[ExecutorKind, int]] = (("threads", 1), ("threads", workers), ("processes", workers))
    for kind, count in kinds:
        started = time.perf_counter()
        with opened_executor(kind, count) as executor:
            computed(plan, executor, count)  # starts processes, compiles or loads, fills their memory
            whole_s = time.perf_counter() - started
            again_s = seconds(lambda executor=executor, count=count: computed(plan, executor, count))
        result[f"{kind}_{count}_per_s"] = rows / again_s
        if kind == "processes":
            result["processes_start_s"] = max(0.0, whole_s - again_s)
    return result


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--workers", type=int, default=usable_cores(), help="default: one for each core")
    parser.add_argument("--rows", type=int, default=1000, help="of each sweep, about (default: 1000)")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()
    plans = sweeps(arguments.rows)
    for plan in plans.values():
        loop(Plan(model=plan.model, keys=plan.keys, rows=plan.rows[:1]))  # compiles, reduces
    results = {name: measure(plan, arguments.workers) for name, plan in plans.items()}
    if arguments.json:
        print(json.dumps(results))
        return 0
    for name, result in results.items():
        print(f"{name}: {result['rows']:.0f} rows")
        for key, value in result.items():
            if key.endswith("_per_s"):
                told = key.removesuffix("_per_s").replace("_", " ")
                print(f"  {told:12s} {value:7.0f} a second, x {value / result['loop_per_s']:.2f}")
        print(f"  starting the processes takes {result['processes_start_s']:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
