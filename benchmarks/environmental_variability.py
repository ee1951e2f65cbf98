"""Shares of sets above the limits at each level of variability, next to the paper's 80, 92 and 8 %.

    python benchmarks/environmental_variability.py        three seeds a level, some minutes on one core
    python benchmarks/environmental_variability.py --seeds 1 --levels laboratory --hours 150

Runs the demonstration's experiment without recorder and storage (`daq_service.cli.offline.twin_line`). For B
and C it prints the shares of assessed sets after 100 h beyond the F limit and beyond the paper's (mean plus
three SD of the baseline's distances), until the hole; for D those of all judged sets after the baseline; the
paper found 80 and 92 % of the sets after 100 h, and 8 % at D. Then the first alarm by F, 3 of 5, the
baseline's SDs, and the eigenvalues of its correlation. What it gives is what it prints: nothing is fitted.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np

from analysis.waves.features import FEATURE_NAMES
from daq_service.cli.offline.twin_line import simulate_assessed_sets
from daq_service.settings.file import load_settings
from simulator.parameters.environmental_variability import NUISANCE

PAPER_PERCENT = {"B": 80, "C": 92, "D": 8}
AFTER_H = 100.0


def run(level: str, seed: int, position: str, hours: float) -> dict[str, Any]:
    """Assess one transducer; shares in percent, None where no set was assessed."""
    settings = load_settings(
        None, overrides={"twin": {"seed": seed, "nuisance": level}, "schedule": {"end_h": hours}}
    )
    assessments, baseline, first_alarm_h, strikes = {}, [], None, 0
    for assessed in simulate_assessed_sets(settings, position):
        assessments |= {row.set_index: row for row in assessed.position_result.assessments}
        strikes += len(assessed.shots)
        if assessed.due.due_h <= settings.baseline.hours:
            row = assessed.position_result.features[-1]
            baseline.append([getattr(row, name) for name in FEATURE_NAMES])
        if first_alarm_h is None and assessed.raised & {"wall_change", "no_reflection"}:
            first_alarm_h = assessed.due.due_h
    after_h = settings.baseline.hours if position == "D" else AFTER_H
    late = [row for row in assessments.values() if row.due_h > after_h and row.outlier is not None]
    table = np.array(baseline, dtype=np.float64)
    return {
        "level": level,
        "seed": seed,
        "position": position,
        "strikes": strikes,
        "judged": len(late),
        "f_percent": 100.0 * float(np.mean([row.outlier for row in late])) if late else None,
        "paper_percent": 100.0 * float(np.mean([row.outlier_mean_3sd for row in late])) if late else None,
        "first_alarm_h": first_alarm_h,
        "sd_percent": (100.0 * table.std(axis=0, ddof=1) / np.abs(table.mean(axis=0))).tolist(),
        "eigenvalues": np.linalg.eigvalsh(np.corrcoef(table.T))[::-1].tolist(),
    }


def mean_of(rows: Sequence[dict[str, Any]], name: str) -> float:
    """Return the mean over the seeds that have it; NaN where none has."""
    known = [row[name] for row in rows if row[name] is not None]
    return float(np.mean(known)) if known else float("nan")


def show(rows: Sequence[dict[str, Any]]) -> None:
    print(f"{'level':12s}{'':3s}{'F %':>7s}{'paper %':>9s}{'(found)':>9s}  first alarm, h by seed")
    for level in dict.fromkeys(row["level"] for row in rows):
        of_level = [row for row in rows if row["level"] == level]
        for position in sorted({row["position"] for row in of_level}):
            own = [row for row in of_level if row["position"] == position]
            alarms = ", ".join(
                "-" if row["first_alarm_h"] is None else f"{row['first_alarm_h']:g}" for row in own
            )
            shares = f"{mean_of(own, 'f_percent'):7.1f}{mean_of(own, 'paper_percent'):9.1f}"
            print(f"{level:12s}{position:3s}{shares}{PAPER_PERCENT[position]:9d}  {alarms}")
        for name, form in (("sd_percent", "SD %"), ("eigenvalues", "eigenvalues")):
            middle = np.median([row[name] for row in of_level], axis=0)
            print(f"{'':12s}   {form} of the baseline: " + " ".join(f"{value:.3f}" for value in middle))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3, help="how many, from 1 on")
    parser.add_argument("--levels", default=",".join(["none", *NUISANCE]))
    parser.add_argument("--hours", type=float, default=350.0)
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    cases = [
        (level, seed, position, options.hours)
        for level in options.levels.split(",")
        for seed in range(1, options.seeds + 1)
        for position in PAPER_PERCENT
    ]
    with ProcessPoolExecutor(options.workers) as executor:
        rows = list(executor.map(run, *zip(*cases, strict=True)))
    if options.json:
        print(json.dumps({"paper_percent": PAPER_PERCENT, "runs": rows}))
    else:
        show(rows)


if __name__ == "__main__":
    main()
