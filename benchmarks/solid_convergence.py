"""Difference of the solid plate's waveform from finer meshes, and the cost of a cold shot.

    python benchmarks/solid_convergence.py [--depths 0 0.5 0.8] [--quick | --one-basis] [--json]

Each mesh is compared with the finest one: time of flight, amplitude ratio and the waveform (relative L2,
preload taken off). Cold means mesh, reduction and shot with nothing kept, machine code compiled; processor
time is what it takes of one core, wall time what other programs leave of it. --quick leaves the finest mesh
out. --one-basis compares one basis for every depth with the usual mesh of each depth alone, and prints what
the basis costs once and a depth from then on. Takes some minutes.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters, SolidMesh
from simulator.plate.solid.plate import build_solid_plate
from simulator.shot.model import ShotModel
from simulator.shot.pulse_summary import summarise_pulses

RECORD_S = 1.4e-3
MESHES = {
    "coarse": SolidMesh(edge_element=0.2, growth=3.0),
    "usual": SolidMesh(),
    "fine": SolidMesh(degree=5, edge_element=0.025, growth=1.7),
    "finest": SolidMesh(degree=6, edge_element=0.015, growth=1.5),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColdShot:
    """Cold shot."""

    unknowns: int
    processor_s: float
    wall_s: float
    force_n: NDArray[np.float64]
    tof_us: float
    amplitude_ratio: float


def cold_shot(mesh: SolidMesh, depth: float) -> ColdShot:
    """Build, reduce and strike the paper's plate."""
    plate, patch = PlateParameters(model="solid", solid=mesh), CorrosionParameters(depth_fraction=depth)
    started = time.perf_counter(), time.process_time()
    shot = ShotModel(ChainParameters(), plate, patch, duration_s=RECORD_S, cache_folder=None).shot()
    wall_s, processor_s = time.perf_counter() - started[0], time.process_time() - started[1]
    summary = summarise_pulses(shot)
    assert summary.tof_us is not None, "the wave comes back"
    assert summary.amplitude_ratio is not None, "the wave comes back"
    return ColdShot(
        unknowns=len(build_solid_plate(plate, patch).load),
        processor_s=processor_s,
        wall_s=wall_s,
        force_n=shot.force_n - shot.preload_n,
        tof_us=float(summary.tof_us),
        amplitude_ratio=float(summary.amplitude_ratio),
    )


def rows(depths: list[float], names: list[str]) -> Iterator[dict[str, Any]]:
    """Return every mesh at every depth, compared with the last one."""
    plate = PlateParameters(model="rigid_wall")
    ShotModel(ChainParameters(), plate, CorrosionParameters(), duration_s=RECORD_S).shot()  # compiles
    for depth in depths:
        shots = {name: cold_shot(MESHES[name], depth) for name in names}
        best = shots[names[-1]]
        for name, shot in shots.items():
            yield {
                "depth_fraction": depth,
                "mesh": name,
                "unknowns": shot.unknowns,
                "processor_s": shot.processor_s,
                "wall_s": shot.wall_s,
                "tof_us": shot.tof_us,
                "amplitude_ratio": shot.amplitude_ratio,
                "tof_difference_us": shot.tof_us - best.tof_us,
                "amplitude_ratio_difference": shot.amplitude_ratio - best.amplitude_ratio,
                "waveform_l2": float(
                    np.linalg.norm(shot.force_n - best.force_n) / np.linalg.norm(best.force_n)
                ),
            }


def one_basis_rows(depths: list[float]) -> Iterator[dict[str, Any]]:
    """Compare shots from one basis with those of each depth alone."""
    alone = PlateParameters(model="solid")
    both = replace(alone, solid=SolidMesh(one_basis=True))
    models = [
        ShotModel(ChainParameters(), plate, CorrosionParameters(), duration_s=RECORD_S, cache_folder=None)
        for plate in (alone, both)
    ]
    started = time.process_time()
    models[1].shot(depth_fraction=0.01)
    basis_s = time.process_time() - started
    for depth in depths:
        expected = models[0].shot(depth_fraction=depth)
        started = time.process_time()
        found = models[1].shot(depth_fraction=depth)
        shot_s = time.process_time() - started
        difference = np.linalg.norm(found.force_n - expected.force_n)
        one, other = summarise_pulses(found).tof_us, summarise_pulses(expected).tof_us
        assert one is not None, "the wave comes back"
        assert other is not None, "the wave comes back"
        yield {
            "depth_fraction": depth,
            "basis_processor_s": basis_s,
            "depth_and_shot_processor_s": shot_s,
            "tof_difference_us": one - other,
            "waveform_l2": float(difference / np.linalg.norm(expected.force_n - expected.preload_n)),
        }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--depths", type=float, nargs="+", default=[0.0, 0.3, 0.5, 0.8])
    parser.add_argument("--quick", action="store_true", help="without the finest mesh")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--one-basis", action="store_true", help="one basis against each depth alone")
    arguments = parser.parse_args()
    if arguments.one_basis:
        for row in one_basis_rows([depth for depth in arguments.depths if depth > 0.0]):
            print(json.dumps(row), flush=True)
        return 0
    names = list(MESHES)[: -1 if arguments.quick else None]
    found = rows(arguments.depths, names)
    if arguments.json:
        print(json.dumps({"meshes": {name: repr(MESHES[name]) for name in names}, "rows": list(found)}))
        return 0
    print("depth  mesh    unknowns  processor   wall     ToF us     AR     dToF us    dAR      waveform L2")
    for row in found:
        print(
            f"{row['depth_fraction']:5.2f}  {row['mesh']:7s} {row['unknowns']:8d}  "
            f"{row['processor_s']:7.2f} s {row['wall_s']:7.2f} s  {row['tof_us']:8.3f}  "
            f"{row['amplitude_ratio']:.4f}  {row['tof_difference_us']:+8.3f}  "
            f"{row['amplitude_ratio_difference']:+.5f}   {row['waveform_l2']:.1e}",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
