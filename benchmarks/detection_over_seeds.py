"""Detection delay and false alarms of the demo's test over many seeds.

Runs the twin, the extraction and the assessors of the recorder (no storage: rows are dropped) for
each seed, at several scales of the scatter, and prints per run the hour of the first alarm and the
mean depth then; for the pristine position D the outliers after the baseline, with the drift on and
off. With the drift off, D's pooled count is compared with its predictive distribution: normal sets
assessed against a baseline of normal sets of the same size, simulated. At the end it prints, of the
runs with drift at scale 1, the median hour of the first alarm by the chart and by 3 of 5 sets beyond the
F limit, on the same records, and how often each was raised; the same of the service's alarm of the wall, and
of it where the cause was told to be the wall. With --why also charts that are designed otherwise, and 3 of 5
of sets freed of the same memory: what the chart pays for a baseline too short to show its memory.

    python benchmarks/detection_over_seeds.py                 eleven seeds, about ten minutes on two cores
    python benchmarks/detection_over_seeds.py --seeds 1 --hours 100 --scales 1
    python benchmarks/detection_over_seeds.py --seeds 10 --scales 1 --nuisance laboratory
    python benchmarks/detection_over_seeds.py --seeds 30 --scales 1 --nuisance laboratory --table losses.csv

With --table the loss at the first detection by each rule is written for `solimon pod`.

Exit code 1 if B or C alarm later than at 30 % mean depth at scale 1, or, without nuisance, D's pooled count
lies outside the central 99.5 % of its predictive distribution.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from analysis.diagnosis.hypotheses import WALL
from analysis.statistics.baseline import fit_baseline
from analysis.statistics.chart import build_chart, design_chart
from analysis.statistics.design import is_chart_alarm_active
from analysis.statistics.directions import find_directions
from analysis.statistics.distance import distance_squared
from analysis.statistics.limits import f_predictive_limit
from analysis.statistics.memory import prewhiten_sets
from analysis.statistics.mewma import known_limit, mewma
from analysis.statistics.rules import AlarmRule, AlarmState, update_alarm_state
from analysis.waves.features import FEATURE_NAMES
from daq_service.assessment.rules import compute_run_length
from daq_service.cli.offline.pod.runs import compute_losses, summarize_sensor
from daq_service.cli.offline.twin_line import build_twin, simulate_assessed_sets
from daq_service.settings.file import load_settings
from daq_service.settings.tree import Settings

DEEPEST_FIRST_ALARM = 0.30
COVERAGE = 0.995


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """Run of one position, seed and scatter."""

    position: str
    seed: int
    scale: float
    drift: bool
    hours: float
    nuisance: str = "none"
    why: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Result of a run."""

    run: Run
    first_alarm_h: float | None
    depth_at_alarm: float | None
    assessed_rows: int
    outliers: int
    outliers_paper: int
    n_baseline: int
    sd_percent: dict[str, float]
    raised_h: dict[str, list[float]]
    """Hours at which the alarm of the wall is raised, by what decides."""
    losses: list[dict[str, Any]]
    """Loss at the first detection, by the same; rows of the table for `solimon pod`."""


def settings_of(run: Run) -> Settings:
    twin = {
        "nuisance": run.nuisance,
        "seed": run.seed,
        "scatter": {"scale": run.scale},
        "drift": {"enabled": run.drift},
    }
    return load_settings(None, overrides={"twin": twin, "schedule": {"end_h": run.hours}})


