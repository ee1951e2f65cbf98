"""Slopes of a set's features for each cause, and the shipped bank of wall curves.

    python benchmarks/diagnosis_slopes.py              prints the tables of `analysis/diagnosis/slopes.toml`
    python benchmarks/diagnosis_slopes.py --json
    python benchmarks/diagnosis_slopes.py --bank FILE  writes a bank for the paper's chain and plate

Noise-free shots of the paper's chain (disk sensor) on its dry Mindlin plate, through the extractor of the
recorder. A slope is the change of a feature's logarithm by one unit of the source, from a small step to both
sides; a wall's row is the whole change at that depth. The assessment is tried on other models
(`benchmarks/diagnoses.py`). The bank of solimon itself is `daq_service/assessment/wall_bank.npz`; it takes
some 6 minutes of CPU.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

from analysis.diagnosis.slopes import COMPONENTS, DEPTHS
from analysis.wall.bank import save_bank
from daq_service.assessment.wall_bank import (
    MEAN_TILT_RAD,
    NoiseFreeRecorder,
    build_bank,
    compute_source_slopes,
    list_members,
)
from simulator.numerics.arrays import FloatArray
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import Impact, ShotModel

RECORDER = NoiseFreeRecorder(names=COMPONENTS)
PATCHES_M = {"B": 25.4e-3, "C": 50.8e-3}


def walls(
    chain: ChainParameters, plate: PlateParameters, size_m: float, recorder: NoiseFreeRecorder = RECORDER
) -> FloatArray:
    """Return the change of the recorder's logarithms at each of `DEPTHS`, shape (len(DEPTHS), 7)."""
    model = ShotModel(chain, plate, CorrosionParameters(size_m=size_m))
    depths = [0.0, *DEPTHS]
    shots = model.shots([Impact(depth_fraction=depth, tilt_rad=MEAN_TILT_RAD) for depth in depths])
    logs = np.array([recorder.log_features(force) for force in shots])
    return np.asarray(logs[1:] - logs[0])


def write_bank(chain: ChainParameters, plate: PlateParameters, file: Path) -> None:
    """Build and write a bank; print progress, then the members, seconds of CPU by kind, and the size."""
    kinds = [member.kind for member in list_members(plate)]
    started_s: list[float] = []

    def show(done: int, total: int, name: str) -> None:
        """Print the member that comes next, and note when it starts."""
        started_s.append(time.process_time())
        print(f"{done} of {total}: {name}", file=sys.stderr)

    save_bank(build_bank(chain, plate, progress=show), file)
    started_s.append(time.process_time())
    cpu_s = dict.fromkeys(kinds, 0.0)
    for kind, took_s in zip(kinds, np.diff(started_s), strict=True):
        cpu_s[kind] += float(took_s)
    for kind, count in Counter(kinds).items():
        print(f"{kind:>12}: {count:3d} members, {cpu_s[kind]:6.1f} s of CPU")
    print(f"{len(kinds)} members, {sum(cpu_s.values()):.0f} s of CPU, {file.stat().st_size} bytes")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--bank", type=Path, metavar="FILE", help="write a bank of wall curves instead")
    options = parser.parse_args()
    chain, plate = ChainParameters(), PlateParameters()
    if options.bank:
        write_bank(chain, plate, options.bank)
        return
    of_sources = compute_source_slopes(chain, plate, RECORDER)
    of_walls = {name: walls(chain, plate, size_m) for name, size_m in PATCHES_M.items()}
    if options.json:
        source_slopes = {name: row.tolist() for name, row in of_sources.items()}
        print(json.dumps({"slopes": source_slopes, "walls": {k: v.tolist() for k, v in of_walls.items()}}))
        return
    for name, row in of_sources.items():
        print(f"{name!r:>16}: [" + ", ".join(f"{value:.4g}" for value in row) + "],")
    for name, rows in of_walls.items():
        print(f"wall {name}")
        for depth, row in zip(DEPTHS, rows, strict=True):
            print(f"{depth:>16}: [" + ", ".join(f"{value:.5f}" for value in row) + "],")


if __name__ == "__main__":
    main()
