"""``solimon reproduce``: start test and models, draw figures as soon as possible, print the comparison.

The test on the twin runs in its own process, the models in another; figures are drawn here, those of the
models first, since they are ready before the test is. Every file is written as soon as it is made, so an
interruption leaves what is finished.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from daq_service.cli.reproduce.comparison import compare, not_made
from daq_service.cli.reproduce.evidence import Evidence, read_evidence
from daq_service.cli.reproduce.experiment import BY_SETS, check_test_folder, run_test, twin_settings
from daq_service.cli.reproduce.item import Item, Job, Material, NotAvailableError, Product
from daq_service.cli.reproduce.items import chosen_items
from daq_service.cli.reproduce.outcome import Outcome, Section, facts_of_test, finish, print_result, versions
from daq_service.cli.reproduce.output import DATA_FOLDER, csv_bytes, prepare_output
from daq_service.cli.reproduce.style import house_style, rendered
from daq_service.errors import EXIT_INTERRUPTED, EXIT_OK, UsageError
from daq_service.processes.child import stop_on_signals
from daq_service.processes.data_folder import new_folder
from daq_service.processes.worker import one_worker
from daq_service.settings.stored import differences
from daq_service.settings.tree import Settings
from daq_service.shared_file import write_output
from simulator.errors import SimulatorError

POLL_S = 0.1
SLIPS = "slips"

Report = Callable[[str], None]


class _StoppedError(Exception):
    """The operator interrupted."""


def reproduce(
    *, out: Path | None, data_dir: Path | None, only: str | None, seed: int | None, as_json: bool
) -> int:
    """Run the command and return its exit code."""
    if seed is not None and data_dir is not None:
        raise UsageError(
            "--seed is for a new test on the twin; the test of --from has been run: leave one out"
        )
    items = chosen_items(only)
    folder = (out or new_folder("reproduction")).absolute()

    def report(text: str) -> None:
        click.echo(text, err=True)

    with stop_on_signals() as stop, ExitStack() as stack:
        executor = stack.enter_context(one_worker())
        try:
            result, finished = reproduce_into(
                folder, items, data_dir=data_dir, seed=seed, executor=executor, stop=stop, report=report
            )
        finally:
            executor.shutdown(wait=False, cancel_futures=True)
    if as_json:
        click.echo(json.dumps(result))
    else:
        print_result(result)
    return EXIT_OK if finished else EXIT_INTERRUPTED


def reproduce_into(
    out: Path,
    items: Sequence[Item],
    *,
    data_dir: Path | None,
    seed: int | None,
    executor: Executor,
    stop: threading.Event,
    report: Report,
) -> tuple[dict[str, object], bool]:
    """Compute `items` and write them to the folder `out`.

    Parameters
    ----------
    data_dir
        Data folder of an earlier test; None runs the paper's test on the twin where an item needs one.
    executor
        Carries out the models' jobs.
    stop
        Set to interrupt: finished items stay, and the report lists the missing ones.

    Returns
    -------
    dict, bool
        What ``--json`` prints, and whether nothing interrupted it.

    Raises
    ------
    StorageError, UsageError
        The output folder, or the test's, cannot be used: before anything is computed.
    """
    needed = _needs_test(items)
    settings = twin_settings(seed) if needed and data_dir is None else None
    if data_dir is not None:
        read_evidence(data_dir.absolute(), with_traces=False)
    elif settings is not None:
        check_test_folder(settings, out / DATA_FOLDER)
    prepare_output(out)
    run = Outcome(out=out, started_s=time.monotonic(), facts=versions())
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="test") as tests:
        evidence = None
        if data_dir is not None and (needed or any(item.name == SLIPS for item in items)):
            evidence = tests.submit(read_evidence, data_dir.absolute())
        elif settings is not None:
            evidence = tests.submit(_run_and_read, settings, out / DATA_FOLDER, stop, report)
        jobs = dict.fromkeys(job for item in items for job in item.jobs.values())
        futures = {job: executor.submit(job.function, *job.arguments) for job in jobs}
        try:
            for item in sorted(items, key=lambda item: (item.needs_test, item.name == SLIPS)):
                _make(run, item, futures, evidence, stop, report)
        except _StoppedError:
            report("interrupted: what is finished stays; the same command with the same --out goes on")
        except BaseException:
            stop.set()  # ends the recorder, which the thread waits for
            raise
    order = [item.name for item in items]
    run.sections.sort(key=lambda section: order.index(section.item.name))
    return finish(run, [item.name for item in items], interrupted=stop.is_set()), not stop.is_set()


def _needs_test(items: Sequence[Item]) -> bool:
    """Return whether an item needs measurements; the slips use a test only if there is one."""
    return any(item.needs_test for item in items)


# The test and the models ---------------------------------------------------------------------------


def _run_and_read(settings: Settings, folder: Path, stop: threading.Event, report: Report) -> Evidence:
    """Run the test on the twin and read its results."""
    report(f"test on the twin (seed {settings.twin.seed}) in {folder}")
    if not run_test(settings, folder, stop=stop, progress=_ProgressOfTenths(report).progress):
        raise _StoppedError
    return read_evidence(folder)


class _ProgressOfTenths:
    """Reports every tenth of the test."""

    def __init__(self, report: Report) -> None:
        self._report = report
        self._last_tenth = -1

    def progress(self, done: int, planned: int, due_h: float) -> None:
        tenth = 10 * done // max(planned, 1)
        if tenth > self._last_tenth:
            self._last_tenth = tenth
            self._report(f"test: hour {due_h:g}, set {done} of {planned}")


def _wait(future: Future[Any], stop: threading.Event) -> Any:
    """Wait for a result or an interruption."""
    while not future.done():
        if stop.wait(POLL_S):
            raise _StoppedError
    return future.result()


# One item ------------------------------------------------------------------------------------------


def _make(
    run: Outcome,
    item: Item,
    futures: Mapping[Job, Future[Any]],
    evidence: Future[Evidence] | None,
    stop: threading.Event,
    report: Report,
) -> None:
    """Wait for the inputs of an item, compute it, write its files."""
    results: dict[str, Any] = {}
    for name, job in item.jobs.items():
        try:
            results[name] = _wait(futures[job], stop)
        except (SimulatorError, ValueError) as error:
            results[name] = error
    wants_test = item.needs_test or item.name == SLIPS
    test = _wait(evidence, stop) if evidence is not None and wants_test else None
    if stop.is_set():
        raise _StoppedError
    if test is not None:
        run.facts.update(facts_of_test(test))
    with house_style():
        try:
            product = item.make(Material(evidence=test, results=results))
        except NotAvailableError as error:
            report(f"{item.name}: not available: {error}")
            rows = not_made(item.name, str(error))
            run.sections.append(Section(item=item, trouble=str(error), rows=rows))
            return
        pictures = {} if product.drawing is None else rendered(product.drawing)
    run.sections.append(_written(run, item, product, pictures, origin=_origin(test)))
    if item.name == SLIPS:
        table = product.tables[""]
        run.slips = [dict(zip(table.columns, row, strict=True)) for row in table.rows()]
    report(f"{item.name}: done ({time.monotonic() - run.started_s:.0f} s)")


def _written(
    run: Outcome, item: Item, product: Product, pictures: Mapping[str, bytes], *, origin: str
) -> Section:
    """Write the files of an item and return its section."""
    stem = _stem(item.name)
    contents = {f"{stem}.{ending}": content for ending, content in pictures.items()}
    for ending, table in product.tables.items():
        contents[f"{stem}_{ending}.csv" if ending else f"{stem}.csv"] = csv_bytes(table)
    for name, content in contents.items():
        write_output(run.out / name, content)
    return Section(
        item=item,
        files=tuple(contents),
        png=pictures.get("png", b""),
        table=product.tables.get("") if product.drawing is None else None,
        rows=compare(item.name, product.found, origin=origin),
        notes=product.notes,
    )


def _origin(test: Evidence | None) -> str:
    """Return whose measurements these are, for their causes."""
    if test is not None and not test.from_twin:
        return "specimen"
    if test is None:
        return "shipped"
    # What raises an alarm changes no measurement.
    alarms = {**test.settings.alarms.model_dump(mode="json"), **BY_SETS["alarms"]}
    stored = {**test.settings.model_dump(mode="json"), "alarms": alarms}
    return "twin" if differences(stored, twin_settings(test.seed)) else "shipped"


def _stem(name: str) -> str:
    """Return the file name of an item: figures sort by number."""
    return f"fig{int(name[3:]):02d}" if name.startswith("fig") else name
