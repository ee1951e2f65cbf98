"""Comparison of the unreduced plate (quarter mesh, all unknowns) with the reduced one.

The reference shares the parameters and the mesh with the twin and nothing else: the trapezoidal rule
in time, for the chain and for every unknown of the plate, where the twin has modes propagated exactly
and a multistep method. Its own convergence is shown with three steps, each half of the one before; the
observed order is two, and the two finest are extrapolated to step zero (Richardson).

    python benchmarks/reduced_against_unreduced.py [--quick] [--all] [--json]

Prints, for the depths 0, 40 and 80 % of position B's patch, the relative L2 difference of the sensor
force from 0 to 1.2 ms and the ratio of the times a shot takes; with `--all` for 0, 10, 40, 80 and 95 % of
B's and of C's patch. Fails (exit code 1) above 1e-4. Takes about three minutes, ten with `--all`; `--quick`
takes coarser steps and, alone, one depth: half a minute. Times are processor times.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import sys
import time
from dataclasses import dataclass

# Two threads of a small banded solve only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from simulator.chain.spheres import Chain, build_chain
from simulator.numerics.machine_code import jit_compile
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin.plate import AffinePlate, build_plate
from simulator.shot.model import ShotModel

FloatArray = NDArray[np.float64]

RECORD_S = 1.2e-3
SAMPLE_S = 5e-7
LIMIT = 1e-4
WARM_SHOTS = 50
SIZES_M = (25.4e-3, 50.8e-3)
"""Patches of positions B and C."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Depth with its differences relative to the L2 norm of the reference force."""

    size_m: float
    depth_fraction: float
    unknowns: int
    steps_s: tuple[float, ...]
    reference_changes: tuple[float, ...]
    observed_order: float
    difference_l2: float
    unreduced_s: float
    reduced_s: float

    @property
    def time_ratio(self) -> float:
        """Return unreduced over reduced time of a shot."""
        return self.unreduced_s / self.reduced_s


@jit_compile(nogil=True)
def advance_chain(
    mass: FloatArray,
    stiffness: FloatArray,
    damping: FloatArray,
    static_force: FloatArray,
    static_overlap: FloatArray,
    striker_gain: float,
    h: float,
    w_free: float,
    w_per_impulse: float,
    u: FloatArray,
    v: FloatArray,
    force: FloatArray,
    overlap: FloatArray,
) -> float:
    """Take a trapezoidal step of all bodies by fixed-point iteration; return the impulse on the plate.

    The plate's deflection at the end of the step is ``w_free + w_per_impulse * impulse``. Its contact is
    solved by bisection within each iteration, because a fine mesh yields so easily to a fast impulse
    that a plain iteration does not settle.
    """
    n = len(mass)
    new_u = u + h * v
    new_force = force.copy()
    new_overlap = overlap.copy()
    impulse = np.zeros(n)
    last = n - 1
    yielding = w_per_impulse + 0.5 * h / mass[last]
    for _ in range(200):
        for i in range(n):
            if i < last:
                p = max(new_u[i] - new_u[i + 1] + static_overlap[i], 0.0)
            else:
                without = u[i] + h * v[i] + 0.5 * h * impulse[i - 1] / mass[i] - w_free + static_overlap[i]
                low, p = 0.0, max(without, 0.0) + overlap[i]
                for _ in range(100):
                    middle = 0.5 * (low + p)
                    pressed = stiffness[i] * middle**1.5 - static_force[i]
                    given = 0.5 * h * (force[i] + pressed) + damping[i] * (middle - overlap[i])
                    if middle + yielding * given > without:
                        p = middle
                    else:
                        low = middle
            new_overlap[i] = p
            new_force[i] = stiffness[i] * p**1.5 - static_force[i]
            impulse[i] = 0.5 * h * (force[i] + new_force[i]) + damping[i] * (p - overlap[i])
        moved = 0.0
        for i in range(n):
            above = impulse[i - 1] if i > 0 else striker_gain
            position = u[i] + 0.5 * h * (2.0 * v[i] + (above - impulse[i]) / mass[i])
            moved = max(moved, abs(position - new_u[i]))
            new_u[i] = position
        if moved < 1e-19:  # metres; overlaps are some 1e-5 m
            break
    for i in range(n):
        above = impulse[i - 1] if i > 0 else striker_gain
        v[i] += (above - impulse[i]) / mass[i]
    u[:] = new_u
    force[:] = new_force
    overlap[:] = new_overlap
    return impulse[n - 1]