def assess_run(run: Run) -> Outcome:
    settings = settings_of(run)
    specimen = build_twin(settings)
    assessments: dict[int, Any] = {}
    raised: dict[int, bool] = {}
    vectors: dict[int, list[float]] = {}
    baseline_vectors, first_alarm_h, depth_at_alarm, n_baseline = [], None, None, 0
    for found in simulate_assessed_sets(settings, run.position, specimen):
        position_result = found.position_result
        assessments |= {row.set_index: row for row in position_result.assessments}
        raised[found.due.set_index] = "wall_change" in found.raised
        vectors[found.due.set_index] = [getattr(position_result.features[-1], name) for name in FEATURE_NAMES]
        if found.due.due_h <= settings.baseline.hours:
            baseline_vectors.append(
                [getattr(position_result.features[-1], name) for name in (*FEATURE_NAMES, "isw_amplitude_v")]
            )
        if position_result.baseline is not None:
            n_baseline = position_result.baseline.n_sets
        if first_alarm_h is None and found.raised & {"wall_change", "no_reflection"}:
            first_alarm_h = found.due.due_h
            depth_at_alarm = specimen.walls[run.position].at(found.hour_h).depth_fraction
    assessed_rows = [row for row in assessments.values() if row.outlier is not None]
    rule, states = AlarmRule(k=settings.alarms.k, n=settings.alarms.n), [AlarmState()]
    for row in assessed_rows:
        states.append(update_alarm_state(states[-1], row.outlier, rule))
    standing = {
        "chart": [bool(row.mewma_alarm) for row in assessed_rows],
        "k_of_n": [state.active for state in states[1:]],
        "alarm": [raised[row.set_index] for row in assessed_rows],
        "alarm, WALL": [raised[row.set_index] and row.diagnosis == WALL for row in assessed_rows],
    }
    if run.why:
        standing |= alarms_of_other_designs(
            vectors, [i for i, row in assessments.items() if row.in_baseline], assessed_rows, settings
        )
    raised_h = {name: onsets(assessed_rows, stands) for name, stands in standing.items()}
    due_h = [row.due_h for row in assessed_rows]
    baseline_h = [row.due_h for row in assessments.values() if row.in_baseline]
    losses = compute_losses(settings, run.position, due_h, baseline_h) if due_h else np.zeros(0)
    results = [
        asdict(result)
        for name, hours in (raised_h.items() if due_h else ())
        for result in summarize_sensor(
            f"{run.position} {name}", f"seed {run.seed}", losses, np.interp(hours, due_h, losses)
        )
    ]
    table = np.array(baseline_vectors)
    sd_percent = 100 * table.std(axis=0, ddof=1) / np.abs(table.mean(axis=0))
    return Outcome(
        run=run,
        first_alarm_h=first_alarm_h,
        depth_at_alarm=depth_at_alarm,
        assessed_rows=len(assessed_rows),
        outliers=sum(row.outlier is True for row in assessed_rows),
        outliers_paper=sum(row.outlier_mean_3sd is True for row in assessed_rows),
        n_baseline=n_baseline,
        sd_percent=dict(zip((*FEATURE_NAMES, "isw_amplitude_v"), sd_percent.tolist(), strict=True)),
        raised_h=raised_h,
        losses=results,
    )


def alarms_of_other_designs(
    vectors: Mapping[int, Sequence[float]],
    baseline: Sequence[int],
    assessed_rows: Sequence[Any],
    settings: Settings,
) -> dict[str, list[bool]]:
    """Return the alarm after each set under other designs of charts and k-of-n rules."""
    begins, n = min(baseline), max(baseline) - min(baseline) + 1
    sets = np.full((assessed_rows[-1].set_index - begins + 1, len(FEATURE_NAMES)), np.nan)
    for index, vector in vectors.items():
        if begins <= index <= assessed_rows[-1].set_index:
            sets[index - begins] = vector
    history, p = sets[:n], len(FEATURE_NAMES)
    budget = compute_run_length(
        settings.schedule, settings.baseline.hours, settings.false_alarms_per_sensor_year()
    )
    found, designs = find_directions(history), design_chart(history, budget)
    charts = {
        "chart, memory as found": build_chart(history, found.matrix, found.guarded, designs.limit),
        "chart, no memory": build_chart(history, found.matrix, 0.0 * found.phi, designs.limit),
        "chart, limit of a known baseline": replace(designs, limit=known_limit(p, budget)),
    }
    rows = [row.set_index - begins for row in assessed_rows]
    standing: dict[str, list[bool]] = {}
    for name, chart in charts.items():
        alarming, standing[name] = False, []
        for value in mewma(chart.whiten_sets(sets)[n:])[np.array(rows) - n].tolist():
            alarming = is_chart_alarm_active(alarming, value, chart.limit, p)
            standing[name].append(alarming)
    along = (sets - designs.mean) @ designs.directions
    for name, phi in (
        ("k_of_n, memory as found", found.guarded),
        ("k_of_n, memory of the chart", designs.phi),
    ):
        freed = prewhiten_sets(along, 0.0, phi)
        fitted = fit_baseline(freed[:n][np.isfinite(freed[:n]).all(axis=1)], range(n), name=name)
        state, standing[name] = AlarmState(), []
        for distance in distance_squared(freed, fitted)[rows].tolist():
            beyond = distance > f_predictive_limit(fitted.n, p)
            state = update_alarm_state(state, beyond, AlarmRule(k=settings.alarms.k, n=settings.alarms.n))
            standing[name].append(state.active)
    return standing


def onsets(assessed_rows: Sequence[Any], stands: Sequence[bool]) -> list[float]:
    return [
        row.due_h
        for row, before, now in zip(assessed_rows, [False, *stands], stands, strict=False)
        if now and not before
    ]


def predictive_counts(outcomes: Sequence[Outcome], *, draws: int = 4000) -> tuple[int, int, float]:
    """Return central interval and mean of the pooled outlier count of healthy, independent, normal sets."""
    random = np.random.default_rng(20240101)
    p = len(FEATURE_NAMES)
    totals = np.zeros(draws, dtype=np.int64)
    for outcome in outcomes:
        limit = f_predictive_limit(outcome.n_baseline, p)
        for draw in range(draws):
            baseline = fit_baseline(
                random.standard_normal((outcome.n_baseline, p)), range(outcome.n_baseline), name="simulated"
            )
            sets = random.standard_normal((outcome.assessed_rows, p))
            totals[draw] += int(np.count_nonzero(distance_squared(sets, baseline) > limit))
    low, high = np.quantile(totals, [(1 - COVERAGE) / 2, (1 + COVERAGE) / 2], method="nearest")
    return int(low), int(high), float(totals.mean())


