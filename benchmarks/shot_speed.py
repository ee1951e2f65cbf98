"""How long a shot takes: cold (no reduction kept), with a new depth, and warm.

    python benchmarks/shot_speed.py [--json]

Wall time of this process, machine code of the kernel already compiled; the median of several runs.
Two threads show that shots run side by side. Takes some ten seconds.
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

from simulator.chain_parameters import ChainParameters
from simulator.coupled_model import Impact, ShotModel
from simulator.plate_parameters import CorrosionParameters, PlateParameters
from simulator.pulse_summary import summarise

RECORD_S = 1.4e-3
COLD_RUNS, DEPTHS, WARM_SHOTS = 5, 40, 200


def seconds(work: Callable[[], object]) -> float:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


def measure() -> dict[str, float]:
    parameters = ChainParameters(), PlateParameters(), CorrosionParameters()

    def cold() -> None:
        with tempfile.TemporaryDirectory() as folder:
            ShotModel(*parameters, duration_s=RECORD_S, cache_folder=Path(folder)).shot()

    cold()  # compiles or loads the kernel
    with tempfile.TemporaryDirectory() as folder:
        model = ShotModel(*parameters, duration_s=RECORD_S, cache_folder=Path(folder))
        model.shot()
        new = [seconds(lambda k=k: model.shot(depth_fraction=0.2 + 1e-3 * k)) for k in range(DEPTHS)]
        warm = [seconds(lambda: model.shot(drop_height_m=5.1e-3, tilt_rad=0.01)) for _ in range(WARM_SHOTS)]
        summary = [seconds(lambda: summarise(model.shot())) for _ in range(WARM_SHOTS)]
        strikes = [Impact(drop_height_m=4e-3 + 2e-5 * k, tilt_rad=0.01) for k in range(80)]
        model.shots(strikes)
        batch = [seconds(lambda: model.shots(strikes)) / len(strikes) for _ in range(10)]
        with ThreadPoolExecutor(2) as pool:
            both = seconds(lambda: list(pool.map(lambda _: model.shot(), range(2 * WARM_SHOTS))))
        from_disk = seconds(
            lambda: ShotModel(*parameters, duration_s=RECORD_S, cache_folder=Path(folder)).shot()
        )
    return {
        "cold_s": statistics.median(seconds(cold) for _ in range(COLD_RUNS)),
        "reduction_kept_s": from_disk,
        "new_depth_s": statistics.median(new),
        "warm_s": statistics.median(warm),
        "warm_with_summary_s": statistics.median(summary),
        "batch_s_per_shot": statistics.median(batch),
        "two_threads_s_per_shot": both / (2 * WARM_SHOTS),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()
    results = measure()
    if arguments.json:
        print(json.dumps(results))
    else:
        for name, value in results.items():
            print(f"{name:24s} {1e3 * value:9.2f} ms")
    return 0


if __name__ == "__main__":
    sys.exit(main())
