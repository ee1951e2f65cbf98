"""Time of the paper's method next to ours: adaptive Runge-Kutta on every unknown of chain and plate.

    python benchmarks/paper_method.py [--fraction F] [--json]

The paper integrates its semi-discrete system with MATLAB's ode45. Here that is scipy's RK45, the same
pair of Dormand and Prince: for chain and all unknowns of the 96 x 96 mesh, the mass matrix factored once
(sparse LU), and, to its favour, also for the quarter mesh and for row-sum masses, which need no factor.

1. **Which tolerance.** On a coarser mesh of the same plate the whole record of 1.2 ms is integrated with
   several tolerances. The best one is the loosest whose sensor force is within 1e-4 (relative L2) of the
   tightest. Ours on the same mesh is compared with the tightest, too. The steps per quarter of the record
   show whether stability or accuracy limits the step.
2. **What it costs.** With that tolerance the paper's mesh is integrated from first touch through a stated
   fraction of the record. There the step is limited by stability: printed next to the mean step is the
   largest one with which the pair does not amplify the fastest mode. While the plate is still quiet the
   steps stray above it and some are rejected, so that the extrapolation flatters the paper's method.
   `--fraction 1` runs it to the end (hours).

Absolute tolerances are the relative one times 1e-6 m and 1e-2 m/s, a tenth of what spheres reach.
Times are processor times, so that nothing else on the machine counts. Takes a minute or two.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

# Two threads of a small solve only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import RK45
from scipy.sparse.linalg import splu

from simulator.chain.spheres import Chain, build_chain
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin.plate import AffinePlate, build_plate
from simulator.shot.model import ShotModel

FloatArray = NDArray[np.float64]

RECORD_S = 1.2e-3
SAMPLE_S = 5e-7
LIMIT = 1e-4
TOLERANCES = (1e-3, 1e-5, 1e-6, 1e-7, 1e-8, 1e-10)
COARSE = PlateParameters(elements_per_edge=16, contact_element_m=5e-3)
DISPLACEMENT_M, SPEED_M_PER_S = 1e-6, 1e-2
EVALUATIONS_A_STEP, EVALUATIONS_AT_START = 6, 2
WARM_SHOTS = 100
POWER_STEPS = 60


class System:
    """Chain and unreduced plate as ``dy/dt = f(t, y)``; y holds all displacements, then all speeds.

    Displacements count from the static equilibrium, forces less the static ones.
    """

    def __init__(self, chain: Chain, plate: AffinePlate, depth: float, *, lumped: bool) -> None:
        stiffness, mass = plate.evaluate_at_depth(depth)
        self._chain = chain
        self._bodies = len(chain.mass_kg)
        self._stiffness = stiffness.tocsr()
        self._load = plate.load
        self._contact = self._bodies + int(np.flatnonzero(plate.load)[0])
        if lumped:
            row_sums = np.asarray(mass.sum(axis=1)).ravel()
            self._per_mass: Callable[[FloatArray], FloatArray] = lambda force: force / row_sums
        else:
            self._per_mass = splu(mass).solve
        self.unknowns = self._bodies + len(plate.load)
        self.start = np.zeros(2 * self.unknowns)
        self.start[self.unknowns] = chain.impact_speed_m_per_s

    def fastest_rad_per_s(self) -> float:
        """Return the circular frequency of the plate's fastest mode, by vector iteration."""
        x = np.random.default_rng(1).normal(size=len(self._load))
        for _ in range(POWER_STEPS):
            image = self._per_mass(self._stiffness @ x)
            square = float(np.linalg.norm(image) / np.linalg.norm(x))
            x = image / np.linalg.norm(image)
        return float(np.sqrt(square))

    def rates(self, _: float, y: FloatArray) -> FloatArray:
        """Return the right-hand side."""
        n = self._bodies
        force = self._forces(y)
        above = np.concatenate(([self._chain.mass_kg[0] * self._chain.gravity_m_per_s2], force[:-1]))
        bodies = (above - force) / self._chain.mass_kg
        plate = self._per_mass(self._load * force[-1] - self._stiffness @ y[n : self.unknowns])
        return np.concatenate((y[self.unknowns :], bodies, plate))

    def sensor_force(self, y: FloatArray) -> float:
        """Return the mean of the two contact forces at the sensor, static ones included."""
        faces = slice(self._chain.sensor - 1, self._chain.sensor + 1)
        return float(np.mean((self._forces(y) + self._chain.static_force_n)[faces]))

    def _forces(self, y: FloatArray) -> FloatArray:
        chain, n = self._chain, self._bodies
        u = np.append(y[:n], y[self._contact])
        v = np.append(y[self.unknowns : self.unknowns + n], y[self.unknowns + self._contact])
        overlap = u[:-1] - u[1:] + chain.static_overlap_m
        closed = np.maximum(overlap, 0.0)
        force = chain.stiffness_n_per_m15 * closed * np.sqrt(closed)
        force += np.where(overlap > 0.0, chain.damping_n_s_per_m * (v[:-1] - v[1:]), 0.0)
        return np.asarray(force - chain.static_force_n)

    def tolerances(self, relative: float) -> FloatArray:
        """Return absolute tolerances that go with a relative one."""
        return relative * np.repeat((DISPLACEMENT_M, SPEED_M_PER_S), self.unknowns)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """Integration to `simulated_s`, sampled every `SAMPLE_S`."""

    force_n: FloatArray
    seconds: float
    simulated_s: float
    steps: int
    rejected: int
    steps_by_quarter: tuple[int, ...]

    @property
    def whole_record_s(self) -> float:
        """Return the time for the complete record at this pace."""
        return self.seconds * RECORD_S / self.simulated_s


