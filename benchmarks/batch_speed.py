"""Shots per second, alone and side by side; their scaling, and the distance to the arithmetic limit.

    python benchmarks/batch_speed.py [--json]

Seconds are processor time of one core, so that other work on the machine counts less; single shots and
batches take turns, and ratios are medians over the turns. Errors are relative L2 differences of the sensor
force from 0 to 1.2 ms, the largest over four depths, against a step sixteen times smaller with more modes.
Flops are counted in `shot.kernel`, a fused multiply-add as two, a root or a quotient as one; the limit is
what independent fused multiply-adds reach here. Fails (exit code 1) above an error of 1e-4. Takes about half
a minute, machine code compiled.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace

# Small dense problems: BLAS threads only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numba
import numpy as np

from simulator.numerics.lanes import broadcast, fma, lane
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.kernel import WIDEST
from simulator.shot.model import Impact, ShotModel

RECORD_S, COMPARED_S = 1.4e-3, 1.2e-3
STEPS_S = (5e-7, 1e-6)
DEPTHS = (0.0, 0.4, 0.8, 0.9)
LIMIT = 1e-4
BATCH, TURNS = 80, 15
FLOPS_PER_MODE, FLOPS_PER_BODY, FLOPS_AT_PLATE = 12, 57, 110
PATCH = CorrosionParameters()


def cpu_seconds(work: Callable[[], object]) -> float:
    started = time.process_time()
    work()
    return time.process_time() - started


def impacts(count: int) -> list[Impact]:
    """Return drop heights and tilts as they scatter."""
    return [Impact(drop_height_m=4e-3 + 2e-5 * k, tilt_rad=0.01 + 1e-4 * k) for k in range(count)]


@numba.njit(error_model="numpy")  # type: ignore[misc]
def multiply_and_add(turns: int) -> float:
    """Run sixteen independent chains of fused multiply-adds: enough to hide their latency."""
    a = b = c = d = e = f = g = h = broadcast(1.0, WIDEST)
    i = j = k = m = n = o = p = q = broadcast(2.0, WIDEST)
    x, y = broadcast(0.999, WIDEST), broadcast(1e-3, WIDEST)
    for _ in range(turns):
        a, b, c, d = fma(a, x, y), fma(b, x, y), fma(c, x, y), fma(d, x, y)
        e, f, g, h = fma(e, x, y), fma(f, x, y), fma(g, x, y), fma(h, x, y)
        i, j, k, m = fma(i, x, y), fma(j, x, y), fma(k, x, y), fma(m, x, y)
        n, o, p, q = fma(n, x, y), fma(o, x, y), fma(p, x, y), fma(q, x, y)
    total = a + b + c + d + e + f + g + h + i + j + k + m + n + o + p + q
    return lane(total, 0)  # type: ignore[no-any-return]


def peak_flops_per_s() -> float:
    multiply_and_add(10)
    turns = 2_000_000
    return max(2 * 16 * WIDEST * turns / cpu_seconds(lambda: multiply_and_add(turns)) for _ in range(5))


def flops_per_shot(bodies: int, modes: int, steps: int) -> float:
    return steps * (modes * FLOPS_PER_MODE + (bodies - 1) * FLOPS_PER_BODY + FLOPS_AT_PLATE)


def modes_of(model: ShotModel) -> int:
    """Return the modes in the bank of the pristine depth, zeros of full blocks included."""
    (propagator,) = [entry for (depth, *_), entry in model._prepared.items() if depth == 0.0]
    return propagator.bank.size // 16


def waveform_error(step_s: float) -> float:
    def force(step: float, depth: float) -> np.ndarray:
        return (
            ShotModel(ChainParameters(), PlateParameters(), PATCH, duration_s=COMPARED_S, step_s=step)
            .shot(depth_fraction=depth)
            .force_n
        )

    errors = []
    for depth in DEPTHS:
        reference = force(STEPS_S[0] / 16, depth)[:: round(16 * step_s / STEPS_S[0])]
        errors.append(np.linalg.norm(force(step_s, depth) - reference) / np.linalg.norm(reference))
    return float(max(errors))


def throughput(step_s: float) -> dict[str, float]:
    model = ShotModel(ChainParameters(), PlateParameters(), PATCH, duration_s=RECORD_S, step_s=step_s)
    many = impacts(BATCH)
    model.shots(many)  # compiles or loads the kernels
    model.shot()
    single, batch, ten = [], [], []
    for _ in range(TURNS):
        single.append(cpu_seconds(lambda: [model.shot(tilt_rad=0.01) for _ in range(20)]) / 20)
        batch.append(cpu_seconds(lambda: model.shots(many)) / BATCH)
        ten.append(cpu_seconds(lambda: model.shots(many[:10])) / 10)
    flops = flops_per_shot(9, modes_of(model), round(RECORD_S / step_s))
    return {
        "step_s": step_s,
        "error_l2": waveform_error(step_s),
        "single_s": statistics.median(single),
        "batch_shots_per_s": 1.0 / statistics.median(batch),
        "ten_shots_per_s": 1.0 / statistics.median(ten),
        "single_over_batch": statistics.median(a / b for a, b in zip(single, batch, strict=True)),
        "mflop_per_shot": 1e-6 * flops,
        "single_gflop_per_s": 1e-9 * flops / statistics.median(single),
        "batch_gflop_per_s": 1e-9 * flops / statistics.median(batch),
    }


def growth() -> list[dict[str, float]]:
    """Measure the time of a single shot and of one in a batch for more bodies, no modes, a longer record."""
    paper = ChainParameters()
    wall = PlateParameters(model="rigid_wall")
    cases = [
        ("9 bodies, no modes", replace(paper), wall, RECORD_S),
        ("18 bodies, no modes", replace(paper, spheres_below=13), wall, RECORD_S),
        ("36 bodies, no modes", replace(paper, spheres_below=31), wall, RECORD_S),
        ("9 bodies, the plate's modes", paper, PlateParameters(), RECORD_S),
        ("the same, twice as long", paper, PlateParameters(), 2 * RECORD_S),
    ]
    rows = []
    for name, chain, plate, duration_s in cases:
        model = ShotModel(chain, plate, PATCH, duration_s=duration_s, step_s=STEPS_S[0])
        some = impacts(4 * WIDEST)
        model.shots(some)
        single = [cpu_seconds(lambda m=model: [m.shot() for _ in range(10)]) / 10 for _ in range(TURNS)]
        batch = [cpu_seconds(lambda m=model, s=some: m.shots(s)) / len(some) for _ in range(TURNS)]
        rows.append(
            {"case": name, "single_s": statistics.median(single), "in_batch_s": statistics.median(batch)}
        )
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()
    peak = peak_flops_per_s()
    rows = [throughput(step_s) for step_s in STEPS_S]
    grown = growth()
    passed = all(row["error_l2"] <= LIMIT for row in rows)
    if arguments.json:
        print(json.dumps({"peak_flops_per_s": peak, "steps": rows, "growth": grown, "passed": passed}))
        return 0 if passed else 1
    for row in rows:
        print(
            f"step {1e6 * row['step_s']:.1f} us: error {row['error_l2']:.1e} (limit {LIMIT:.0e}); "
            f"single {1e3 * row['single_s']:.3f} ms, in batches of {BATCH} {row['batch_shots_per_s']:.0f} a "
            f"second, of ten {row['ten_shots_per_s']:.0f}; ratio {row['single_over_batch']:.2f}; "
            f"{row['mflop_per_shot']:.1f} Mflop a shot: {row['single_gflop_per_s']:.0f} and "
            f"{row['batch_gflop_per_s']:.0f} of {1e-9 * peak:.0f} Gflop/s"
        )
    for grown_row in grown:
        print(
            f"{grown_row['case']:28s} single {1e3 * grown_row['single_s']:.3f} ms, "
            f"in a batch {1e3 * grown_row['in_batch_s']:.3f} ms"
        )
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
