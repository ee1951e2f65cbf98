"""Accuracy of the wall diagnosis on models whose slopes were not used in the design.

    python benchmarks/diagnoses.py                                   some minutes on one core
    python benchmarks/diagnoses.py --runs 1000 --only healthy        the number of runs behind a bound of 1 %
    python benchmarks/diagnoses.py --levels plant --models wet --json

A run is a baseline of 200 sets, one an hour, and 300 sets after it; each number is over runs of all the
models asked for (solid plate, wet face, stronger dashpots). Sets are drawn at the level of sets, since
500,000 sets of ten shots would take hours: what the twin's nuisance does to contacts, tilt, height and gain
(its own functions, with memory, wander, tails, re-seats and weather), turned to features by slopes of the
assessed model, with the noise that ten real records leave (measured from the twin once); its walls are that
model's own curve. Slopes are straight: what bends is left out, as are rogue and invalid shots and a loose
contact. `tests/validation/test_diagnoses.py` takes real shots. A suspicion gets a confirmation set at once,
at most two a day; "other" counts what was ever called sensor, coupling or environment. Healthy runs hold the
re-seats of their level.
"""

from __future__ import annotations

import argparse
import json
import math
import os
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from diagnosis_slopes import MEAN_TILT_RAD, RECORDER, walls

from analysis.diagnosis.diagnose import add_diagnosis, diagnose_latest_set
from analysis.diagnosis.hypotheses import COUPLING, ENVIRONMENT, OK, SENSOR, WALL
from analysis.diagnosis.parameters import compute_diagnosis_parameters
from analysis.diagnosis.slopes import COMPONENTS, DEPTHS
from analysis.diagnosis.state import DiagnosisState, add_confirmation_set, add_set
from analysis.statistics.baseline import fit_baseline
from analysis.statistics.distance import distance_squared
from analysis.statistics.limits import f_predictive_limit
from analysis.statistics.rules import NOMINAL_RATE, AlarmRule, AlarmState, update_alarm_state
from daq_service.assessment.wall_bank import compute_source_slopes
from daq_service.cli.offline.twin_line import simulate_assessed_sets
from daq_service.settings.file import load_settings
from hardware_drivers.measurement import SetKey
from simulator.experiment.processes import draw_unit_t
from simulator.experiment.scatter import draw_room_temperature
from simulator.experiment.seating import Climate, draw_climate, draw_seat_of_set
from simulator.numerics.arrays import FloatArray
from simulator.parameters.chain import ChainParameters
from simulator.parameters.environmental_variability import NUISANCE
from simulator.parameters.experiment import DriftParameters, ScatterParameters
from simulator.parameters.plate import LiquidParameters, PlateParameters

BASELINE, AFTER, SHOTS = 200, 300, 10
CHAIN, PLATE = ChainParameters(), PlateParameters()
STRONGER = replace(CHAIN, damping_n_s_per_m=9.0, contact_damping_n_s_per_m=70.0)
MODELS = {
    "solid": (CHAIN, replace(PLATE, model="solid")),
    "wet": (CHAIN, replace(PLATE, liquid=LiquidParameters(depth_m=0.05))),
    "dashpots": (STRONGER, PLATE),
}
PATCH_M = 25.4e-3
CONFIRMED_FOR = 12
"""Sets between two confirmation sets: two a day."""
RULE = AlarmRule(k=3, n=5)
HEALTHY_RATE = 0.01
"""Of healthy runs that may be called WALL: what F is held to next to its own limit."""
DEPTH_AT_END = 0.4
"""Corrosion grows evenly to this over the 300 sets, as the paper's positions did."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ModelSlopes:
    """Slopes of a model: rows A and gamma of each contact, drop height, gain, tilt; shape (21, features)."""

    of_place: FloatArray
    of_plate_modulus: FloatArray
    wall: FloatArray


@lru_cache(maxsize=8)
def model_slopes(name: str, features: tuple[str, ...] = COMPONENTS) -> ModelSlopes:
    chain, plate = MODELS[name]
    recorder = replace(RECORDER, names=features)
    found = compute_source_slopes(chain, plate, recorder)
    n = chain.bodies
    gain = np.array([float(part in ("psw_area_v_s", "isw_amplitude_v")) for part in features])
    # The seat gives the tilt apart from its loss of gain, `slopes` both together.
    rows = [found[f"stiffness_{k}"] for k in range(n)] + [found[f"damping_{k}"] for k in range(n)]
    rows += [found["drop_height"], gain, found["tilt_rad"]]
    wall = np.vstack([np.zeros(len(features)), walls(chain, plate, PATCH_M, recorder)])
    return ModelSlopes(of_place=np.array(rows), of_plate_modulus=found["plate_modulus"], wall=wall)


@lru_cache(maxsize=2)
def electronic_sd(features: tuple[str, ...] = COMPONENTS) -> FloatArray:
    """Return the SD that record noise leaves in the logarithms of a set's means, from real records."""
    twin = {"scatter": {"scale": 0.0}, "drift": {"enabled": False}}
    settings = load_settings(None, overrides={"twin": twin, "schedule": {"end_h": 12.0}})
    rows = [one.position_result.features[-1] for one in simulate_assessed_sets(settings, "D")]
    logs = [[math.log(getattr(row, part)) for part in features] for row in rows]
    return np.asarray(np.std(logs, axis=0, ddof=1))


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """Change to diagnose: full sizes by source, at once or evenly over `ramp` sets from `onset` on."""

    name: str
    sizes: tuple[tuple[str, float], ...] = ()
    onset: int = BASELINE + 50
    ramp: int = 0
    depth: float = 0.0

    def part(self, index: int) -> float:
        """Return the fraction of the full size at a set."""
        if index < self.onset:
            return 0.0
        return 1.0 if self.ramp == 0 else min(1.0, (index - self.onset) / self.ramp)