def integrate(system: System, tolerance: float, until_s: float) -> Run:
    solver = RK45(system.rates, 0.0, system.start, until_s, rtol=tolerance, atol=system.tolerances(tolerance))
    samples = round(until_s / SAMPLE_S) + 1
    force = [system.sensor_force(system.start)]
    quarters = [0, 0, 0, 0]
    started = time.process_time()
    while solver.status == "running":
        failure = solver.step()
        if failure is not None:
            raise RuntimeError(f"RK45 gave up at {solver.t} s: {failure}")
        quarters[min(3, int(4.0 * solver.t / until_s))] += 1
        between = None
        while len(force) < samples and len(force) * SAMPLE_S <= solver.t + 1e-15:
            between = between or solver.dense_output()
            force.append(system.sensor_force(between(len(force) * SAMPLE_S)))
    seconds = time.process_time() - started
    attempts = (solver.nfev - EVALUATIONS_AT_START) // EVALUATIONS_A_STEP
    return Run(
        force_n=np.array(force),
        seconds=seconds,
        simulated_s=until_s,
        steps=sum(quarters),
        rejected=attempts - sum(quarters),
        steps_by_quarter=tuple(quarters),
    )


def stable_phase_rad() -> float:
    """Return the largest omega h at which RK45 does not amplify an oscillation: |R(i omega h)| <= 1."""
    stages = len(RK45.B)
    explicit = np.pad(RK45.A, ((0, 0), (0, stages - RK45.A.shape[1])))
    phases = np.linspace(0.5, 3.0, 2501)
    growth = []
    for phase in phases:
        values = np.linalg.solve(np.eye(stages) - 1j * phase * explicit, np.ones(stages))
        growth.append(abs(1.0 + 1j * phase * (RK45.B @ values)))
    return float(phases[np.argmax(np.array(growth) > 1.0 + 1e-12)])