def unreduced_force(chain: Chain, plate: AffinePlate, depth: float, h: float) -> FloatArray:
    """Return the sensor force every `SAMPLE_S`, integrated with step `h`.

    Plate: ``M (v_1 - v_0) = -h K (u_0 + u_1) / 2 + b B``, solved with ``M + h^2 K / 4``.
    """
    stiffness, mass = (matrix.tocsr() for matrix in plate.evaluate_at_depth(depth))
    factor = linalg.cholesky_banded(lower_band(mass + 0.25 * h**2 * stiffness), lower=True)
    contact = int(np.flatnonzero(plate.load)[0])
    response = linalg.cho_solve_banded((factor, True), plate.load, check_finite=False)

    plate_u = np.zeros(len(plate.load))
    plate_v = np.zeros_like(plate_u)
    u = np.zeros(len(chain.mass_kg))
    v = np.zeros_like(u)
    v[0] = chain.impact_speed_m_per_s
    force = np.zeros_like(u)
    overlap = chain.static_overlap_m.copy()
    gain = float(chain.mass_kg[0]) * chain.gravity_m_per_s2 * h
    every = round(SAMPLE_S / h)
    samples = np.empty(round(RECORD_S / SAMPLE_S) + 1)
    samples[0] = chain.preload_n
    faces = slice(chain.sensor - 1, chain.sensor + 1)
    for n in range(1, (len(samples) - 1) * every + 1):
        right = 2.0 * (mass @ plate_v) - h * (stiffness @ plate_u)
        free_v = (
            linalg.cho_solve_banded((factor, True), right, overwrite_b=True, check_finite=False) - plate_v
        )
        w_free = plate_u[contact] + 0.5 * h * (plate_v[contact] + free_v[contact])
        impulse = advance_chain(
            chain.mass_kg,
            chain.stiffness_n_per_m15,
            chain.damping_n_s_per_m,
            chain.static_force_n,
            chain.static_overlap_m,
            gain,
            h,
            w_free,
            0.5 * h * response[contact],
            u,
            v,
            force,
            overlap,
        )
        new_v = free_v + impulse * response
        plate_u += 0.5 * h * (plate_v + new_v)
        plate_v = new_v
        if n % every == 0:
            closing = v[chain.sensor - 1 : chain.sensor + 1] - v[chain.sensor : chain.sensor + 2]
            pressed = force[faces] + chain.static_force_n[faces] + chain.damping_n_s_per_m[faces] * closing
            samples[n // every] = 0.5 * np.sum(np.where(overlap[faces] > 0.0, pressed, 0.0))
    return samples


def lower_band(matrix: sparse.csr_matrix) -> FloatArray:
    entries = matrix.tocoo()
    below = entries.row - entries.col
    lower = below >= 0
    band = np.zeros((int(below.max()) + 1, matrix.shape[0]))
    band[below[lower], entries.col[lower]] = entries.data[lower]
    return band


def compare(size_m: float, depth: float, steps_s: tuple[float, ...]) -> Comparison:
    parameters, plate, patch = ChainParameters(), PlateParameters(), CorrosionParameters(size_m=size_m)
    affine = build_plate(plate, patch)
    chain = build_chain(parameters, plate)
    model = ShotModel(parameters, plate, patch, duration_s=RECORD_S)
    reduced = model.shot(depth_fraction=depth).force_n
    started = time.process_time()
    for _ in range(WARM_SHOTS):
        model.shot(depth_fraction=depth)
    reduced_s = (time.process_time() - started) / WARM_SHOTS

    forces, unreduced_s = [], 0.0
    for h in steps_s:
        started = time.process_time()
        forces.append(unreduced_force(chain, affine, depth, h))
        unreduced_s = time.process_time() - started
    norm = float(np.linalg.norm(forces[-1]))
    changes = [float(np.linalg.norm(b - a)) / norm for a, b in itertools.pairwise(forces)]
    extrapolated = forces[-1] + (forces[-1] - forces[-2]) / 3.0
    return Comparison(
        size_m=size_m,
        depth_fraction=depth,
        unknowns=len(affine.load),
        steps_s=steps_s,
        reference_changes=tuple(changes),
        observed_order=float(np.log2(changes[-2] / changes[-1])),
        difference_l2=float(np.linalg.norm(reduced - extrapolated)) / norm,
        unreduced_s=unreduced_s,
        reduced_s=reduced_s,
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one depth, coarser steps")
    parser.add_argument("--all", action="store_true", help="five depths of two patches")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()
    if arguments.all:
        cases = [(size_m, depth) for size_m in SIZES_M for depth in (0.0, 0.1, 0.4, 0.8, 0.95)]
    else:
        cases = [(SIZES_M[0], depth) for depth in ((0.4,) if arguments.quick else (0.0, 0.4, 0.8))]
    finest = 1.25e-7 if arguments.quick else 6.25e-8
    rows = []
    for size_m, depth in cases:
        row = compare(size_m, depth, (4.0 * finest, 2.0 * finest, finest))
        rows.append(row)
        if not arguments.json:
            changes = " ".join(f"{change:.1e}" for change in row.reference_changes)
            print(
                f"{1e3 * row.size_m:.1f} mm, depth {row.depth_fraction:.0%}: {row.unknowns} unknowns, "
                f"reference changes {changes} "
                f"(order {row.observed_order:.2f}), reduced differs by {row.difference_l2:.1e} "
                f"(limit {LIMIT:.0e}); "
                f"{row.unreduced_s:.1f} s against {1e3 * row.reduced_s:.2f} ms, ratio {row.time_ratio:.0f}",
                flush=True,
            )
    passed = all(row.difference_l2 <= LIMIT for row in rows)
    if arguments.json:
        fields = ("size_m", "depth_fraction", "unknowns", "steps_s", "reference_changes", "observed_order")
        fields += ("difference_l2", "unreduced_s", "reduced_s", "time_ratio")
        report = {
            "limit": LIMIT,
            "passed": passed,
            "depths": [{f: getattr(r, f) for f in fields} for r in rows],
        }
        print(json.dumps(report))
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
