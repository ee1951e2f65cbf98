"""Scatter of healthy sets, record of a hole, and cost of a simulated shot.

Run ``python benchmarks/baseline_scatter.py [--sets N] [--seed S]``. A set is the mean of ten shots;
each standard deviation is printed with its sampling error, SD / sqrt(2 (sets - 1)). The incident
amplitude is in volts, so it scatters with the force and with the sensor's gain.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from analysis.waves.features import average_features, extract_features
from hardware_drivers.measurement import ShotKey
from simulator.parameters.chain import ChainParameters
from simulator.parameters.experiment import PAPER_THINNING, DriftParameters, ScatterParameters, TwinParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import ShotModel
from simulator.shot.pulse_summary import summarise_pulses
from simulator.specimen import Specimen, Transducer, build_specimen

NAMES = ("tof_pp_s", "amplitude_ratio", "isw_amplitude_v")
PATCH_M = {"B": 25.4e-3, "C": 50.8e-3}
CHAIN = ChainParameters()


def specimen(model: ShotModel, scale: float, seed: int) -> Specimen:
    twin = TwinParameters(seed=seed, drift=DriftParameters(enabled=False))
    twin = replace(twin, scatter=ScatterParameters(scale=scale))
    return build_specimen(
        twin, transducers={"D": Transducer(chain=CHAIN, model=model)}, probed_thickness_m={}
    )


def print_scatter(model: ShotModel, scale: float, sets: int, seed: int) -> None:
    healthy = specimen(model, scale, seed)
    means, seconds, flagged, missed = [], 0.0, 0, 0
    for set_index in range(sets):
        features = []
        for shot_index in range(10):
            key = ShotKey(position="D", set_index=set_index, shot_index=shot_index)
            start = time.perf_counter()
            acquired = healthy.simulate_wave(key, 0.0)
            seconds += time.perf_counter() - start
            if acquired is None:
                missed += 1
                continue
            features.append(extract_features(acquired.waveform))
            flagged += bool(features[-1].flags)
        means.append([average_features(features).mean[name] for name in NAMES])
    table = np.array(means)
    table = table[np.isfinite(table).all(axis=1)]
    sd = 100.0 * table.std(axis=0, ddof=1) / table.mean(axis=0)
    error = sd / np.sqrt(2.0 * (len(table) - 1))
    parts = [f"{name} {s:.2f} +- {e:.2f} %" for name, s, e in zip(NAMES, sd, error, strict=True)]
    print(f"scatter x {scale:g}: " + ", ".join(parts), end="; ")
    shots = 10 * sets
    print(f"{flagged} of {shots} shots flagged, {missed} missed, {1e3 * seconds / shots:.2f} ms a shot")


def print_hole(position: str) -> None:
    model = ShotModel(CHAIN, PlateParameters(), CorrosionParameters(size_m=PATCH_M[position]))
    thinning = PAPER_THINNING[position]
    pristine, last = (summarise_pulses(model.shot(depth_fraction=d)) for d in (0.0, thinning.depth_fraction))
    if pristine.tof_us is None or last.tof_us is None:
        raise SystemExit(f"no reflected wave at {position} before its hole")
    change = 100.0 * (last.tof_us / pristine.tof_us - 1.0)
    print(
        f"{position}: hole at {thinning.hole_h} h, mean depth {thinning.depth_fraction:.2f}; "
        f"ToF {pristine.tof_us:.1f} -> {last.tof_us:.1f} us ({change:+.1f} %), "
        f"AR {pristine.amplitude_ratio:.3f} -> {last.amplitude_ratio:.3f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sets", type=int, default=400, help="healthy sets at each scale")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    model = ShotModel(CHAIN, PlateParameters(), CorrosionParameters())
    model.shot()  # compiles the kernels, which is not the cost of a shot
    for scale in (0.0, 1.0, 2.0, 4.0):
        print_scatter(model, scale, arguments.sets, arguments.seed)
    for position in PATCH_M:
        print_hole(position)


if __name__ == "__main__":
    main()
