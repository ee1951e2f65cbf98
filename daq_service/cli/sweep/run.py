"""Run a sweep from its plan to its files."""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from daq_service.cli.sweep.execution import compute_plan_rows
from daq_service.cli.sweep.outputs import check_outputs, list_output_files, write_output
from daq_service.cli.sweep.plan import Plan, Row, describe_row
from daq_service.cli.sweep.progress import Progress
from daq_service.cli.sweep.shot import INVALID, RESULTS, Outcome
from daq_service.cli.sweep.table import SweepTable, build_sweep_table
from daq_service.cli.sweep.work_file import WorkFile, build_work_file_path, is_work_file_of, open_work_file
from daq_service.errors import StorageError, UsageError
from daq_service.processes.executors import count_workers, open_executor
from daq_service.shared_file import retry


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepOptions:
    """Options of the execution; none of them changes a number."""

    outputs: tuple[Path, ...] = ()
    workers: int = 1
    executor: str = "processes"
    skip_invalid: bool = False
    overwrite: bool = False


def run_sweep(
    plan: Plan, options: SweepOptions, origin: Mapping[str, object], stop: threading.Event
) -> SweepTable:
    """Compute unfinished rows, write the outputs, remove the work file, and return the table.

    Without outputs nothing is written. ``origin`` goes to the facts of the table.

    Raises
    ------
    UsageError
        An output is invalid or exists, or parameters of a row cannot go together.
    StorageError
        A disk that refuses, or a work file of another sweep.
    BusyError
        The same sweep is running.
    SolimonError
        Workers were lost repeatedly.
    KeyboardInterrupt
        `stop` was set before the end; finished rows are kept in the work file.
    """
    check_outputs(options.outputs, waveforms=plan.waveforms)
    path = build_work_file_path(options.outputs[0]) if options.outputs else None
    _refuse_to_overwrite(plan, options, path)
    with contextlib.ExitStack() as stack:
        work = None if path is None else stack.enter_context(open_work_file(path, plan))
        outcomes = _compute_outcomes(plan, options, work, stop)
        table = build_sweep_table(plan, outcomes, origin)
        for output in options.outputs:
            write_output(output, table)
    if path is not None:
        _remove_work_file(path)
    return table


def _refuse_to_overwrite(plan: Plan, options: SweepOptions, work: Path | None) -> None:
    """Raise UsageError for existing outputs, unless an interrupted run of this sweep wrote them.

    Its work file ``work`` shows that. Nothing is refused with ``overwrite`` in the options.
    """
    if options.overwrite or (work is not None and is_work_file_of(work, plan)):
        return
    for output in options.outputs:
        for file in list_output_files(output):
            if file.exists():
                raise UsageError(f"{file} exists; remove it, choose another --out, or give --overwrite")


def _compute_outcomes(
    plan: Plan, options: SweepOptions, work: WorkFile | None, stop: threading.Event
) -> list[Outcome]:
    """Return the outcome of each row in order: refused, finished earlier, or computed now.

    New outcomes are stored at once. Raises UsageError for an invalid row, KeyboardInterrupt if stopped,
    StorageError if they cannot be stored, SolimonError if workers are lost.
    """
    outcomes = {row.index: _build_refused_outcome(plan, row) for row in plan.rows if row.specimen is None}
    if work is not None:
        outcomes |= work.finished
    _refuse_invalid_outcomes(plan, options, list(outcomes.values()))
    progress = Progress(len(plan.rows), len(outcomes))

    def keep_outcome(new: Sequence[Outcome]) -> None:
        """Store new outcomes and count them; raise UsageError if one is invalid and not to be skipped.

        Raises StorageError if they cannot be stored.
        """
        if work is not None:
            work.keep(new)
        outcomes.update((outcome.index, outcome) for outcome in new)
        progress.advance(len(new))
        _refuse_invalid_outcomes(plan, options, new)

    missing = [row for row in plan.rows if row.index not in outcomes]
    if missing:
        with open_executor(options.executor, options.workers) as executor:
            workers = count_workers(executor, options.workers)
            compute_plan_rows(plan, missing, executor, workers=workers, keep=keep_outcome, stop=stop)
    if len(outcomes) < len(plan.rows):
        message = (
            "nothing is kept without --out"
            if work is None
            else f"{len(outcomes)} of {len(plan.rows)} rows are kept in {work.path}; the same command goes on"
        )
        click.echo(message, err=True)
        raise KeyboardInterrupt
    return [outcomes[row.index] for row in plan.rows]


def _build_refused_outcome(plan: Plan, row: Row) -> Outcome:
    """Create the outcome of a row whose parameters are invalid: NaN and the reason."""
    return Outcome(
        index=row.index,
        numbers=(math.nan,) * len(RESULTS[plan.model]),
        status=f"{INVALID}{row.reason}",
    )


def _refuse_invalid_outcomes(plan: Plan, options: SweepOptions, outcomes: Sequence[Outcome]) -> None:
    """Raise UsageError for the first invalid outcome, unless invalid rows are to be skipped."""
    if options.skip_invalid:
        return
    for outcome in outcomes:
        if outcome.status.startswith(INVALID):
            raise UsageError(
                f"{describe_row(plan.keys, plan.rows[outcome.index])} is refused: "
                f"{outcome.status.removeprefix(INVALID)}; correct it, or keep such rows with their reason by "
                "--skip-invalid"
            )


def _remove_work_file(path: Path) -> None:
    """Remove the work file after the outputs are written; raise StorageError if that fails."""
    try:
        retry(path.unlink)
    except OSError as error:
        raise StorageError(
            f"the results are written, but {path} cannot be removed: {error.strerror}; remove it by hand"
        ) from error
