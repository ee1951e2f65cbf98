"""Run `solimon design`: rank arrays of spheres by what a set of their shots knows about the wall."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import click
import numpy as np
import tomlkit

from analysis.wall.array_design import find_detectable_loss
from analysis.wall.bank import ESTIMAND
from daq_service.cli.offline.csv_lines import finite_or_none
from daq_service.cli.offline.design.candidates import list_chains
from daq_service.cli.offline.design.information import (
    DEPTHS,
    Design,
    Site,
    build_site,
    confirm_design,
    predict_design,
    simulate_design,
)
from daq_service.errors import UsageError
from daq_service.processes.installation import require_extras
from daq_service.settings.file import load_settings
from daq_service.settings.tables import flatten, nest_tables
from daq_service.settings.tree import PositionSettings, Settings
from hardware_drivers.methods import SOLITARY_WAVE
from simulator.errors import SimulatorError

CONFIGURED = "configured"
NUMBERS = ("pressure_pa", "yield_ratio", "inelasticity", "amplitude_ratio", "predicted_slope")


def run_design(
    *,
    config: Path | None,
    position: str | None,
    sweeps: tuple[str, ...],
    largest_pressure_pa: float | None,
    n_simulated: int,
    n_confirmed: int,
    seeds: int,
    figure: Path | None,
    output: Path | None,
    as_json: bool,
    **changes: object,
) -> None:
    """Run `solimon design`: print what arrays know about the wall, the best one first.

    Parameters
    ----------
    position
        Whose chain, plate and patch are meant; None: the first transducer.
    sweeps
        What is varied, as `candidates.list_chains`.
    largest_pressure_pa
        Bound of the peak pressure at the plate; None: that of the configured array.
    n_simulated, n_confirmed
        How many arrays are simulated, the best by the law, and how many of these confirmed.
    seeds
        Number of seeds of each confirmation, from the configured one on.
    figure, output
        Files for a figure, and for the best array as a configuration.
    changes
        Options of `load_site`.

    Raises
    ------
    UsageError
        An invalid configuration or option, or a configured array that cannot be simulated.
    """
    if figure is not None:
        require_extras("report")
        if figure.suffix.lower() not in (".svg", ".png"):
            raise UsageError(f"--figure {figure}: give a file that ends in .svg or .png")
    site = load_site(config, position, **changes)  # type: ignore[arg-type] # as click converts them
    chain = site.settings.positions[site.position].chain
    ranked = [predict_design(site, *item) for item in list_chains(chain, sweeps).items()]
    ranked.sort(key=lambda one: (bool(one.refused), one.predicted_slope))
    now = simulate_design(site, predict_design(site, CONFIGURED, chain))
    bound_pa = largest_pressure_pa or now.pressure_pa
    if not math.isfinite(bound_pa):
        raise UsageError(f"the configured array: {'; '.join(now.refused)}. Give --max-pressure-pa")
    simulated = []
    for number, one in enumerate(ranked[:n_simulated], 1):
        click.echo(f"array {number} of {min(n_simulated, len(ranked))}: {one.name}", err=True)
        simulated.append(one if one.refused else simulate_design(site, one, bound_pa))
    designs = _confirm(site, [now, *sorted(simulated, key=_rank)], n_confirmed, seeds)
    _write_files(site, designs, bound_pa, figure, output)
    if as_json:
        answer = {"estimand": ESTIMAND, "largest_pressure_pa": bound_pa, "depth_fractions": DEPTHS}
        rows = [_to_json(site, one) for one in designs]
        rest = [one.name for one in ranked[n_simulated:]]
        click.echo(json.dumps(answer | {"designs": rows, "not_simulated": rest}, allow_nan=False))
    else:
        click.echo("\n".join(_describe(site, designs, bound_pa, len(ranked) - len(simulated))))


def _write_files(
    site: Site, designs: Sequence[Design], bound_pa: float, figure: Path | None, output: Path | None
) -> None:
    """Write figure and configuration if asked for; raise UsageError if no array is within the limits."""
    if figure is not None:
        from daq_service.cli.offline.design.figure import draw_designs

        title = f"{_describe_site(site)}\nloss: {ESTIMAND}"
        figure.write_bytes(draw_designs(designs, bound_pa, title, figure.suffix[1:].lower()))
    if output is not None:
        best = min(designs[1:], key=_rank)
        if best.refused:
            raise UsageError(f"no array is within the limits: {output} is not written")
        output.write_text(format_configuration(site, best), encoding="utf-8")


def load_site(
    config: Path | None,
    position: str | None = None,
    *,
    thickness_m: float | None = None,
    patch_m: float | None = None,
    level: str | None = None,
) -> Site:
    """Load a configuration with another plate, patch or level, and build the site of a position.

    Raise UsageError if one is invalid or cannot be simulated.
    """
    settings = load_settings(config)
    names = settings.list_positions(SOLITARY_WAVE)
    name = names[0] if position is None and names else position
    if name not in names:
        raise UsageError(f"--position {name!r} is none of the transducers {', '.join(names) or '(none)'}")
    place = {
        "plate": _drop_empty({"thickness_m": thickness_m}),
        "corrosion": _drop_empty({"size_m": patch_m}),
    }
    overrides = {"positions": {name: place}, "twin": _drop_empty({"nuisance": level})}
    try:
        return build_site(load_settings(config, overrides=overrides), str(name))
    except SimulatorError as error:
        raise UsageError(str(error)) from error


def _confirm(site: Site, designs: Sequence[Design], n_confirmed: int, n_seeds: int) -> list[Design]:
    """Confirm the first design, which is configured, and the first usable ones of the others; rank these."""
    found, first = [], site.settings.twin.seed
    left = n_confirmed + 1 if n_confirmed else 0
    for design in designs:
        one = design
        if left and (not one.refused or one.name == CONFIGURED):
            click.echo(f"sets of {one.name}", err=True)
            one = confirm_design(site, design, range(first, first + n_seeds))
            left -= not one.refused or one.name == CONFIGURED
        found.append(one)
    return [found[0], *sorted(found[1:], key=_rank)]


def _rank(design: Design) -> tuple[bool, bool, float]:
    """Return the key of an order: usable ones first, then confirmed ones, by the d' at the larger loss."""
    distance = (design.confirmed or design.distances)[1]
    return bool(design.refused), design.confirmed is None, -distance if math.isfinite(distance) else 0.0


