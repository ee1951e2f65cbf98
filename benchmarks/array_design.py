"""What arrays of spheres know about the wall, the law for their choice, and the best array in simulated sets.

    python benchmarks/array_design.py                    some five minutes on one core
    python benchmarks/array_design.py --part arrays      or law, thickness, best

``arrays``: d' of a set of ten at a loss of 5 and 10 % of the wall, by Fisher information and from simulated
sets, for one change of the paper's array at a time. ``law``: error of `predict_ratio_slope` against the twin,
and the inelasticity at which d' is largest, on plates of 3, 6.35 and 10 mm and for patches of three sizes.
``thickness``: SD of the loss from one set for spheres of 3 and 4 plate thicknesses. ``best``: the best array
of `solimon design` over the paper's, with seeds that nothing else uses.
"""

from __future__ import annotations

import argparse
import math
import os
from dataclasses import replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq_service.cli.offline.design.candidates import list_chains, make_chain
from daq_service.cli.offline.design.command import compute_losses_m, load_site
from daq_service.cli.offline.design.information import (
    Design,
    Site,
    confirm_design,
    predict_design,
    simulate_design,
)
from simulator.errors import SimulatorError
from simulator.parameters.chain import ChainParameters
from simulator.shot.pulse_summary import summarise_pulses

ARRAYS = (
    ["material=steel", "diameter_m=12.7e-3,25.4e-3,32e-3"],
    ["material=tungsten carbide,aluminium,ptfe"],
    ["material=titanium", "diameter_m=25.4e-3"],
    ["drop_height_m=2.5e-3,20e-3"],
    ["precompression_n=20,50"],
    ["material=steel", "diameter_m=25.4e-3", "precompression_n=20,50,100"],
    ["spheres_below=3,6,8"],
    ["spheres_above=3,6"],
    ["damping_n_s_per_m=2.25,9"],
    ["contact_damping_n_s_per_m=17,68"],
)
SOLID_METALS = ("steel", "tungsten carbide", "titanium", "aluminium")
DIAMETERS_M = np.geomspace(5e-3, 40e-3, 10).tolist()
SLOPE_DEPTH = 0.05
LEAST_RATIO, LARGEST_INELASTICITY = 0.2, 0.7


def found(site: Site, name: str, chain: ChainParameters, seeds: range | None = None) -> Design:
    """Simulate an array, also one outside the limits, and confirm it if there are seeds."""
    design = simulate_design(site, predict_design(site, name, chain))
    return design if seeds is None or math.isnan(design.distances[0]) else confirm_design(site, design, seeds)


def show_arrays(seeds: range) -> None:
    site = load_site(None, "B", level="laboratory")
    paper = site.settings.positions["B"].chain
    chains = {"paper": paper}
    for sweeps in ARRAYS:
        chains |= list_chains(paper, sweeps)
    print(f"{'d-prime at 5, 10 %':42s}    GPa lambda   AR   information        sets   SD, mm  detectable, mm")
    for name, chain in chains.items():
        one = found(site, name, chain, seeds)
        numbers = (1e-9 * one.pressure_pa, one.inelasticity, one.amplitude_ratio, *one.distances[:2])
        sets = one.confirmed or (math.nan, math.nan)
        text = "{:6.2f}{:6.2f}{:6.2f}{:7.2f}{:6.2f}{:7.2f}{:6.2f}".format(*numbers, *sets)
        losses = "{:8.2f}{:8.2f}".format(*(1e3 * loss for loss in compute_losses_m(site, one)))
        print(f"{name:42s} {text}{losses}  {'; '.join(one.refused)}", flush=True)


def simulate_slope(site: Site, chain: ChainParameters) -> float:
    """Return the twin's change of ln AR by the loss, as a fraction of the wall; NaN outside the limits."""
    model, ratios = site.model.with_chain(chain), []
    for depth in (0.0, SLOPE_DEPTH):
        try:
            ratios.append(
                summarise_pulses(model.shot(depth_fraction=depth)).dynamic_amplitude_ratio or math.nan
            )
        except SimulatorError:
            return math.nan
    return math.log(ratios[1] / ratios[0]) / SLOPE_DEPTH if ratios[0] >= LEAST_RATIO else math.nan


