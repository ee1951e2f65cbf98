"""``solimon simulate``: one noise-free shot of the twin or of Zener's model, or a sweep."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import click
from pydantic import TypeAdapter

from daq_service.cli.sweep.shot import Specimen, compute_shot, compute_zener_impact, summarise_coupled_shot
from daq_service.cli.sweep.shot_warnings import find_shot_warnings, report_warnings, summarise_warnings
from daq_service.cli.sweep.specification import space_evenly
from daq_service.errors import UsageError
from daq_service.settings.file import load_settings
from daq_service.settings.tree import PositionSettings, Settings
from daq_service.shared_file import load_module_toml
from simulator.errors import SimulatorError

Numbers = dict[str, float | None]
"""Results and varied parameters of a shot by key; None for a missing result."""


@dataclass(frozen=True, slots=True)
class _Table:
    """Columns of a model's results, each a key, a title, a unit and a format, and a note below them."""

    columns: tuple[tuple[str, str, str, str], ...]
    note: str


TABLES = TypeAdapter(dict[str, _Table]).validate_python(load_module_toml(__file__))


def print_simulation(
    *,
    config: Path | None,
    model: Literal["coupled", "zener"],
    position: str | None,
    depth_fraction: float | None,
    drop_height_m: float | None,
    tilt_rad: float | None,
    depths: str | None,
    sweeps: tuple[str, ...],
    sweep_file: Path | None,
    strict: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Run `solimon simulate`: compute shots of the model and print them, or run a sweep.

    Raises
    ------
    UsageError
        The configuration or an option is invalid, the model cannot compute a shot, or with `strict`
        there are warnings; or as `print_sweep`, whose other errors are raised, too.
    """
    settings = load_settings(config)
    if model == "zener" and tilt_rad is not None:
        raise UsageError("--tilt-rad tilts the sensor disk, which --model zener does not have: leave it out")
    try:
        specimen = _build_specimen(settings, position, depth_fraction, drop_height_m, tilt_rad)
        grid = [specimen[2].depth_fraction] if depths is None else _parse_grid(depths)
        for depth in grid:
            replace(specimen[2], depth_fraction=depth)
    except ValueError as error:
        raise UsageError(str(error)) from error
    adc, place = settings.twin.adc, settings.positions[position] if position else None
    after_trigger_s = (adc.record_samples - adc.pretrigger_samples) / adc.sample_rate_hz
    if sweeps or sweep_file is not None or (depths is not None and options["outputs"]):
        from daq_service.cli.sweep.command import SweepRequest, print_sweep  # a single shot needs no tables

        fixed = {
            "corrosion.depth_fraction": depth_fraction,
            "chain.drop_height_m": drop_height_m,
            "chain.tilt_rad": tilt_rad,
        }
        request = SweepRequest(
            model=model,
            specimen=specimen,
            depths=depths,
            sweeps=sweeps,
            sweep_file=sweep_file,
            fixed_keys=frozenset(key for key, value in fixed.items() if value is not None),
            configuration_hash=settings.configuration_hash(),
            position=position,
            after_trigger_s=after_trigger_s,
            place=place,
            strict=strict,
            **options,
        )
        print_sweep(request, TABLES[model].columns, as_json=as_json)
        return
    if named := [name for name, value in options.items() if value]:
        option = {"outputs": "--out", "element_wise": "--zip"}.get(
            named[0], f"--{named[0].replace('_', '-')}"
        )
        raise UsageError(f"{option} belongs to a sweep: give --sweep KEY=VALUES, too")
    rows = _compute_shots(model, specimen, grid, is_table=depths is not None)
    found = [find_shot_warnings(specimen[0], row, after_trigger_s, place) for row in rows]
    if as_json:
        shots = [{**row, "warnings": texts} for row, texts in zip(rows, found, strict=True)]
        click.echo(json.dumps(shots[0] if depths is None else {"shots": shots}))
    else:
        _print_shot_table(rows, TABLES[model])
    report_warnings(summarise_warnings(found), strict=strict, as_json=as_json)


def _compute_shots(model: str, specimen: Specimen, grid: list[float], *, is_table: bool) -> list[Numbers]:
    """Compute one shot per depth of ``grid``; raise UsageError if one fails.

    Progress of a table goes to standard error on a terminal.
    """
    chain, plate, patch = specimen
    rows = []
    try:
        for number, depth in enumerate(grid, 1):
            rows.append(_compute_shot(model, (chain, plate, replace(patch, depth_fraction=depth))))
            if is_table and sys.stderr.isatty():
                click.echo(f"\r{number} of {len(grid)} depths", nl=number == len(grid), err=True)
    except SimulatorError as error:
        raise UsageError(str(error)) from error
    return rows


def _build_specimen(
    settings: Settings,
    position: str | None,
    depth_fraction: float | None,
    drop_height_m: float | None,
    tilt_rad: float | None,
) -> Specimen:
    """Return chain, plate and patch of a position, or of the test, with the options that are not None.

    Raises ValueError for an unknown position or an invalid value.
    """
    place: Settings | PositionSettings = settings
    if position is not None:
        if position not in settings.positions:
            raise ValueError(
                f"no position {position!r}; the configuration has {', '.join(settings.positions)}"
            )
        place = settings.positions[position]
    chain, patch = place.chain, place.corrosion
    chain = replace(
        chain,
        drop_height_m=chain.drop_height_m if drop_height_m is None else drop_height_m,
        tilt_rad=chain.tilt_rad if tilt_rad is None else tilt_rad,
    )
    if depth_fraction is not None:
        patch = replace(patch, depth_fraction=depth_fraction)
    return chain, place.plate, patch


def _parse_grid(text: str) -> list[float]:
    """Parse ``first:last:count`` to equally spaced values; raise ValueError for another form.

    The count is 1 to 10,000.
    """
    parts = text.split(":")
    try:
        first, last, count = float(parts[0]), float(parts[1]), int(parts[2])
    except (ValueError, IndexError) as error:
        raise ValueError(f"--depths is {text!r}; write first:last:count, for example 0:0.8:9") from error
    if len(parts) != 3 or not 1 <= count <= 10_000:
        raise ValueError(f"--depths is {text!r}; write first:last:count with 1 to 10000 depths")
    return space_evenly(first, last, count)


def _compute_shot(model: str, specimen: Specimen) -> Numbers:
    """Compute one shot, of chain and plate integrated together or by Zener's impact of the last sphere.

    Returns results and varied parameters by key; None for a missing result. Raises SimulatorError.
    """
    chain, _, patch = specimen
    given = {"depth_fraction": patch.depth_fraction, "drop_height_m": chain.drop_height_m}
    if model == "zener":
        return {**compute_zener_impact(*specimen), **given}
    return {
        **summarise_coupled_shot(specimen, compute_shot(*specimen)),
        **given,
        "tilt_rad": chain.tilt_rad,
    }


def _print_shot_table(rows: list[Numbers], table: _Table) -> None:
    """Print titles, units and rows of shots, "-" for missing values, and the model's note."""
    click.echo("  ".join(f"{title:>9}" for _, title, _, _ in table.columns))
    click.echo("  ".join(f"{f'({unit})' if unit else '(1)':>9}" for _, _, unit, _ in table.columns))
    for row in rows:
        cells = ("-" if row[key] is None else format(row[key], form) for key, _, _, form in table.columns)
        click.echo("  ".join(f"{cell:>9}" for cell in cells))
    click.echo(table.note)