HEALTHY = Case(name="healthy")
RESEAT = Case(name="re-seat")
CORROSION = Case(name="corrosion", onset=BASELINE, ramp=AFTER, depth=DEPTH_AT_END)
SENSOR_FAULTS = (
    Case(name="gain step", sizes=(("gain", -0.15),)),
    Case(name="pzt ageing", sizes=(("gain", -0.3),), ramp=250),
    Case(name="tilt", sizes=(("tilt_rad", 0.03),), ramp=100),
    Case(name="bead wear", sizes=(("wear", 0.25),), ramp=250),
    Case(name="striker", sizes=(("drop_height", -0.5),), ramp=150),
)
WARMER = Case(name="temperature", sizes=(("kelvin", 15.0),), ramp=48)


def source_values(case: Case, part: float, reseat: FloatArray, n: int) -> tuple[FloatArray, float]:
    """Return a case's addition to the sources, shape (2 n + 3,), and to the temperature in K."""
    place, warmer_k = np.zeros(2 * n + 3), 0.0
    rows = {"drop_height": 2 * n, "gain": 2 * n + 1, "tilt_rad": 2 * n + 2}
    for source, size in case.sizes:
        if source == "wear":
            place[:n] += 0.5 * math.log1p(part * size)
        elif source == "kelvin":
            warmer_k = part * size
        else:
            place[rows[source]] += part * size
    return (place + part * reseat if case == RESEAT else place), warmer_k


def reseat_of(level: str, random: np.random.Generator, n: int) -> FloatArray:
    """Draw a re-seat of the level's own sizes."""
    parameters = NUISANCE[level]
    sd = np.full(2 * n + 3, parameters.contact_stiffness.reseat_sd)
    sd[n - 1] = parameters.plate_stiffness.reseat_sd
    sd[n : 2 * n] = np.hypot(parameters.contact_damping.reseat_sd, parameters.rubbing.reseat_sd)
    sd[2 * n - 1] = parameters.plate_damping.reseat_sd
    sd[2 * n :] = [getattr(parameters, name).reseat_sd for name in ("drop_height", "gain", "tilt_rad")]
    return sd * random.standard_normal(2 * n + 3)


