"""Cost of the twin from shot to assessment without recorder and storage, and of a shot with variability.

    python benchmarks/twin_line.py                 three transducers for 350 h: 12,750 strikes, less a hole's
    python benchmarks/twin_line.py --hours 50 --demo

Processor seconds of one process, imports, machine code and reduced plates left out: the whole run at
``laboratory``; then a shot (physics, trigger, counts) at each level over one without nuisance, the same
strikes by turns, the median of the ratios. ``--demo`` runs the demonstration's line, recorder and storage and
the twin's process, for as many hours next to it (`demo_speed.py`) and prints the ratio. Fails (exit code 1)
above 1.15 times a shot without.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

# Small dense problems: BLAS threads only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from daq_service.cli.offline.twin_line import build_twin, simulate_assessed_sets
from daq_service.rig.twin import build_transducers
from daq_service.settings.file import load_settings
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import ShotKey
from simulator.parameters.environmental_variability import NUISANCE
from simulator.specimen import build_specimen

sys.path.insert(0, str(Path(__file__).parent))

POSITIONS = "BCD"
TURNS, SETS, SHOTS = 9, 12, 10
LIMIT = 1.15
"""Seats, contacts of each shot and what else is heard cost some 70 us next to .6 ms of the physics."""


def cpu_seconds(work: Callable[[], object]) -> float:
    started = time.process_time()
    work()
    return time.process_time() - started


def settings_of(level: str, hours: float) -> Settings:
    return load_settings(None, overrides={"twin": {"nuisance": level}, "schedule": {"end_h": hours}})


def run_line(hours: float) -> tuple[float, int]:
    """Return seconds and strikes of the complete test."""
    warm = settings_of("laboratory", 1.0)
    specimen = build_twin(warm)
    for position in POSITIONS:
        list(simulate_assessed_sets(warm, position, specimen))
    settings, strikes = settings_of("laboratory", hours), 0

    def work() -> None:
        nonlocal strikes
        for position in POSITIONS:
            strikes += sum(
                len(assessed.shots) for assessed in simulate_assessed_sets(settings, position, specimen)
            )

    return cpu_seconds(work), strikes


def ratios() -> dict[str, float]:
    """Return the cost of a shot at each level over that of one without variability, at the corroding B."""
    # The same plates for all: where their arrays lie in memory is worth a tenth.
    transducers = build_transducers(settings_of("none", 350.0))
    specimens = {
        level: build_specimen(settings_of(level, 350.0).twin, transducers=transducers, probed_thickness_m={})
        for level in ("none", *NUISANCE)
    }

    def sets(level: str, turn: int) -> None:
        # Each level half a minute apart: none finds the plate's modes at a depth ready from another's turn.
        later_h = list(specimens).index(level) / 120.0
        for index in range(SETS * turn, SETS * turn + SETS):
            keys = [ShotKey(position="B", set_index=index, shot_index=k) for k in range(SHOTS)]
            specimens[level].simulate_waves([(key, 0.5 * index + later_h) for key in keys])

    for level in specimens:
        sets(level, TURNS)
    seconds: dict[str, list[float]] = {level: [] for level in specimens}
    for turn in range(TURNS):
        for level in list(specimens)[:: 1 if turn % 2 else -1]:
            seconds[level].append(cpu_seconds(partial(sets, level, turn)))
    return {
        level: statistics.median(a / b for a, b in zip(seconds[level], seconds["none"], strict=True))
        for level in NUISANCE
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=350.0)
    parser.add_argument("--demo", action="store_true", help="also the demonstration's line")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    line_s, strikes = run_line(options.hours)
    report: dict[str, Any] = {"line_s": line_s, "strikes": strikes, "ratios": ratios()}
    if options.demo:
        from demo_speed import RECORDER, run_in_a_process

        report["demo_s"] = run_in_a_process(RECORDER, options.hours)["processor_s"]
    passed = max(report["ratios"].values()) <= LIMIT
    if options.json:
        print(json.dumps({**report, "passed": passed}))
        return 0 if passed else 1
    print(
        f"shots to assessments: {line_s:.2f} s of processor for {strikes} strikes, "
        f"{1e3 * line_s / strikes:.3f} ms each"
    )
    for level, ratio in report["ratios"].items():
        print(f"a shot at {level}: {ratio:.3f} of one without nuisance")
    if options.demo:
        ratio = report["demo_s"] / line_s
        print(
            f"the demonstration's line with its twin's process: {report['demo_s']:.2f} s, "
            f"{ratio:.2f} times it"
        )
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