def format_configuration(site: Site, design: Design) -> str:
    """Format an array as a configuration of one position: the keys that differ from the defaults."""
    place = site.settings.positions[site.position]
    own = place.model_copy(update={"chain": design.chain, "label": f"Array: {design.name}"})
    changes = {"twin": design.twin, "positions": {site.position: own}}
    usual = {"positions": {site.position: PositionSettings(method=SOLITARY_WAVE)}}
    values, defaults = (
        flatten(settings.model_copy(update=update).model_dump(mode="json", exclude_none=True))
        for settings, update in ((site.settings, changes), (Settings(), usual))
    )
    different = {path: value for path, value in values.items() if defaults.get(path) != value}
    different[("positions", site.position, "method")] = SOLITARY_WAVE
    text = tomlkit.dumps(nest_tables(different))
    return (
        f"# Written by solimon design. [twin.adc] and [twin.sensor] fit record and gain to the waves.\n{text}"
    )


def _drop_empty(table: Mapping[str, object]) -> dict[str, object]:
    """Return a table without empty tables and None."""
    return {key: value for key, value in table.items() if value not in ({}, None)}


def _to_json(site: Site, design: Design) -> dict[str, object]:
    """Return an array for JSON; null for what is not known or infinite."""
    numbers = {name: getattr(design, name) for name in NUMBERS}
    numbers["loss_sd_m"], numbers["detectable_loss_m"] = compute_losses_m(site, design)
    return {
        "name": design.name,
        **{key: finite_or_none(value) for key, value in numbers.items()},
        "distances": list(map(finite_or_none, design.distances)),
        "confirmed_distances": design.confirmed,
        "refused": design.refused,
        "chain": asdict(design.chain),
    }


def compute_losses_m(site: Site, design: Design) -> tuple[float, float]:
    """Return the SD of the loss from one set, and the loss that one set detects at the alarm's budget, in m.

    The SD holds at a loss of 10 % of the wall, for a patch of known size. NaN: not simulated; infinity: not
    detected. A confirmed d' scales those at the other losses.
    """
    distances = np.array(design.distances)
    if design.confirmed is not None:
        distances *= design.confirmed[1] / distances[1]
    seen = np.isfinite(distances)
    detectable_m = find_detectable_loss(site.loss_m[seen], distances[seen], site.required_distance)
    return float(site.loss_m[1] / distances[1]), detectable_m if seen.any() else math.nan


def _describe_site(site: Site) -> str:
    """Return plate, patch and level in one line."""
    plate_mm, patch_mm = 1e3 * site.plate.thickness_m, 1e3 * site.corrosion.size_m
    level = site.settings.twin.nuisance
    return f"plate of {plate_mm:.4g} mm, {site.corrosion.shape} patch of {patch_mm:.4g} mm, level {level}"


def _describe(site: Site, designs: Sequence[Design], bound_pa: float, n_others: int) -> Iterator[str]:
    """Yield the lines of the table: usable arrays, then why each of the others is refused."""
    yield f"{_describe_site(site)}; peak pressure at the plate at most {1e-9 * bound_pa:.2f} GPa"
    yield f"{n_others} arrays of less change by the law are not simulated; loss: {ESTIMAND}"
    width = max(len(one.name) for one in designs)
    heads = ("GPa", "yield", "lambda", "AR", "d' 5 %", "d' 10 %", "sets 5 %", "sets 10 %", "SD mm", "det. mm")
    yield "array".ljust(width) + "".join(map("{:>10}".format, heads))
    for one in designs:
        if one.refused and one.name != CONFIGURED:
            continue
        pressure_pa, *waves = (getattr(one, name) for name in NUMBERS[:4])
        losses_mm = (1e3 * loss_m for loss_m in compute_losses_m(site, one))
        sets = one.confirmed or (math.nan, math.nan)
        numbers = (1e-9 * pressure_pa, *waves, *one.distances[:2], *sets, *losses_mm)
        cells = (f"{number:.2f}" if math.isfinite(number) else "-" for number in numbers)
        yield one.name.ljust(width) + "".join(map("{:>10}".format, cells))
    yield from (f"{one.name}: refused, {'; '.join(one.refused)}" for one in designs if one.refused)