def sets_of(
    case: Case,
    level: str,
    model: str,
    seed: int,
    features: tuple[str, ...] = COMPONENTS,
    after: int = AFTER,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return logarithms of each set and a confirmation set, shape (n, features), and the wall's depth."""
    chain, found, random = MODELS[model][0], model_slopes(model, features), np.random.default_rng(seed)
    n, drift, scatter = chain.bodies, DriftParameters(), ScatterParameters()
    weather: Climate = draw_climate(level, seed=seed, warmest_hour_h=drift.warmest_hour_h)
    room, reseat = draw_room_temperature(drift, seed=seed), reseat_of(level, random, n)
    places, seats = [], []
    for index in range(BASELINE + after):
        hour_h = float(index)
        place, fault_k = source_values(case, case.part(index), reseat, n)
        warmer_k = room.at(hour_h) - drift.mean_temperature_c + fault_k
        seat = draw_seat_of_set(
            level, seed, "B", chain, weather, set_key=SetKey(index), hour_h=hour_h, warmer_k=warmer_k
        )
        places.append(place + seat.place)
        seats.append(seat)
    place, sets = np.array(places), len(seats)
    chain_k = np.array([seat.chain_warmer_k for seat in seats])
    place[:, 2 * n + 1] += drift.sensitivity_per_k * chain_k
    place[:, 2 * n] += drift.guide_length_m * drift.guide_expansion_per_k * chain_k / chain.drop_height_m
    depth = case.depth * np.array([case.part(index) for index in range(sets)])
    fixed = np.log([[seat.plate_modulus_factor] for seat in seats]) * found.of_plate_modulus
    fixed += np.stack([np.interp(depth, [0.0, *DEPTHS], column) for column in found.wall.T], axis=1)
    effects = np.array([seat.shot_effect for seat in seats])
    struck = []
    for _ in range(2):
        shots = draw_unit_t(random, NUISANCE[level].tail_dof, (sets, SHOTS, effects.shape[2])).mean(axis=1)
        own = place + (effects @ shots[:, :, None])[:, :, 0]
        own[:, 2 * n] += scatter.set_drop_height_sd_fraction * random.standard_normal(sets)
        of_shots = scatter.shot_drop_height_sd_fraction / math.sqrt(SHOTS)
        own[:, 2 * n] += of_shots * random.standard_normal(sets)
        own[:, 2 * n + 2] += scatter.set_tilt_sd_rad * random.uniform(-math.sqrt(3.0), math.sqrt(3.0), sets)
        noise = electronic_sd(features) * random.standard_normal((sets, len(features)))
        struck.append(own @ found.of_place + fixed + noise)
    return struck[0], struck[1], depth


def diagnose_run(
    case: Case, level: str, model: str, seed: int, baseline_sets: int = BASELINE
) -> dict[str, Any]:
    """Diagnose one run with the last sets before `BASELINE`; depths are None where it was never WALL."""
    return diagnose_sets(case, level, model, seed, *sets_of(case, level, model, seed), baseline_sets)


def diagnose_sets(
    case: Case,
    level: str,
    model: str,
    seed: int,
    logs: FloatArray,
    confirmation_logs: FloatArray,
    depths: FloatArray,
    baseline_sets: int = BASELINE,
    *,
    find_loss: Callable[[int, str], float] = lambda index, cause: 0.0,
) -> dict[str, Any]:
    """Diagnose the sets of a run, as `diagnose_run`.

    ``find_loss`` returns the probability of a loss after the set of an index, whose diagnosis it is given.
    """
    design = compute_diagnosis_parameters(logs[BASELINE - baseline_sets : BASELINE], BASELINE - baseline_sets)
    raw = np.exp(logs[:, :5])
    baseline = fit_baseline(raw[BASELINE - baseline_sets : BASELINE], range(baseline_sets), name="b")
    limit = f_predictive_limit(baseline.n, baseline.p, NOMINAL_RATE)
    distance = distance_squared(raw, baseline)
    beyond = distance > limit
    memory, state = DiagnosisState(), AlarmState()
    first: dict[str, float | None] = {"wall": None, "f": None}
    confirmed_at = -CONFIRMED_FOR
    causes, lost = list[str](), 0.0
    for index in range(BASELINE, len(logs)):
        memory = add_set(memory, design.mean, logs[index], index)
        state = update_alarm_state(state, bool(beyond[index]), RULE)
        diagnosis = diagnose_latest_set(memory, design, suspicious=state.active, lost_probability=lost)
        memory = add_diagnosis(memory, diagnosis)
        if diagnosis.cause not in (OK, COUPLING) and index - confirmed_at >= CONFIRMED_FOR:
            confirmed_at = index
            memory = add_confirmation_set(memory, design.mean, confirmation_logs[index])
            diagnosis = diagnose_latest_set(memory, design, suspicious=True, lost_probability=lost)
            memory = add_diagnosis(memory, diagnosis)
        causes.append(diagnosis.cause)
        lost = find_loss(index, diagnosis.cause)
        for name, seen in (("wall", diagnosis.cause == WALL), ("f", state.active)):
            if seen and first[name] is None:
                first[name] = float(depths[index])
    return {
        "case": case.name,
        "level": level,
        "model": model,
        "seed": seed,
        "causes": causes,
        "called": dict(Counter(causes)),
        "last": diagnosis.cause,
        "first_wall_depth": first["wall"],
        "first_f_depth": first["f"],
        "f_alarmed": first["f"] is not None,
        "f_limits": limits_alarmed_at(distance[BASELINE:], depths[BASELINE:]),
    }


def limits_alarmed_at(distance: FloatArray, depths: FloatArray) -> list[tuple[float, float]]:
    """Return depth, and the largest limit that 3 of 5 sets have exceeded by then, wherever that has grown.

    Until the fifth set 3 of those that are there: a k of n begins with an empty window.
    """
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(distance, (RULE.n - 1, 0)), RULE.n)
    so_far = np.maximum.accumulate(np.sort(windows, axis=1)[:, -RULE.k])
    grown = np.flatnonzero(np.diff(so_far, prepend=-math.inf) > 0.0)
    return [(float(depths[at]), float(so_far[at])) for at in grown]


