"""Coverage of the wall thickness that the recorder estimates, over data folders of demos with other seeds.

    solimon demo --exit --no-web --seed 2 --data-dir seed-2      for each seed
    python benchmarks/wall_over_seeds.py seed-*                  [--json]

Prints by position the part of the 90 % intervals that hold the twin's loss since the mean of the baseline,
and the median of the first loss whose interval excludes the sound wall. The current is on from hour 0.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import numpy as np

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.rows import AssessmentRow, WallRow
from daq_service.cli.offline.pod.runs import compute_losses
from daq_service.settings.stored import restore_settings

WHOLE_M = 1e-6
"""An interval whose upper end is that much below the sound wall excludes it."""


def judge_position(folder: Path, position: str) -> tuple[list[bool], float]:
    """Return which intervals hold the truth, and the first loss in mm that is seen; NaN: none."""
    with open_catalogue(folder) as catalogue:
        settings = restore_settings(catalogue.read_experiment().configuration)
        rows = [row for row in catalogue.rows(WallRow, position=position) if row.interval_high_m is not None]
        baseline_h = [
            row.due_h for row in catalogue.rows(AssessmentRow, position=position) if row.in_baseline
        ]
    sound_m = settings.positions[position].plate.thickness_m
    loss_m = compute_losses(settings, position, [row.due_h for row in rows], baseline_h).tolist()
    pairs = list(zip(rows, loss_m, strict=True))
    holds = [
        (row.interval_low_m or 0.0) <= sound_m - loss <= (row.interval_high_m or 0.0) + 1e-12
        for row, loss in pairs
    ]
    seen = (1e3 * loss for row, loss in pairs if (row.interval_high_m or 0.0) < sound_m - WHOLE_M)
    return holds, next(seen, float("nan"))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--positions", nargs="+", default=["B", "C", "D"])
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    found = {}
    for position in given.positions:
        judged = [judge_position(folder, position) for folder in given.folders]
        holds = [one for of_folder, _ in judged for one in of_folder]
        seen_mm = np.array([first for _, first in judged if math.isfinite(first)])
        found[position] = {
            "intervals": len(holds),
            "covered_percent": round(100.0 * float(np.mean(holds)), 1),
            "seen_in_tests": seen_mm.size,
            "first_seen_loss_mm": round(float(np.median(seen_mm)), 2) if seen_mm.size else None,
        }
    if given.json:
        print(json.dumps(found))
        return
    for position, one in found.items():
        print(f"{position}: {one}")


if __name__ == "__main__":
    main()
