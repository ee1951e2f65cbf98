"""Slopes of a set's features for each cause: the source of `analysis/diagnosis/slopes.toml`.

    python benchmarks/diagnosis_slopes.py            prints the tables of `analysis/diagnosis/slopes.toml`
    python benchmarks/diagnosis_slopes.py --json

Noise-free shots of the paper's chain (disk sensor) on its dry Mindlin plate, through the extractor of the
recorder. A slope is the change of a feature's logarithm by one unit of the source, from a small step to both
sides; a wall's row is the whole change at that depth. The assessment is tried on other models
(`benchmarks/diagnoses.py`).
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace

import numpy as np

from analysis.diagnosis.slopes import COMPONENTS, DEPTHS
from analysis.waves.features import extract_features
from hardware_drivers.measurement import Waveform
from simulator.chain.spheres import Contacts
from simulator.electronics.transduction import make_adc_calibration, quantise_volts
from simulator.numerics.arrays import FloatArray
from simulator.parameters.chain import ChainParameters
from simulator.parameters.electronics import AdcParameters, SensorParameters
from simulator.parameters.environmental_variability import STEEL_MODULUS_CHANGE_PER_K
from simulator.parameters.experiment import ScatterParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import Impact, ShotForce, ShotModel

ADC = replace(AdcParameters(), resolution_bits=24)
"""Its grain must not show in a slope."""
PATCHES_M = {"B": 25.4e-3, "C": 50.8e-3}
SHOTS_A_STEP = 8
"""Records with the sample clock at other places, averaged."""
LOG_STEP, KELVIN_STEP, TILT_STEP_RAD = 0.02, 10.0, 0.004
MEAN_TILT_RAD = ScatterParameters().mean_tilt_rad


def logs_of(force: ShotForce, gain_v_per_n: float) -> FloatArray:
    """Return logarithms of the features of a noise-free record, in the order of `COMPONENTS`."""
    calibration = make_adc_calibration(ADC)
    step_s = float(force.time_s[-1]) / (force.time_s.size - 1)
    grid_s = np.arange(force.time_s.size) * step_s
    found = []
    for phase in range(SHOTS_A_STEP):
        start_s = (phase / SHOTS_A_STEP - 1.0) / ADC.sample_rate_hz
        sampled_s = start_s + np.arange(-ADC.pretrigger_samples, ADC.record_samples) / ADC.sample_rate_hz
        volts = gain_v_per_n * np.interp(sampled_s, grid_s, force.force_n - force.preload_n, left=0.0)
        counts = quantise_volts(volts, calibration)
        waveform = Waveform(
            counts=counts,
            sample_rate_hz=ADC.sample_rate_hz,
            pretrigger_samples=ADC.pretrigger_samples,
            calibration=calibration,
        )
        features = extract_features(waveform)
        found.append([math.log(getattr(features, name)) for name in COMPONENTS])
    return np.asarray(np.mean(found, axis=0))


def gain_at(tilt_rad: float) -> float:
    """Return the sensitivity of a tilted disk, as in `experiment.scatter`."""
    sensor = SensorParameters()
    return sensor.sensitivity_v_per_n * math.exp(-sensor.tilt_loss_per_rad * tilt_rad)


def slopes(chain: ChainParameters, plate: PlateParameters, size_m: float = 25.4e-3) -> dict[str, FloatArray]:
    """Return the change of the logarithms by each source, shape (7,): one unit of ln, a kelvin, a radian."""
    model, n = ShotModel(chain, plate, CorrosionParameters(size_m=size_m)), chain.bodies

    def at(
        stiffness: FloatArray | None = None,
        damping: FloatArray | None = None,
        drop: float = 0.0,
        tilt_rad: float = 0.0,
        modulus: float = 1.0,
    ) -> FloatArray:
        zero = np.zeros(n)
        impact = Impact(
            drop_height_m=chain.drop_height_m * math.exp(drop),
            tilt_rad=MEAN_TILT_RAD + tilt_rad,
            contacts=Contacts(
                stiffness_factor=np.exp(zero if stiffness is None else stiffness),
                damping_factor=np.exp(zero if damping is None else damping),
            ),
            plate_modulus_factor=modulus,
        )
        return logs_of(model.shots([impact])[0], gain_at(MEAN_TILT_RAD + tilt_rad))

    found = {}
    for contact in range(n):
        one = LOG_STEP * np.eye(n)[contact]
        found[f"stiffness_{contact}"] = (at(stiffness=one) - at(stiffness=-one)) / (2.0 * LOG_STEP)
        found[f"damping_{contact}"] = (at(damping=one) - at(damping=-one)) / (2.0 * LOG_STEP)
    found["drop_height"] = (at(drop=LOG_STEP) - at(drop=-LOG_STEP)) / (2.0 * LOG_STEP)
    found["tilt_rad"] = (at(tilt_rad=TILT_STEP_RAD) - at(tilt_rad=-TILT_STEP_RAD)) / (2.0 * TILT_STEP_RAD)
    stiffer, softer = (at(modulus=math.exp(sign * LOG_STEP)) for sign in (1.0, -1.0))
    found["plate_modulus"] = (stiffer - softer) / (2.0 * LOG_STEP)
    warmer = math.log1p(STEEL_MODULUS_CHANGE_PER_K * KELVIN_STEP)
    all_contacts = np.full(n, warmer)
    hot, cold = (at(stiffness=sign * all_contacts, modulus=math.exp(sign * warmer)) for sign in (1.0, -1.0))
    found["modulus_k"] = (hot - cold) / (2.0 * KELVIN_STEP)
    return found


def walls(chain: ChainParameters, plate: PlateParameters, size_m: float) -> FloatArray:
    """Return the change of the logarithms at each of `DEPTHS`, shape (len(DEPTHS), 7)."""
    model = ShotModel(chain, plate, CorrosionParameters(size_m=size_m))
    depths = [0.0, *DEPTHS]
    shots = model.shots([Impact(depth_fraction=depth, tilt_rad=MEAN_TILT_RAD) for depth in depths])
    logs = np.array([logs_of(force, gain_at(MEAN_TILT_RAD)) for force in shots])
    return np.asarray(logs[1:] - logs[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    chain, plate = ChainParameters(), PlateParameters()
    of_sources = slopes(chain, plate)
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
