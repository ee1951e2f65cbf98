"""Valid and flagged shots of chains of other spheres, by diameter and material.

    python benchmarks/any_chain.py [--full] [--records N] [--snr-db DB] [--pink] [--precompression-n N]
        [--usual]

Waves are the twin's on a steel plate, whole and thinned by up to 45 %, of pressed chains by up to 60 %, in
records of 10 MHz whose length goes with the wave's width; windows and limits follow from the chain
(`analysis.waves.transducer`). A chain whose clean shots are flagged is refused, as by `solimon design`.
Faults are those of `flags_on_waves.py`, each record the tenth of a set of one wall. A row shows valid clean
shots, and shots with a fault that are not valid, the worst fault first, all in percent; or why the design is
refused. The default run takes half a minute; ``--full`` all diameters from 6 to 40 mm, four materials, two
plates and all faults. ``--usual``: windows of the paper's chain for all.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import flags_on_waves as waves
import numpy as np

from analysis.waves.features import ShotFeatures, extract_from_volts
from analysis.waves.record_reduction import ExtractionSettings
from analysis.waves.template import compare_with_others, learn_template
from analysis.waves.transducer import ChainDescription, find_obstacles, settings_of_chain
from daq_service.acquisition.shot_features import describe_chain
from daq_service.cli.offline.design.candidates import make_chain
from daq_service.cli.offline.design.information import FEWEST_VALID, find_flagged
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import ShotModel
from simulator.shot.pulse_summary import summarise_pulses
from simulator.zener.model import compute_reflection

MATERIALS = ("steel", "tungsten carbide", "titanium", "aluminium")
DIAMETERS_M = (6e-3, 9.525e-3, 12.7e-3, 19.05e-3, 25.4e-3, 32e-3, 40e-3)
DEPTHS, DEPTHS_OF_PRESSED = (0.0, 0.15, 0.3, 0.45), (0.0, 0.2, 0.4, 0.6)
FAULTS = (waves.hole, waves.weak, waves.saturated, waves.second_strike, waves.knock, waves.lost_and_zero)
OTHERS, OF_A_SET = 9, 5
SNR_DB, CHECKED = 40.0, 40
EARLIEST_ISW_S = 35e-6


@dataclass(frozen=True, kw_only=True)
class Design:
    """A chain on a plate, what the extractor is given for it, and its waves."""

    chain: ChainParameters
    settings: ExtractionSettings
    obstacles: list[str]
    time_s: waves.FloatArray
    walls: list[tuple[waves.Wave, waves.Wave, float]]


def chain_of(diameter_m: float, material: str, **changes: float) -> ChainParameters:
    return make_chain(ChainParameters(), material=material, diameter_m=diameter_m, **changes)


def plate_model(thickness_m: float) -> ShotModel:
    plate = PlateParameters(thickness_m=thickness_m)  # a coarser mesh brings late waves of its own
    return ShotModel(ChainParameters(), plate, CorrosionParameters(size_m=25.4e-3), cache_folder=None)


def design_of(model: ShotModel, thickness_m: float, chain: ChainParameters, *, usual: bool = False) -> Design:
    plate = PlateParameters(thickness_m=thickness_m)
    description = describe_chain(chain)
    settings = settings_of_chain(description)
    stretch = settings.stretch
    longer_s = max(0.0, description.tof_widths - ChainDescription().tof_widths) * settings.isw_fwhm_s
    pretrigger = round(waves.PRETRIGGER * stretch)
    n = round(waves.SAMPLES * (max(1.0, stretch) if usual else stretch) + 2.0 * longer_s * waves.RATE_HZ)
    own = model.with_chain(chain)
    gone = own.shot(through_hole=True)
    ends_s = gone.time_s[-1] - gone.time_s[gone.force_n.argmax()] + EARLIEST_ISW_S * stretch
    n = min(n, pretrigger + math.floor(ends_s * waves.RATE_HZ))
    time_s = (np.arange(n) - pretrigger) / waves.RATE_HZ
    zener = compute_reflection(replace(chain, precompression_n=0.0), plate)
    summary = summarise_pulses(own.shot())
    obstacles = find_obstacles(
        description,
        settings,
        inelasticity=zener.inelasticity,
        amplitude_ratio=summary.dynamic_amplitude_ratio or 0.0,
        after_trigger_s=float(time_s[-1]),
    )
    silent = waves.sampled(gone.time_s, gone.force_n - gone.preload_n, time_s)
    walls = []
    for depth in () if obstacles else DEPTHS_OF_PRESSED if chain.precompression_n else DEPTHS:
        force = own.shot(depth_fraction=depth)
        wave = waves.sampled(force.time_s, force.force_n - force.preload_n, time_s)
        walls.append((wave, silent, 1e-6 * (summarise_pulses(force).tof_us or math.nan)))
    given = ExtractionSettings() if usual else settings
    design = Design(chain=chain, settings=given, obstacles=obstacles, time_s=time_s, walls=walls)
    if not usual and not obstacles:
        clean = list(shots_of(design, waves.Scene.clean, SNR_DB, CHECKED))
        flags = [shot.flags for shot in clean if not shot.valid]
        obstacles += find_flagged(flags, CHECKED, FEWEST_VALID)
    return design


def shots_of(
    design: Design,
    case: Callable[[waves.Scene], waves.FloatArray],
    snr_db: float,
    n: int,
    *,
    pink: bool = False,
) -> Iterator[ShotFeatures]:
    """Yield shots, each compared with nine clean ones of its wall."""
    random = np.random.default_rng([n, round(snr_db)])
    stretch = settings_of_chain(describe_chain(design.chain)).stretch

    def record(
        wall: tuple[waves.Wave, waves.Wave, float], of: Callable[..., waves.FloatArray]
    ) -> ShotFeatures:
        scene = waves.Scene(
            random=random,
            isw_s=stretch * random.uniform(EARLIEST_ISW_S, 55e-6),
            height=random.normal(1.0, 0.05),
            wave=wall[0],
            silent=wall[1],
            tof_s=wall[2],
            noise=10.0 ** (-snr_db / 20.0),
            pink=pink,
            time_s=design.time_s,
            stretch=stretch,
        )
        pretrigger = -round(design.time_s[0] * waves.RATE_HZ)
        return extract_from_volts(of(scene), waves.RATE_HZ, pretrigger, settings=design.settings)

    for k in range(0, n, OF_A_SET):
        wall = design.walls[k // OF_A_SET % len(design.walls)]
        others = [record(wall, waves.Scene.clean) for _ in range(OTHERS)]
        for _ in range(OF_A_SET):
            seen = [*others, record(wall, case)]
            yield compare_with_others(seen, learn_template(seen))[-1]


def invalid_share(shots: Iterator[ShotFeatures]) -> float:
    return float(np.mean([not shot.valid for shot in shots]))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--full", action="store_true", help="the whole grid")
    parser.add_argument("--records", type=int, default=60, help="of each design and case")
    parser.add_argument("--snr-db", type=float, default=SNR_DB)
    parser.add_argument("--pink", action="store_true", help="noise as 1/f instead of white")
    parser.add_argument("--precompression-n", type=float, default=0.0)
    parser.add_argument("--usual", action="store_true", help="windows of the paper's chain")
    arguments = parser.parse_args()
    faults = [case for case in waves.CASES if case is not waves.Scene.clean] if arguments.full else FAULTS
    for thickness_m in (6.35e-3, 15e-3) if arguments.full else (6.35e-3,):
        model = plate_model(thickness_m)
        for material in MATERIALS if arguments.full else ("steel", "aluminium"):
            for diameter_m in DIAMETERS_M if arguments.full else DIAMETERS_M[::2]:
                chain = chain_of(diameter_m, material, precompression_n=arguments.precompression_n)
                design = design_of(model, thickness_m, chain, usual=arguments.usual)
                name = f"{1e3 * thickness_m:5.2f} mm plate, {1e3 * diameter_m:5.2f} mm {material:16s}"
                if design.obstacles:
                    print(f"{name} refused: {'; '.join(design.obstacles)}", flush=True)
                    continue

                def share(case: Callable[[waves.Scene], waves.FloatArray], design: Design = design) -> float:
                    return 100.0 * invalid_share(
                        shots_of(design, case, arguments.snr_db, arguments.records, pink=arguments.pink)
                    )

                found = sorted((share(case), case.__name__) for case in faults)
                listed = ", ".join(f"{case} {bad:.0f}" for bad, case in found)
                print(f"{name} valid {100.0 - share(waves.Scene.clean):5.1f}; flagged {listed}", flush=True)


if __name__ == "__main__":
    main()
