"""``solimon wall``: wall thickness with 90 % intervals from tables of features, one transducer per table."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import click
import numpy as np

from analysis.errors import InvalidInputError, SingularCovarianceError
from analysis.wall import posterior
from analysis.wall.bank import ESTIMAND, FEATURES, Bank
from analysis.wall.calibration import calibrate
from analysis.wall.thickness import Pool, WallModel, WallThickness, estimate_thickness
from daq_service.assessment.wall_bank import build_bank, list_bank_arguments, open_bank, store_bank
from daq_service.cli.offline.table_file import TableFile, read_table
from daq_service.errors import UsageError
from daq_service.settings.file import load_settings
from daq_service.settings.tree import Settings
from hardware_drivers.methods import SOLITARY_WAVE
from simulator.errors import SimulatorError

HOUR = "due_h"
"""Column of a table with the hour of the test."""
S_PER_H, S_PER_YEAR = 3600.0, 31_557_600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Wall:
    """Result of a table; without rows it is refused."""

    file: str
    position: str
    refused: str | None = None
    rows: list[tuple[float, WallThickness]] = field(default_factory=list)


def run_wall(
    *,
    config: Path,
    tables: tuple[Path, ...],
    position: str | None,
    baseline_hours: float | None,
    minimum_m: float | None,
    as_json: bool,
) -> None:
    """Run `solimon wall`: print the wall thickness after each set of the tables.

    Parameters
    ----------
    position
        Whose chain and plate are meant; None: the first transducer of the configuration.
    baseline_hours
        End of the baseline; None: `baseline.hours`.
    minimum_m
        Minimum wall, below the thickness of the plate; None: no probability and date.

    Raises
    ------
    UsageError
        An invalid configuration or option, a missing file or column, or a chain that cannot be simulated.
    """
    settings = load_settings(config)
    name = _choose_position(settings, position)
    place = settings.positions[name]
    end_h = settings.baseline.hours if baseline_hours is None else baseline_hours
    if minimum_m is not None and minimum_m >= place.plate.thickness_m:
        raise UsageError(
            f"a minimum wall of {minimum_m} m must be below plate.thickness_m = {place.plate.thickness_m} m"
        )
    kind = list_bank_arguments(place)
    bank = open_bank(*kind)
    if bank is None:
        try:
            bank = build_bank(*kind, progress=_print_progress)
        except (SimulatorError, InvalidInputError) as error:
            raise UsageError(f"no wall curves for the chain and plate of {name}: {error}") from error
        store_bank(bank)
    changes = posterior.predict_changes(bank)
    results = []
    for path in tables:
        table = read_table(path, features=(HOUR, *FEATURES), baseline_rows=1, baseline_where=None)
        try:
            rows = list(_estimate_rows(table, bank, changes, end_h, minimum_m))
            results.append(Wall(file=str(path), position=name, rows=rows))
        except (InvalidInputError, SingularCovarianceError) as error:
            results.append(Wall(file=str(path), position=name, refused=str(error)))
    if as_json:
        found = [
            {**asdict(one), "rows": [{"hour": hour, **asdict(row)} for hour, row in one.rows]}
            for one in results
        ]
        answer = {"estimand": ESTIMAND, "initial_thickness_m": bank.thickness_m, "tables": found}
        click.echo(json.dumps(answer, allow_nan=False))
        return
    click.echo(f"wall thickness, {ESTIMAND}; 90 % intervals")
    for one in results:
        click.echo("\n".join(_describe(one, bank.thickness_m)))


def _choose_position(settings: Settings, position: str | None) -> str:
    """Return the position, or the first with a transducer; raise UsageError if there is none."""
    names = [name for name, place in settings.positions.items() if place.method == SOLITARY_WAVE]
    if position is None and names:
        return names[0]
    if position not in names:
        raise UsageError(f"--position {position!r} is none of the transducers {', '.join(names) or '(none)'}")
    return position


def _print_progress(done: int, total: int, name: str) -> None:
    """Print on standard error which curve of the bank is simulated."""
    click.echo(f"simulating wall curves, once for this chain and plate: {done} of {total} ({name})", err=True)


def _estimate_rows(
    table: TableFile, bank: Bank, changes: np.ndarray, end_h: float, minimum_m: float | None
) -> Iterator[tuple[float, WallThickness]]:
    """Yield the wall thickness after each set that follows the baseline.

    Raises InvalidInputError for a baseline that cannot be used, or without sets after it.
    """
    hours = table.vectors[:, 0]
    if not np.isfinite(hours).all() or np.any(np.diff(hours) < 0.0):
        raise InvalidInputError(f"{HOUR} must be there in each row, and rise; sort the table")
    positive = np.where(table.vectors[:, 1:] > 0.0, table.vectors[:, 1:], math.nan)
    logs, is_baseline = np.log(positive), hours <= end_h
    calibration = calibrate(bank, logs[is_baseline])
    if is_baseline.all():
        raise InvalidInputError(f"no set follows the baseline, which ends at hour {end_h:g}")
    state = posterior.begin(len(changes), end_h)
    hypotheses = posterior.compare(calibration, changes)
    model = WallModel(
        hypotheses=hypotheses,
        curves=posterior.list_curves(bank),
        initial_m=bank.thickness_m,
        baseline_h=float(hours[is_baseline].mean()),
        minimum_m=minimum_m,
    )
    pool = Pool()
    for hour, row in zip(hours[~is_baseline].tolist(), logs[~is_baseline], strict=True):
        state, pool, found = estimate_thickness(model, state, pool, row, hour)
        if found is not None:
            yield hour, found


def _describe(one: Wall, initial_m: float) -> list[str]:
    """Return the lines of a table: a row per set, or why it is refused."""
    if one.refused is not None:
        return [f"{one.file}: refused, {one.refused}"]
    lines = [f"{one.file} (position {one.position}, {1e3 * initial_m:.2f} mm at the baseline)"]
    for hour, row in one.rows:
        text = f"  hour {hour:8.1f}  "
        interval_m = row.interval_low_m, row.interval_high_m
        if row.thickness_m is None or row.loss_rate_m_per_s is None:
            lines.append(text + row.reason)
            continue
        low_mm, high_mm = (1e3 * (value or 0.0) for value in interval_m)
        text += f"{1e3 * row.thickness_m:6.2f} mm ({low_mm:.2f} to {high_mm:.2f})"
        text += f", {1e3 * S_PER_YEAR * row.loss_rate_m_per_s:.2g} mm per year"
        if row.below_minimum_probability is not None:
            left_s = row.time_to_minimum_s
            at = "not reached" if left_s is None else f"in {left_s / S_PER_H:.0f} h"
            text += f", below the minimum: {row.below_minimum_probability:.0%}, {at}"
        lines.append(text)
    return lines
