"""Time of a shot: cold (no cached reduction), with a new depth, and warm.

    python benchmarks/shot_speed.py [--mesh] [--json]

Wall time and processor time of this process, machine code of the kernel already compiled; the medians of
several runs. Processor time is what one core needs, whatever else the machine is busy with. Two threads
show that shots run side by side. Takes some ten seconds; `--mesh`, which shows how the cost grows with the
elements along an edge, as long again.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

# Small dense problems: BLAS threads only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import Impact, ShotModel
from simulator.shot.pulse_summary import summarise_pulses

RECORD_S = 1.4e-3
COLD_RUNS, DEPTHS, WARM_SHOTS = 5, 40, 200
MESHES = (48, 96, 144, 192)


def seconds(work: Callable[[], object]) -> tuple[float, float]:
    """Return wall and processor time."""
    wall, processor = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - processor


def median(runs: list[tuple[float, float]], each: int = 1) -> dict[str, float]:
    wall, processor = (statistics.median(times) / each for times in zip(*runs, strict=True))
    return {"wall_s": wall, "processor_s": processor}


def measure() -> dict[str, dict[str, float]]:
    parameters = ChainParameters(), PlateParameters(), CorrosionParameters()

    def model_in(folder: str) -> ShotModel:
        return ShotModel(*parameters, duration_s=RECORD_S, cache_folder=Path(folder))

    def cold() -> None:
        with tempfile.TemporaryDirectory() as folder:
            model_in(folder).shot()

    cold()  # compiles or loads the kernel
    with tempfile.TemporaryDirectory() as folder:
        model = model_in(folder)
        model.shot()
        new = [seconds(lambda k=k: model.shot(depth_fraction=0.2 + 1e-3 * k)) for k in range(DEPTHS)]
        warm = [seconds(lambda: model.shot(drop_height_m=5.1e-3, tilt_rad=0.01)) for _ in range(WARM_SHOTS)]
        summary = [seconds(lambda: summarise_pulses(model.shot())) for _ in range(WARM_SHOTS)]
        strikes = [Impact(drop_height_m=4e-3 + 2e-5 * k, tilt_rad=0.01) for k in range(80)]
        model.shots(strikes)
        batch = [seconds(lambda: model.shots(strikes)) for _ in range(10)]
        with ThreadPoolExecutor(2) as pool:
            both = seconds(lambda: list(pool.map(lambda _: model.shot(), range(2 * WARM_SHOTS))))
        from_disk = [seconds(lambda: model_in(folder).shot()) for _ in range(COLD_RUNS)]
    return {
        "cold": median([seconds(cold) for _ in range(COLD_RUNS)]),
        "reduction_kept": median(from_disk),
        "new_depth": median(new),
        "warm": median(warm),
        "warm_with_summary": median(summary),
        "batch_per_shot": median(batch, len(strikes)),
        "two_threads_per_shot": median([both], 2 * WARM_SHOTS),
    }


def measure_mesh(elements: int) -> dict[str, dict[str, float]]:
    plate = PlateParameters(elements_per_edge=elements)

    def prepared() -> ShotModel:
        return ShotModel(
            ChainParameters(), plate, CorrosionParameters(), duration_s=RECORD_S, cache_folder=None
        )

    model = prepared()
    model.shot()
    return {
        f"cold_{elements}": median([seconds(lambda: prepared().shot()) for _ in range(3)]),
        f"new_depth_{elements}": median(
            [seconds(lambda k=k: model.shot(depth_fraction=0.2 + 1e-3 * k)) for k in range(DEPTHS)]
        ),
        f"warm_{elements}": median([seconds(model.shot) for _ in range(WARM_SHOTS)]),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mesh", action="store_true", help="grow the mesh, too")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()
    results = measure()
    if arguments.mesh:
        for elements in MESHES:
            results |= measure_mesh(elements)
    if arguments.json:
        print(json.dumps(results))
    else:
        for name, times in results.items():
            wall, processor = (1e3 * times[kind] for kind in ("wall_s", "processor_s"))
            print(f"{name:24s} {wall:9.2f} ms wall {processor:9.2f} ms processor")
    return 0


if __name__ == "__main__":
    sys.exit(main())