def show_law() -> None:
    for thickness_m in (3e-3, 6.35e-3, 10e-3):
        for patch_m in (15e-3, 25.4e-3, 50.8e-3):
            site = load_site(None, "B", thickness_m=thickness_m, patch_m=patch_m, level="laboratory")
            paper, errors = site.settings.positions["B"].chain, []
            best: dict[str, tuple[float, float, float]] = {}
            for material in SOLID_METALS:
                for diameter_m in DIAMETERS_M:
                    design = predict_design(
                        site, "", make_chain(paper, material=material, diameter_m=diameter_m)
                    )
                    if not design.inelasticity <= LARGEST_INELASTICITY:
                        continue
                    slope = simulate_slope(site, design.chain)
                    if math.isnan(slope):
                        continue
                    errors.append(design.predicted_slope / slope - 1.0)
                    distance = simulate_design(site, design).distances[0]
                    mine = distance, design.inelasticity, diameter_m / thickness_m
                    best[material] = max(best.get(material, (0.0, 0.0, 0.0)), mine)
            print(
                f"plate {1e3 * thickness_m:5.2f} mm, patch {1e3 * patch_m:4.1f} mm: {len(errors)} arrays, "
                f"median error of the law {100 * np.median(np.abs(errors)):.0f} %, mean "
                f"{100 * np.mean(errors):+.0f} %"
            )
            listed = (f"{name} {lam:.2f} ({ratio:.1f} h)" for name, (_, lam, ratio) in best.items())
            print(f"    lambda (diameter) of the largest d-prime: {', '.join(listed)}", flush=True)


def show_thickness() -> None:
    print("SD of the loss from one set at a loss of 10 %, patch 25.4 mm")
    for thickness_m in (3e-3, 6.35e-3, 10e-3, 15e-3, 25e-3):
        site = load_site(None, "B", thickness_m=thickness_m, level="laboratory")
        paper = site.settings.positions["B"].chain
        cells = []
        for diameter_m in [*(ratio * thickness_m for ratio in (2.0, 3.0, 4.0)), 19.05e-3, 40e-3]:
            if diameter_m > 40e-3:
                continue
            one = found(site, "", make_chain(paper, material="steel", diameter_m=diameter_m))
            sd_m, _ = compute_losses_m(site, one)
            cells.append(
                f"{1e3 * diameter_m:.1f} mm: {1e3 * sd_m:.2f} mm{' (refused)' if one.refused else ''}"
            )
        print(f"    wall {1e3 * thickness_m:5.2f} mm, steel spheres of {', '.join(cells)}", flush=True)


def show_best(seeds: range) -> None:
    site = load_site(None, "B", level="laboratory")
    paper = site.settings.positions["B"].chain
    first = found(site, "paper", paper, seeds)
    best = first
    for name, chain in list_chains(paper, []).items():
        one = predict_design(site, name, chain)
        if not one.refused:
            one = simulate_design(site, one, first.pressure_pa)
        if not one.refused and one.yield_ratio <= 1.0 and one.distances[1] > best.distances[1]:
            best = one
    best = confirm_design(site, replace(best, confirmed=None), seeds)
    for one in (first, best):
        print(f"{one.name}: {1e-9 * one.pressure_pa:.2f} GPa, d' {one.distances[:2]}, sets {one.confirmed}")
    ratio = np.divide(best.confirmed or math.nan, first.confirmed or math.nan)
    print(f"sets of seeds {seeds[0]} to {seeds[-1]}: {ratio[0]:.2f} and {ratio[1]:.2f} times the paper's d'")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", choices=("arrays", "law", "thickness", "best"))
    parser.add_argument("--seeds", type=int, default=3, help="of each confirmation")
    options = parser.parse_args()
    parts = {
        "arrays": lambda: show_arrays(range(1, 1 + options.seeds)),
        "law": show_law,
        "thickness": show_thickness,
        "best": lambda: show_best(range(101, 101 + 2 * options.seeds)),
    }
    for name, show in parts.items():
        if options.part in (None, name):
            show()


if __name__ == "__main__":
    main()
