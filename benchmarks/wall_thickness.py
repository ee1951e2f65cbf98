"""Coverage and width of the intervals of the wall thickness from waves: kinds and sizes of walls left out.

    python benchmarks/wall_thickness.py                        some minutes on one core
    python benchmarks/wall_thickness.py --sensors 50 --levels laboratory --left-out kind --json

A sensor has a baseline of 48 sets in a day and 20 sets over the 340 hours after it. Its sets are drawn as in
`diagnoses.py`: what the twin's nuisance does to contacts, tilt, height and gain at a level, turned to
features by slopes, with the noise that ten real records leave. Its wall follows one curve of the bank that
the filter does not have: all of its kind (`--left-out kind`) or of its size (`size`) are left out. The loss
grows as a power 1, 1.5 or 2 of time, to at most 75 %; one wall in ten stays sound. Truth is the loss since
the baseline, or since its mean if the current was on from hour 0 (`--current-from-start`). The constants of
`analysis.wall` were chosen on even seeds; this uses odd ones (`--seeds even` the others).

Next to it: no discrepancy and ambiguity, one curve (25.4 mm) with all features, the time of flight alone on
that curve, and the Fisher bound: the width that a single set allows on a square patch of 25.4 mm, with its
size known, and unknown. A kind whose intervals hold in fewer than 80 % in a band of loss is named as not
valid there. Dates: of losses of 20, 30 and 50 %, six sets before they are reached, and at each look of the
loss that is reached six sets later.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from analysis.wall import posterior
from analysis.wall.bank import FEATURES, Bank, load_bank
from analysis.wall.calibration import calibrate
from daq_service.assessment.wall_bank import SHIPPED_BANK
from hardware_drivers.measurement import SetKey
from simulator.experiment.processes import draw_unit_t
from simulator.experiment.scatter import draw_room_temperature
from simulator.experiment.seating import draw_climate, draw_seat_of_set
from simulator.numerics.arrays import FloatArray
from simulator.parameters.chain import ChainParameters
from simulator.parameters.environmental_variability import NUISANCE
from simulator.parameters.experiment import DriftParameters, ScatterParameters

BASELINE, AFTER, SHOTS = 48, 20, 10
HOURS = np.concatenate([0.5 * np.arange(BASELINE), 24.0 + 17.0 * np.arange(1, AFTER + 1)])
CHAIN = ChainParameters()
NOISE = np.array([0.0006, 0.0035, 0.0047, 0.0023, 0.0020])
"""SD that record noise leaves in ln features of a set of ten, as `diagnoses.electronic_sd` measures it."""
LOOKS = (4, 9, 14, 19)
"""Sets after which an interval is compared with the truth: nearer ones repeat each other."""
BANDS = ((-1.0, 0.0), (0.0, 0.15), (0.15, 0.35), (0.35, 0.75))
"""Losses of a sound wall, and three bands, as fractions of the wall."""
DEPTHS = (0.1, 0.25, 0.5)
STATED, AHEAD = (0.2, 0.3, 0.5), 6
"""Stated losses, forecast so many sets before they are reached."""
LEAST_COVERAGE = 0.8
METHODS = ("bank", "no discrepancy", "one curve", "time of flight")


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """One interval and its truth, as fractions of the wall."""

    kind: str
    loss: float
    low: float
    median: float
    high: float
    state_kb: float

    @property
    def covers(self) -> bool:
        """Return whether the truth is within the interval."""
        return self.low - 1e-9 <= self.loss <= self.high + 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Forecast:
    """Interval of the hours until a loss is reached, and the true ones; ``stated``: a loss of `STATED`."""

    stated: bool
    low_h: float
    high_h: float
    true_h: float


def draw_healthy_sets(bank: Bank, level: str, seed: int) -> FloatArray:
    """Return the ln features of a sensor's sets without corrosion, shape (68, 5)."""
    random, n = np.random.default_rng(seed), CHAIN.bodies
    drift, scatter = DriftParameters(), ScatterParameters()
    climate = draw_climate(level, seed=seed, warmest_hour_h=drift.warmest_hour_h)
    room = draw_room_temperature(drift, seed=seed)
    seats = [
        draw_seat_of_set(
            *(level, seed, "B", CHAIN, climate),
            set_key=SetKey(index),
            hour_h=hour_h,
            warmer_k=room.at(hour_h) - drift.mean_temperature_c,
        )
        for index, hour_h in enumerate(HOURS.tolist())
    ]
    places, count = np.array([seat.place for seat in seats]), len(seats)
    warmer_k = np.array([seat.chain_warmer_k for seat in seats])
    places[:, 2 * n + 1] += drift.sensitivity_per_k * warmer_k
    places[:, 2 * n] += drift.guide_length_m * drift.guide_expansion_per_k * warmer_k / CHAIN.drop_height_m
    effects = np.array([seat.shot_effect for seat in seats])
    shots = draw_unit_t(random, NUISANCE[level].tail_dof, (count, SHOTS, effects.shape[2])).mean(axis=1)
    places += (effects @ shots[:, :, None])[:, :, 0]
    places[:, 2 * n] += scatter.set_drop_height_sd_fraction * random.standard_normal(count)
    of_shots = scatter.shot_drop_height_sd_fraction / math.sqrt(SHOTS)
    places[:, 2 * n] += of_shots * random.standard_normal(count)
    places[:, 2 * n + 2] += scatter.set_tilt_sd_rad * random.uniform(-math.sqrt(3.0), math.sqrt(3.0), count)
    sources = [
        *(f"stiffness_{k}" for k in range(n)),
        *(f"damping_{k}" for k in range(n)),
        *("drop_height", "gain", "tilt_rad"),
    ]
    slopes = bank.slopes[[bank.sources.index(name) for name in sources]]
    return bank.sound + places @ slopes + NOISE * random.standard_normal((count, len(FEATURES)))


