"""Flag rate of each of the twin's seeded faults, and the fault's effect on the shots' features.

Run ``python benchmarks/flags_on_faults.py [--shots N] [--seed S]``. Every fault acts alone on a pristine
wall with the default scatter, drift and noise, at an hour when gradual faults have their full size and
ageing is a year old. The mesh is coarse: the pulses' shapes matter here, not the plate's stiffness.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping

import numpy as np

from analysis.waves.features import ShotFeatures, extract_features
from analysis.waves.quality_gate import FLAGS
from hardware_drivers.measurement import ShotKey
from simulator.parameters.chain import ChainParameters
from simulator.parameters.experiment import ThinningParameters, TwinParameters
from simulator.parameters.faults import (
    BeadWearFault,
    ClippingFault,
    DoubleStrikeFault,
    FaultParameters,
    LooseContactFault,
    MainsHumFault,
    MissedStrikeFault,
    PztAgeingFault,
    SpikesFault,
    TemperatureFault,
    TiltFault,
)
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import ShotModel
from simulator.specimen import Specimen, Transducer, build_specimen

HOUR_H = 8_766.0
CHAIN = ChainParameters()
PLATE = PlateParameters(elements_per_edge=32, contact_element_m=1e-3)
HOLE = "through hole"
FAULTS: Mapping[str, FaultParameters] = {
    "none": FaultParameters(),
    "missed, 20 %": FaultParameters(missed=MissedStrikeFault(probability=0.2)),
    "double, 50 %": FaultParameters(double=DoubleStrikeFault(probability=0.5)),
    "clipping, gain x 3": FaultParameters(clipping=ClippingFault(gain_factor=3.0)),
    HOLE: FaultParameters(),
    "hum 0.2 V, 50 Hz": FaultParameters(mains_hum=MainsHumFault(amplitude_v=0.2)),
    "hum 0.2 V, 60 Hz": FaultParameters(mains_hum=MainsHumFault(amplitude_v=0.2, frequency_hz=60.0)),
    "spikes 1 V, 2,000 Hz": FaultParameters(spikes=SpikesFault(rate_hz=2_000.0, armed_s=0.0)),
    "spikes 2 V, 5 Hz": FaultParameters(spikes=SpikesFault(rate_hz=5.0, height_v=2.0)),
    "tilt 0.05 rad": FaultParameters(tilt=TiltFault(tilt_rad=0.05)),
    "PZT ageing, half": FaultParameters(pzt_ageing=PztAgeingFault(loss_fraction_per_year=0.5)),
    "loose contact, 50 %": FaultParameters(loose_contact=LooseContactFault(probability=0.5)),
    "temperature + 20 K": FaultParameters(temperature=TemperatureFault(change_k=20.0)),
    "bead wear, radius x 2": FaultParameters(bead_wear=BeadWearFault(radius_growth_fraction=1.0)),
}


def coarse_model() -> ShotModel:
    return ShotModel(CHAIN, PLATE, CorrosionParameters(size_m=25.4e-3), cache_folder=None)


def faulty_specimen(model: ShotModel, name: str, seed: int) -> Specimen:
    thinning = ThinningParameters()
    if name == HOLE:
        thinning = ThinningParameters(reference_h=100.0, depth_fraction=0.3, hole_h=200.0)
    twin = TwinParameters(seed=seed, thinning={"B": thinning}, faults={"B": FAULTS[name]})
    return build_specimen(
        twin, transducers={"B": Transducer(chain=CHAIN, model=model)}, probed_thickness_m={}
    )


def faulty_shots(
    model: ShotModel, name: str, *, shots: int, seed: int
) -> Iterator[tuple[Mapping[str, float | str], ShotFeatures] | None]:
    """Yield truth and features of each shot, None for a strike without a record."""
    specimen = faulty_specimen(model, name, seed)
    for k in range(shots):
        key = ShotKey(position="B", set_index=k // 10, shot_index=k % 10)
        acquired = specimen.simulate_wave(key, HOUR_H)
        yield None if acquired is None else (acquired.truth, extract_features(acquired.waveform))


def print_row(model: ShotModel, name: str, shots: int, seed: int) -> None:
    found = [shot for shot in faulty_shots(model, name, shots=shots, seed=seed) if shot is not None]
    features = [shot for _, shot in found]
    counts = {flag: sum(flag in shot.flags for shot in features) for flag in FLAGS}
    listed = ", ".join(f"{flag} {count}" for flag, count in counts.items() if count) or "-"
    valid = [shot for shot in features if shot.valid]
    means = ["-"] * 4
    if valid:
        means = [
            f"{np.mean([shot.isw_amplitude_v for shot in valid]):.2f} V",
            f"{1e6 * np.mean([shot.isw_fwhm_s for shot in valid]):.1f} us",
            f"{1e6 * np.mean([shot.tof_mf_s for shot in valid]):.1f} us",
            f"{np.mean([shot.amplitude_ratio for shot in valid]):.3f}",
        ]
    print(f"| {name} | {len(found)} | {len(valid)} | {listed} | " + " | ".join(means) + " |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--shots", type=int, default=2_000, help="strikes of each fault")
    parser.add_argument("--seed", type=int, default=901)
    arguments = parser.parse_args()
    model = coarse_model()
    print("| fault | records | valid | flagged | ISW | ISW width | ToF | AR |")
    print("|---|---|---|---|---|---|---|---|")
    for name in FAULTS:
        print_row(model, name, arguments.shots, arguments.seed)


if __name__ == "__main__":
    main()