def l2(found: FloatArray, expected: FloatArray) -> float:
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def find_tolerance(depth: float, say: Callable[[str], None]) -> tuple[float, list[dict[str, object]]]:
    """Return the best tolerance on the coarse mesh, and the results of every one."""
    chain = build_chain(ChainParameters(), COARSE)
    system = System(chain, build_plate(COARSE, CorrosionParameters()), depth, lumped=False)
    ours = ShotModel(ChainParameters(), COARSE, CorrosionParameters(), duration_s=RECORD_S)
    runs = {tolerance: integrate(system, tolerance, RECORD_S) for tolerance in TOLERANCES}
    exact = runs[min(TOLERANCES)].force_n
    shot = ours.shot(depth_fraction=depth)
    every = round(SAMPLE_S / (shot.time_s[1] - shot.time_s[0]))
    ours_l2 = l2(shot.force_n[::every], exact)
    say(f"coarse mesh, {system.unknowns} unknowns, the whole record; ours differs by {ours_l2:.1e} (L2)")
    rows: list[dict[str, object]] = [{"ours_l2": ours_l2}]
    for tolerance, run in runs.items():
        error = l2(run.force_n, exact)
        rows.append({"tolerance": tolerance, "l2": error, "steps": run.steps, "rejected": run.rejected})
        say(
            f"  RK45 at {tolerance:.0e}: L2 {error:.1e}, {run.steps} steps, by quarter of the record "
            f"{run.steps_by_quarter}, {run.rejected} rejected, {run.seconds:.1f} s"
        )
    row_sum = System(chain, build_plate(COARSE, CorrosionParameters()), depth, lumped=True)
    changed = l2(integrate(row_sum, 1e-6, RECORD_S).force_n, exact)
    rows.append({"row_sum_l2": changed})
    say(f"  row-sum masses change the force by {changed:.1e} (L2)")
    good = [t for t, run in runs.items() if l2(run.force_n, exact) <= LIMIT]
    return max(good), rows


def our_seconds(depth: float, fraction: float) -> tuple[float, FloatArray]:
    """Return the median of a warm shot on the paper's mesh, and its force over the fraction."""
    model = ShotModel(ChainParameters(), PlateParameters(), CorrosionParameters(), duration_s=RECORD_S)
    shot = model.shot(depth_fraction=depth)
    times = []
    for _ in range(WARM_SHOTS):
        started = time.process_time()
        model.shot(depth_fraction=depth)
        times.append(time.process_time() - started)
    every = round(SAMPLE_S / (shot.time_s[1] - shot.time_s[0]))
    return statistics.median(times), shot.force_n[::every][: round(fraction * RECORD_S / SAMPLE_S) + 1]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fraction", type=float, default=2.5e-3, help="part of the record on the full mesh")
    parser.add_argument("--depth", type=float, default=0.4, help="depth of the patch")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()

    def say(line: str) -> None:
        if not arguments.json:
            print(line, flush=True)

    tolerance, coarse = find_tolerance(arguments.depth, say)
    say(f"best tolerance: {tolerance:.0e}")
    plate, patch = PlateParameters(), CorrosionParameters()
    chain = build_chain(ChainParameters(), plate)
    rows = []
    for name, whole, lumped, share in (
        ("full mesh, consistent mass", True, False, 1.0),
        ("full mesh, row-sum mass", True, True, 2.0),
        ("quarter mesh, consistent mass", False, False, 4.0),
        ("quarter mesh, row-sum mass", False, True, 8.0),
    ):
        fraction = min(1.0, share * arguments.fraction)
        ours_s, ours_n = our_seconds(arguments.depth, fraction)
        system = System(chain, build_plate(plate, patch, whole=whole), arguments.depth, lumped=lumped)
        run = integrate(system, tolerance, round(fraction * RECORD_S / SAMPLE_S) * SAMPLE_S)
        difference = l2(run.force_n, ours_n[: len(run.force_n)])
        stable_s = stable_phase_rad() / system.fastest_rad_per_s()
        rows.append(
            {
                "name": name,
                "unknowns": system.unknowns,
                "fraction": run.simulated_s / RECORD_S,
                "steps": run.steps,
                "rejected": run.rejected,
                "stable_step_s": stable_s,
                "seconds": run.seconds,
                "whole_record_s": run.whole_record_s,
                "ours_s": ours_s,
                "ratio": run.whole_record_s / ours_s,
                "difference_l2": difference,
            }
        )
        say(
            f"{name}: {system.unknowns} unknowns, {run.simulated_s / RECORD_S:.2%} of the record in "
            f"{run.steps} steps of {1e9 * run.simulated_s / run.steps:.1f} ns (stable up to "
            f"{1e9 * stable_s:.1f} ns), {run.rejected} rejected, {run.seconds:.1f} s: "
            f"{run.whole_record_s / 3600:.2f} h for all of it; ours {1e3 * ours_s:.2f} ms, "
            f"ratio {run.whole_record_s / ours_s:,.0f}; so far they differ by {difference:.1e} (L2)"
        )
    if arguments.json:
        print(json.dumps({"tolerance": tolerance, "coarse": coarse, "runs": rows}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