def find_kind(bank: Bank, seed: int) -> str:
    """Return the kind of wall of a sensor."""
    names = sorted(set(bank.kinds))
    return names[seed // 2 % len(names)]


def choose(bank: Bank, chosen: FloatArray) -> Bank:
    """Return a bank of some of its curves."""
    at = np.flatnonzero(chosen).tolist()
    words = {name: tuple(getattr(bank, name)[k] for k in at) for name in ("models", "kinds", "names")}
    return replace(bank, changes=bank.changes[at], sizes_m=bank.sizes_m[at], **words)


@lru_cache(maxsize=64)
def predicted(file: str, left_out: bytes, method: str) -> FloatArray:
    """Return the predicted changes of a bank without some curves, by a method."""
    bank = load_bank(Path(file))
    chosen = choose(bank, np.frombuffer(left_out, dtype=bool))
    if method == METHODS[0]:
        return posterior.predict_changes(chosen)
    # Without discrepancy the draws of a curve are equal; a third of them keeps the weights of the models.
    return posterior.predict_changes(chosen, 0.0, 0.0)[:: posterior.FACTORS]


def run_sensor(
    file: str, level: str, left_out: str, method: str, seed: int, hours_before: float
) -> Iterator[Look | Forecast]:
    """Yield looks and forecasts of a sensor; its wall thins from so many hours before the baseline's end."""
    bank, random = load_bank(Path(file)), np.random.default_rng([seed, 5])
    kind = find_kind(bank, seed)
    member = int(random.choice([k for k, one in enumerate(bank.kinds) if one == kind]))
    known = np.isfinite(bank.changes[member]).all(axis=1)
    reach = min(0.75, float(bank.losses[known][-1]))
    end_loss = 0.0 if random.random() < 0.1 else random.uniform(0.02, reach)
    power = float(random.choice([1.0, 1.5, 2.0]))
    start_h, sets = HOURS[BASELINE - 1] - hours_before, draw_healthy_sets(bank, level, seed)
    corroded = end_loss * (np.clip(HOURS - start_h, 0.0, None) / (HOURS[-1] - start_h)) ** power
    for k in range(len(FEATURES)):
        sets[:, k] += np.interp(corroded, bank.losses[known], bank.changes[member][known, k])
    if left_out == "kind":
        kept = np.array([one != kind for one in bank.kinds])
    else:
        kept = ~np.isclose(bank.sizes_m, bank.sizes_m[member], rtol=0.01)
    if method in ("one curve", "time of flight"):
        kept = np.array([one == "nominal" for one in bank.kinds]) & (bank.sizes_m < 0.03)
    changes = predicted(file, kept.tobytes(), method)
    calibration = calibrate(bank, sets[:BASELINE])
    if method == "time of flight":
        alone = np.zeros((len(FEATURES), len(FEATURES)))
        alone[0, 0] = math.sqrt(1.0 - calibration.slow) / sets[:BASELINE, 0].std(ddof=1)
        calibration = replace(calibration, whitening=alone)
    before = float(corroded[:BASELINE].mean())
    # Set after which each stated loss is forecast, and when the wall reaches it.
    stated = {}
    for loss in STATED if end_loss else ():
        reached_h = start_h + (HOURS[-1] - start_h) * ((loss + before) / end_loss) ** (1.0 / power)
        k = int(np.searchsorted(HOURS, reached_h - AHEAD * 17.0, side="right")) - 1
        if k >= BASELINE and reached_h < HOURS[-1] + AHEAD * 17.0:
            stated[k, loss] = reached_h - HOURS[k]
    hypotheses = posterior.compare(calibration, changes)
    state = posterior.begin(len(changes), float(HOURS[BASELINE - 1]))
    for k in range(BASELINE, BASELINE + AFTER):
        slow = state.slow.wait(float(HOURS[k]) - state.hour)
        if hypotheses.compute_misfit(sets[k], slow) > 1.0:
            state = posterior.wait(state, float(HOURS[k]))
        else:
            state = posterior.add_set(state, hypotheses, sets[k], float(HOURS[k]))
        for (at, loss), true_h in stated.items():
            if at == k:
                found = posterior.forecast(state, loss)
                yield Forecast(stated=True, low_h=found.low, high_h=found.high, true_h=true_h)
        if k - BASELINE not in LOOKS:
            continue
        loss = float(corroded[k]) - before
        found = posterior.estimate_loss(state, *(() if method == METHODS[0] else (1e-9,)))
        state_kb = 1e-3 * len(posterior.pack_state(state))
        ends = {"low": found.low, "median": found.median, "high": found.high}
        yield Look(kind=kind, loss=loss, state_kb=state_kb, **ends)
        if loss > 0.02:
            part = (HOURS[k] + AHEAD * 17.0 - start_h) / (HOURS[-1] - start_h)
            found = posterior.forecast(state, end_loss * part**power - before)
            yield Forecast(stated=False, low_h=found.low, high_h=found.high, true_h=AHEAD * 17.0)


def compute_fisher_widths(bank: Bank, level: str) -> dict[str, list[float]]:
    """Return the widths of 90 % in mm that a set allows, by loss: size of the patch known, unknown."""
    baselines = [draw_healthy_sets(bank, level, seed)[:BASELINE] for seed in range(20)]
    whitening = np.median([calibrate(bank, baseline).whitening for baseline in baselines], axis=0)
    square = [
        next(k for k, name in enumerate(bank.names) if name == f"mindlin, square {size_mm} mm")
        for size_mm in (22.5, 25.4, 29)
    ]
    found = {}
    for depth in DEPTHS:
        at = int(np.abs(bank.losses - depth).argmin())
        smaller, patch, larger = bank.changes[square]
        by_loss = (patch[at + 1] - patch[at - 1]) / (bank.losses[at + 1] - bank.losses[at - 1])
        white = np.stack([by_loss, larger[at] - smaller[at]]) @ whitening
        sds = 1.0 / math.sqrt(white[0] @ white[0]), math.sqrt(np.linalg.inv(white @ white.T)[0, 0])
        found[f"{depth:.0%}"] = [round(2.0 * 1.645 * sd * 1e3 * bank.thickness_m, 2) for sd in sds]
    return found


def summarize(found: list[Look | Forecast], thickness_mm: float) -> dict[str, Any]:
    """Return coverage by kind and band, widths in mm, and the same of the forecasts."""
    looks = [one for one in found if isinstance(one, Look)]

    def share(chosen: list[Look]) -> list[float]:
        return [round(float(np.mean([one.covers for one in chosen])), 3) if chosen else math.nan, len(chosen)]

    def median(values: list[float]) -> float:
        return round(float(np.median(values)), 2) if values else math.nan

    def of_band(low: float, high: float) -> list[Look]:
        return [one for one in looks if low < one.loss <= high]

    kinds = sorted({one.kind for one in looks})
    widths = {
        f"{depth:.0%}": median(
            [(one.high - one.low) * thickness_mm for one in looks if abs(one.loss - depth) < 0.04]
        )
        for depth in DEPTHS
    }
    by_both = {
        kind: [share([one for one in of_band(*band) if one.kind == kind]) for band in BANDS[1:]]
        for kind in kinds
    }
    dates = {}
    for name, stated in (("stated losses", True), ("any loss", False)):
        chosen = [one for one in found if isinstance(one, Forecast) and one.stated == stated]
        dates[name] = {
            "covers": round(float(np.mean([one.low_h <= one.true_h <= one.high_h for one in chosen])), 3),
            "width_h": median([one.high_h - one.low_h for one in chosen]),
            "forecasts": len(chosen),
        }
    return {
        "covers": share(looks),
        "by_kind": {kind: share([one for one in looks if one.kind == kind]) for kind in kinds},
        "by_band": {f"{max(low, 0.0):.0%}-{high:.0%}": share(of_band(low, high)) for low, high in BANDS},
        "by_kind_and_band": by_both,
        "not_valid": [
            f"{kind} at {low:.0%}-{high:.0%}"
            for kind, shares in by_both.items()
            for (low, high), (covers, _) in zip(BANDS[1:], shares, strict=True)
            if covers < LEAST_COVERAGE
        ],
        "width_mm": widths,
        "sound_below_mm": median([one.high * thickness_mm for one in of_band(*BANDS[0])]),
        "dates": dates,
        "largest_state_kb": round(max(one.state_kb for one in looks)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bank", default=str(SHIPPED_BANK), help="npz file; default: the shipped bank")
    parser.add_argument("--sensors", type=int, default=500)
    parser.add_argument("--levels", nargs="+", default=["laboratory", "workshop"], choices=list(NUISANCE))
    parser.add_argument("--left-out", nargs="+", default=["kind", "size"], choices=["kind", "size"])
    parser.add_argument("--methods", nargs="+", default=METHODS, choices=METHODS)
    parser.add_argument("--kinds", nargs="+", help="only sensors on walls of these kinds")
    parser.add_argument("--seeds", default="odd", choices=["odd", "even"])
    parser.add_argument("--current-from-start", action="store_true", help="thin in the baseline too")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    results: dict[str, Any] = {}
    bank, hours_before = load_bank(Path(options.bank)), HOURS[BASELINE - 1] * options.current_from_start

    def add(name: str, found: dict[str, Any]) -> None:
        """Keep a result, and print it unless all of them are printed as JSON."""
        results[name] = found
        if not options.json:
            print("\n".join([name, *(f"  {key:<18} {value}" for key, value in found.items())]), flush=True)

    for level in options.levels:
        add(f"{level}, Fisher bound", {"width_mm": compute_fisher_widths(bank, level)})
        for left_out in options.left_out:
            for method in options.methods:
                started = time.process_time()
                drawn: list[Look | Forecast] = []
                for number in range(options.sensors):
                    seed = 2 * number + (options.seeds == "odd")
                    if options.kinds and find_kind(bank, seed) not in options.kinds:
                        continue
                    drawn += run_sensor(options.bank, level, left_out, method, seed, hours_before)
                    if (number + 1) % 50 == 0:
                        print(f"{level}, {left_out}, {method}: {number + 1} sensors", file=sys.stderr)
                found = summarize(drawn, 1e3 * bank.thickness_m)
                found["cpu_s_per_set"] = round((time.process_time() - started) / options.sensors / AFTER, 4)
                add(f"{level}, {left_out} left out, {method}", found)
    if options.json:
        print(json.dumps(results))


if __name__ == "__main__":
    main()