def all_runs(
    seeds: Sequence[int], scales: Sequence[float], hours: float, nuisance: str, why: bool, positions: str
) -> list[Run]:
    runs = [
        Run(position=position, seed=seed, scale=scale, drift=True, hours=hours, nuisance=nuisance, why=why)
        for scale in scales
        for seed in seeds
        for position in positions
    ]
    if nuisance != "none":
        return runs  # not even without the drift are sets independent and normal
    quiet = {"position": "D", "scale": 1.0, "drift": False, "hours": hours, "nuisance": nuisance}
    return runs + [Run(seed=seed, **quiet) for seed in seeds]


def by_rule(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the lines of all rules on the same records: first alarm, and how often it was raised."""
    lines = []
    for position in "BCD":
        runs = [one for one in outcomes if one.run.position == position and one.run.drift]
        raised = {
            rule: [o.raised_h[rule] for o in runs if o.run.scale == 1.0]
            for rule in (runs[0].raised_h if runs else ())
        }
        for rule, hours in raised.items():
            first = [its[0] for its in hours if its]
            # A run without an alarm is later than every other.
            middle = np.median([*first, *[np.inf] * (len(hours) - len(first))])
            median = f"median first alarm {middle:.1f} h, " if np.isfinite(middle) else ""
            lines.append(
                f"{position} by {rule}: {median}raised in {len(first)} of {len(hours)} runs, "
                f"{sum(map(len, hours))} times"
            )
    return lines


def describe(outcome: Outcome) -> str:
    run = outcome.run
    alarm = "no alarm" if outcome.first_alarm_h is None else f"alarm at {outcome.first_alarm_h:5.1f} h"
    depth = "" if outcome.depth_at_alarm is None else f", mean depth {100 * outcome.depth_at_alarm:4.1f} %"
    return (
        f"{run.position} seed {run.seed:2d} scatter x{run.scale:g} drift {'on ' if run.drift else 'off'}  "
        f"{alarm}{depth}; outliers {outcome.outliers} of {outcome.assessed_rows} "
        f"(paper's limit: {outcome.outliers_paper})"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description="Alarms and false alarms of the demo over seeds")
    parser.add_argument("--seeds", type=int, default=11, help="number of seeds, from 1")
    parser.add_argument(
        "--scales", type=float, nargs="+", default=[1.0, 2.0, 4.0], help="scales of the scatter"
    )
    parser.add_argument("--hours", type=float, default=350.0)
    parser.add_argument("--nuisance", default="none", help="level of nuisance of the twin")
    parser.add_argument("--why", action="store_true", help="also what charts designed otherwise would say")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--positions", default="BCD")
    parser.add_argument("--only-d", action="store_true", help="only D with the drift off")
    parser.add_argument("--table", type=Path, help="CSV file of losses at detection for `solimon pod`")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    runs = all_runs(
        range(1, options.seeds + 1),
        options.scales,
        options.hours,
        options.nuisance,
        options.why,
        options.positions,
    )
    if options.only_d:
        runs = [run for run in runs if not run.drift]
    outcomes = []
    with ProcessPoolExecutor(max_workers=options.jobs) as pool:
        for outcome in pool.map(assess_run, runs):
            outcomes.append(outcome)
            print(describe(outcome), file=sys.stderr, flush=True)
    if options.table:
        rows = [row for one in outcomes if one.run.drift and one.run.scale == 1.0 for row in one.losses]
        with options.table.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(("rule", "sensor", "loss_m", "detected"))
            writer.writerows((row["rule"], row["sensor"], row["loss_m"], int(row["signal"])) for row in rows)
    quiet = [outcome for outcome in outcomes if not outcome.run.drift]
    pooled = sum(outcome.outliers for outcome in quiet)
    low, high, mean = predictive_counts(quiet)
    late = [
        outcome
        for outcome in outcomes
        if outcome.run.position in "BC"
        and outcome.run.scale == 1.0
        and (outcome.depth_at_alarm is None or outcome.depth_at_alarm > DEEPEST_FIRST_ALARM)
    ]
    result = {
        "outcomes": [asdict(outcome) for outcome in outcomes],
        "late_alarms": len(late),
        "d_drift_off": {"pooled_outliers": pooled, "low": low, "high": high, "expected": mean},
    }
    if options.json:
        print(json.dumps(result))
    else:
        if quiet:
            print(
                f"D, drift off: {pooled} outliers in {sum(o.assessed_rows for o in quiet)} sets; "
                f"expected {mean:.1f}, central 99.5 %: {low}..{high}"
            )
        print("\n".join(by_rule(outcomes)))
        print(f"B and C: {len(late)} alarms later than at {DEEPEST_FIRST_ALARM:.0%} mean depth at scale 1")
    return int(bool(late) or (options.nuisance == "none" and not low <= pooled <= high))


if __name__ == "__main__":
    sys.exit(main())
