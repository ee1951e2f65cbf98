"""Read what each sensor detected, at which true wall loss, from data folders of tests and from tables."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import click
import numpy as np
from pydantic import ValidationError

from analysis.diagnosis.hypotheses import WALL
from analysis.statistics.rules import AlarmRule, AlarmState, update_alarm_state
from analysis.waves.record_reduction import FloatArray
from daq_service.assessment.wall_bank import compute_mean_loss
from daq_service.catalogue import Catalogue, open_catalogue
from daq_service.catalogue.errors import NoDataYetError
from daq_service.catalogue.rows import AlarmRow, AssessmentRow
from daq_service.cli.offline.table_file import Column, convert_to_numbers, read_columns
from daq_service.errors import UsageError
from daq_service.settings.stored import restore_settings
from daq_service.settings.tree import Settings
from hardware_drivers.methods import SOLITARY_WAVE
from simulator.experiment.corrosion import draw_wall_history, make_patch
from simulator.parameters.experiment import ThinningParameters

SMALLEST_LOSS_M = 1e-9
"""A wall that lost less is sound: an alarm then is a false one."""
LARGEST_LOSS_M = 0.1
"""The thickest plate of a configuration."""
ONE_SET = "one set (signal)"
"""Rule of the signals: each set alone is compared with the threshold."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Result of a sensor under a rule, at a sound wall (loss 0) or at a loss.

    Attributes
    ----------
    loss_m
        True loss: at the first detection, without one the largest of the sensor; of `ONE_SET` at the set.
    signal
        Relative to the threshold of a detection; of other rules 1 if detected, else 0.
    """

    rule: str
    sensor: str
    loss_m: float
    signal: float


def read_runs(runs: Sequence[Path], position: str | None, threshold: float | None) -> list[Result]:
    """Read the results of data folders and tables.

    Parameters
    ----------
    position
        Only this position of data folders; None: all transducers.
    threshold
        Smallest signal of tables that is a detection; None: the tables have no signals.

    Raises
    ------
    UsageError
        A run cannot be read, repeats another one, lacks the true loss, or has a value in another unit.
    """
    found: list[Result] = []
    folder_of: dict[int, Path] = {}
    for path in runs:
        if not path.is_dir():
            found += _read_table(path, threshold)
            continue
        click.echo(f"reading {path}", err=True)
        try:
            with open_catalogue(path) as catalogue:
                settings = restore_settings(catalogue.read_experiment().configuration)
                seed = settings.twin.seed
                if not settings.rig.on_twin:
                    raise UsageError(
                        f"{path} has no true loss (a real rig): give a .csv file of measured ones"
                    )
                if folder_of.setdefault(seed, path) != path or runs.count(path) > 1:
                    raise UsageError(f"{path} repeats seed {seed} of {folder_of[seed]}: take another")
                found += _read_test(path, catalogue, settings, position)
        except (NoDataYetError, ValidationError) as error:
            raise UsageError(
                f"{path} holds no test that this version can read; give another folder"
            ) from error
    return found


def _read_test(
    folder: Path, catalogue: Catalogue, settings: Settings, position: str | None
) -> Iterator[Result]:
    """Yield the results of a test; positions without assessed sets have none."""
    for name, place in settings.positions.items():
        if place.method != SOLITARY_WAVE or position not in (None, name):
            continue
        rows = [row for row in catalogue.rows(AssessmentRow, position=name) if row.unscheduled_index == 0]
        rows.sort(key=lambda row: row.due_h)
        assessed = [row for row in rows if row.outlier is not None and not row.in_baseline]
        if not assessed:
            click.echo(f"{folder}: position {name} has no assessed set and is left out", err=True)
            continue
        alarms = catalogue.rows(AlarmRow, position=name)
        raised_h = sorted(row.raised_h for row in alarms if row.alarm_class == "damage")
        due_h = [row.due_h for row in assessed]
        loss_m = compute_losses(settings, name, due_h, [row.due_h for row in rows if row.in_baseline])
        rule = AlarmRule(k=settings.alarms.k, n=settings.alarms.n)
        onsets = find_onsets(assessed, rule) | {"alarm of the service": raised_h}
        for text, onset_h in onsets.items():
            at_onset = np.interp(onset_h, due_h, loss_m)
            yield from summarize_sensor(text, f"{folder}:{name}", loss_m, at_onset)
        for row, loss in zip(assessed, loss_m.tolist(), strict=True):
            if row.distance_squared and row.limit_f_predictive:
                signal = float(np.sqrt(row.distance_squared / row.limit_f_predictive))
                yield Result(rule=ONE_SET, sensor=f"{folder}:{name}", loss_m=loss, signal=signal)


def compute_losses(
    settings: Settings, position: str, hours: Sequence[float], baseline_h: Sequence[float]
) -> FloatArray:
    """Return the true losses of the twin in m, as the estimand, since the mean of the baseline."""
    place, twin = settings.positions[position], settings.twin
    unit_m = place.plate.thickness_m * compute_mean_loss(make_patch(twin, position, place.corrosion))
    thinning = twin.thinning.get(position, ThinningParameters())
    law = draw_wall_history(thinning, seed=twin.seed, position=position)
    after, before = ([law.at(hour).patch_depth_fraction for hour in at_h] for at_h in (hours, baseline_h))
    return np.asarray(unit_m * (np.array(after) - np.mean(before)))


def find_onsets(assessed: Sequence[AssessmentRow], rule: AlarmRule) -> dict[str, list[float]]:
    """Return the hours at which each rule starts to hold: control chart, k of n sets, diagnosis WALL."""
    states = [AlarmState()]
    for row in assessed:
        states.append(update_alarm_state(states[-1], row.outlier, rule))
    active: dict[str, list[bool]] = {
        "control chart": [row.mewma_alarm is True for row in assessed],
        f"{rule.k} of {rule.n} sets": [state.active for state in states[1:]],
        "diagnosis WALL": [row.diagnosis == WALL for row in assessed],
    }
    due_h = np.array([row.due_h for row in assessed])
    return {name: due_h[np.diff([0, *flags]) > 0].tolist() for name, flags in active.items()}


def summarize_sensor(rule: str, sensor: str, loss_m: FloatArray, at_onset_m: FloatArray) -> Iterator[Result]:
    """Yield the results of a sensor: at its sound wall, and at its first detection of a loss.

    A sensor with a false alarm and no later onset has no second result: its alarm hides the detection.

    Parameters
    ----------
    loss_m, at_onset_m
        True loss at each assessed set, and at each onset of the rule.
    """
    is_false = bool(np.any(at_onset_m < SMALLEST_LOSS_M))
    detections, largest_m = at_onset_m[at_onset_m >= SMALLEST_LOSS_M], float(loss_m.max())
    result = partial(Result, rule=rule, sensor=sensor)
    if is_false or np.any(loss_m < SMALLEST_LOSS_M):
        yield result(loss_m=0.0, signal=float(is_false))
    if detections.size:
        yield result(loss_m=float(detections[0]), signal=1.0)
    elif largest_m >= SMALLEST_LOSS_M and not is_false:
        yield result(loss_m=largest_m, signal=0.0)


def _read_table(path: Path, threshold: float | None) -> Iterator[Result]:
    """Yield the rows of a table with the columns sensor, loss_m, and detected or a_hat; rule is optional.

    Raises UsageError for a missing column, a value that is none, or a loss in another unit.
    """
    columns, decimal = read_columns(path)
    if not {"sensor", "loss_m"} <= columns.keys() or ("detected" in columns) == ("a_hat" in columns):
        names = ", ".join(columns)
        raise UsageError(f"{path} needs sensor, loss_m, and detected or a_hat; it has {names}")
    losses = _read_numbers(path, "loss_m", columns["loss_m"], decimal)
    for row, loss in enumerate(losses):
        if not 0.0 <= loss <= LARGEST_LOSS_M:
            remedy = f"0 to {LARGEST_LOSS_M} m. Did you mean {1e-3 * abs(loss):g}?"
            raise UsageError(f"{path}: loss_m = {loss:g} in row {row} is outside {remedy}")
    if "a_hat" in columns:
        if threshold is None:
            raise UsageError(f"{path}: give --threshold, the smallest a_hat that is a detection")
        signals = [value / threshold for value in _read_numbers(path, "a_hat", columns["a_hat"], decimal)]
        rules: Column = [ONE_SET] * len(losses)
    else:
        signals = _read_numbers(path, "detected", columns["detected"], decimal)
        rules = columns.get("rule", ["table"] * len(losses))
        if not set(signals) <= {0.0, 1.0}:
            raise UsageError(f"{path}: detected = {max(signals):g} is neither 0 nor 1")
    for rule, sensor, loss, signal in zip(rules, columns["sensor"], losses, signals, strict=True):
        yield Result(rule=str(rule), sensor=str(sensor), loss_m=loss, signal=signal)


def _read_numbers(path: Path, name: str, column: Column, decimal: str) -> list[float]:
    """Return a column as finite numbers; raise UsageError that names the row without one."""
    numbers = convert_to_numbers(column, decimal)
    bad = [0] if numbers is None else np.flatnonzero(~np.isfinite(numbers)).tolist()
    if numbers is None or bad:
        raise UsageError(f"{path}: {name} = {str(column[bad[0]])!r} in row {bad[0]} is no number")
    return [float(number) for number in numbers]