def depth_by_f_held_to(
    rate: float, healthy: Sequence[dict[str, Any]], sick: Sequence[dict[str, Any]]
) -> float:
    """Return the median depth of the F alarm, 3 of 5, at a limit with this healthy rate."""
    limit = np.quantile([row["f_limits"][-1][1] for row in healthy], 1.0 - rate)
    first = [next((depth for depth, seen in row["f_limits"] if seen > limit), math.inf) for row in sick]
    return float(np.median(first))


def median_depth(rows: Sequence[dict[str, Any]], name: str) -> float:
    """Return the median over the runs; a run without a diagnosis counts as deeper than any."""
    return float(np.median([math.inf if row[name] is None else row[name] for row in rows]))


def percent(found: Sequence[bool]) -> float:
    """Return the share in percent."""
    return 100.0 * float(np.mean(found))


def show(rows: Sequence[dict[str, Any]]) -> None:
    head = f"{'level':11s}{'case':13s}{'runs':>5s}{'WALL %':>8s}{'other %':>8s}{'F %':>7s}"
    print(f"{head}  at the end, %")
    for level in dict.fromkeys(row["level"] for row in rows):
        for case in dict.fromkeys(row["case"] for row in rows):
            own = [row for row in rows if row["level"] == level and row["case"] == case]
            called = percent([bool(row["called"].get(WALL)) for row in own])
            other = percent([bool(OTHERS & row["called"].keys()) for row in own])
            by_f = percent([row["f_alarmed"] for row in own])
            ends = Counter(row["last"] for row in own).most_common()
            text = ", ".join(f"{name} {100 * count / len(own):.0f}" for name, count in ends)
            shares = f"{called:8.1f}{other:8.1f}{by_f:7.1f}"
            print(f"{level:11s}{case:13s}{len(own):5d}{shares}  {text}")
            if case == CORROSION.name:
                first, f_first = median_depth(own, "first_wall_depth"), median_depth(own, "first_f_depth")
                print(f"{'':11s}median depth at the first WALL {first:.3f}, by F, 3 of 5 {f_first:.3f}")
                healthy = [row for row in rows if row["level"] == level and row["case"] == HEALTHY.name]
                if healthy:
                    held = depth_by_f_held_to(HEALTHY_RATE, healthy, own)
                    text = f"at a limit that {100 * HEALTHY_RATE:g} % of the healthy runs here go beyond"
                    print(f"{'':11s}by 3 of 5 {text}: {held:.3f}")


OTHERS = {SENSOR, COUPLING, ENVIRONMENT}
CASES = {case.name: case for case in (HEALTHY, RESEAT, *SENSOR_FAULTS, WARMER, CORROSION)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=99, help="of each case and level, over all models")
    parser.add_argument("--first-seed", type=int, default=0, help="choose by others than you show")
    parser.add_argument("--levels", default=",".join(NUISANCE))
    parser.add_argument("--models", default=",".join(MODELS))
    parser.add_argument("--only", default=",".join(CASES), help=f"of {', '.join(CASES)}")
    parser.add_argument("--baseline-sets", type=int, default=BASELINE, help="the last ones of 200")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    models = options.models.split(",")
    for model in models:
        model_slopes(model)
    electronic_sd()
    todo = [
        (CASES[case], level, models[k % len(models)], options.first_seed + k, options.baseline_sets)
        for level in options.levels.split(",")
        for case in options.only.split(",")
        for k in range(options.runs)
    ]
    with ProcessPoolExecutor(options.workers) as executor:
        rows = list(executor.map(diagnose_run, *zip(*todo, strict=True), chunksize=4))
    if options.json:
        print(json.dumps({"mean_tilt_rad": MEAN_TILT_RAD, "runs": rows}))
    else:
        show(rows)


if __name__ == "__main__":
    main()
