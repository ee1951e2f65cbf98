"""``solimon simulate --sweep``: parse the request, run the sweep, print its table."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import click

from daq_service.cli.sweep.keys import SECTIONS
from daq_service.cli.sweep.plan import Model, build_plan
from daq_service.cli.sweep.run import SweepOptions, run_sweep
from daq_service.cli.sweep.shot import NO_REFLECTION, OK, Specimen
from daq_service.cli.sweep.shot_warnings import find_shot_warnings, report_warnings, summarise_warnings
from daq_service.cli.sweep.specification import Axis, parse_axis, read_sweep_file
from daq_service.cli.sweep.table import SweepTable
from daq_service.errors import UsageError
from daq_service.processes.child import stop_on_signals
from daq_service.processes.executors import count_usable_cores, validate_executor_name
from daq_service.settings.tree import PositionSettings

ROWS_FOR_PROCESSES = {"coupled": 1000, "zener": 150}
"""Fewer rows are done by threads before processes have started (`python benchmarks/sweep_speed.py`)."""

DEPTH_KEY = "corrosion.depth_fraction"

Columns = Sequence[tuple[str, str, str, str]]
"""Key, title, unit and format of each printed result."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepRequest:
    """A sweep as the command line asks for it.

    Attributes
    ----------
    specimen
        Parameters that are not swept, options laid over them.
    fixed_keys
        Those of them that an option gives.
    after_trigger_s
        Length of a record after its trigger, for warnings.
    place
        The position, whose ``waves`` keys count for the warnings; None: there is none.
    strict
        Make warnings errors.
    """

    model: Model
    specimen: Specimen
    depths: str | None
    sweeps: tuple[str, ...]
    sweep_file: Path | None
    fixed_keys: frozenset[str]
    configuration_hash: str
    position: str | None
    after_trigger_s: float
    place: PositionSettings | None
    strict: bool
    element_wise: bool
    skip_invalid: bool
    outputs: tuple[Path, ...]
    waveforms: bool
    workers: int | None
    executor: str | None
    overwrite: bool


def print_sweep(request: SweepRequest, columns: Columns, *, as_json: bool) -> None:
    """Run a sweep of the model and print its table, or the path to which it was written.

    Raises
    ------
    UsageError
        Axes, options or outputs are invalid; a combination is refused; with `strict`, there are warnings.
    StorageError
        The disk refuses, or the work file is of another sweep.
    BusyError
        The same sweep is running.
    SolimonError
        Workers were lost repeatedly.
    KeyboardInterrupt
        A signal stopped it; finished rows are kept.
    """
    if request.waveforms and request.model == "zener":
        raise UsageError("--waveforms: Zener's model has none; leave it out")
    plan = build_plan(
        request.model,
        request.specimen,
        _read_axes(request),
        element_wise=request.element_wise or request.sweep_file is not None,
        skip_invalid=request.skip_invalid,
        waveforms=request.waveforms,
    )
    if request.executor is not None:
        validate_executor_name(request.executor, request.workers)
    workers = count_usable_cores() if request.workers is None else request.workers
    long = len(plan.rows) >= ROWS_FOR_PROCESSES[request.model]
    options = SweepOptions(
        outputs=request.outputs,
        workers=workers,
        executor=request.executor or ("processes" if long and workers > 1 else "threads"),
        skip_invalid=request.skip_invalid,
        overwrite=request.overwrite,
    )
    chain, plate, corrosion = request.specimen
    origin = {
        "specification": _describe_sweep(request),
        "configuration_hash": request.configuration_hash,
        "position": request.position or "",
        "parameters": dict(zip(SECTIONS, (asdict(chain), asdict(plate), asdict(corrosion)), strict=True)),
    }
    with stop_on_signals() as stop:
        table = run_sweep(plan, options, origin, stop)
    results = zip(*(values.tolist() for values in table.results.values()), strict=True)
    found = [
        find_shot_warnings(
            row.specimen[0],
            dict(zip(table.results, numbers, strict=True)),
            request.after_trigger_s,
            request.place,
        )
        for row, numbers, status in zip(plan.rows, results, table.status, strict=True)
        if row.specimen is not None and status in (OK, NO_REFLECTION)
    ]
    warnings = summarise_warnings(found)
    _print_results(table, request.outputs, columns, warnings if as_json else None)
    report_warnings(warnings, strict=request.strict, as_json=as_json)


def _read_axes(request: SweepRequest) -> list[Axis]:
    """Return the axes of a sweep from its file or its options.

    Raises UsageError if both are given, one is invalid, or a swept key is also an option.
    """
    if request.sweep_file is not None:
        if request.sweeps or request.depths is not None:
            raise UsageError("--sweep-file holds every shot: give it without --sweep and --depths")
        axes = list(read_sweep_file(request.sweep_file))
    else:
        axes = [parse_axis(text) for text in _describe_sweep(request) if text != "--zip"]
    if both := [axis.key for axis in axes if axis.key in request.fixed_keys]:
        raise UsageError(f"{both[0]} is swept and given as an option; leave one out")
    return axes


def _describe_sweep(request: SweepRequest) -> list[str]:
    """Return the specification of a sweep as its arguments, with file names instead of paths."""
    shorthand = [] if request.depths is None else [f"{DEPTH_KEY}={request.depths}"]
    rows = [] if request.sweep_file is None else [f"--sweep-file {request.sweep_file.name}"]
    return [*shorthand, *request.sweeps, *rows, *(["--zip"] if request.element_wise else [])]


def _print_results(
    table: SweepTable, outputs: Sequence[Path], columns: Columns, json_warnings: Sequence[str] | None
) -> None:
    """Print the table with the number of failed rows and the content hash.

    With ``json_warnings``, print these, facts and rows as JSON. Rows are not printed if they were written to
    files.
    """
    if json_warnings is not None:
        shots = {} if outputs else {"shots": table.rows()}
        click.echo(
            json.dumps(
                {
                    **table.facts,
                    "warnings": json_warnings,
                    "outputs": [str(path) for path in outputs],
                    **shots,
                }
            )
        )
        return
    if not outputs:
        _print_rows(table, columns)
    if failed := len(table.status) - table.status.count(OK):
        click.echo(f"{failed} of {len(table.status)} rows are not ok: see their status")
    for path in outputs:
        click.echo(f"wrote {path}")
    click.echo(f"content hash {table.facts['content_hash']}")


def _print_rows(table: SweepTable, columns: Columns) -> None:
    """Print swept keys, the model's main results and the status of each row in columns; "-" for NaN."""
    printed = {key: [key, *(str(value) for value in values)] for key, values in table.swept.items()}
    for key, title, unit, form in columns:
        if key in table.results:
            heading = f"{title} ({unit})" if unit else title
            numbers = table.results[key].tolist()
            printed[key] = [heading, *("-" if math.isnan(x) else format(x, form) for x in numbers)]
    widths = [max(len(cell) for cell in cells) for cells in printed.values()]
    for *cells, status in zip(*printed.values(), ["status", *table.status], strict=True):
        padded = [f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True)]
        click.echo("  ".join([*padded, status]))
