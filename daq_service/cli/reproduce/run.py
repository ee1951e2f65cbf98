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
from functools import partial
from pathlib import Path
from typing import TypeVar

import click
import matplotlib as mpl

from daq_service.catalogue import check_owner
from daq_service.cli.reproduce.comparison import compare_item
from daq_service.cli.reproduce.evidence import Evidence, read_evidence
from daq_service.cli.reproduce.experiment import BY_SETS, load_twin_settings, run_twin_test
from daq_service.cli.reproduce.item import Item, Job, Material, NotAvailableError, Product
from daq_service.cli.reproduce.items import choose_items
from daq_service.cli.reproduce.outcome import (
    Outcome,
    Section,
    add_test_facts,
    collect_run_facts,
    print_result,
    write_outcome,
)
from daq_service.cli.reproduce.output import DATA_FOLDER, format_csv, prepare_output
from daq_service.cli.reproduce.style import RULES, render_figure
from daq_service.errors import EXIT_INTERRUPTED, EXIT_OK, UsageError
from daq_service.processes.child import stop_on_signals
from daq_service.processes.data_folder import build_new_folder_path
from daq_service.processes.worker import start_one_worker
from daq_service.settings.stored import list_settings_differences
from daq_service.settings.tree import Settings
from daq_service.shared_file import write_output
from simulator.errors import SimulatorError

POLL_S = 0.1
SLIPS = "slips"

Report = Callable[[str], None]
T = TypeVar("T")


class _StoppedError(Exception):
    """The operator interrupted."""


def reproduce(
    *, out: Path | None, data_dir: Path | None, only: str | None, seed: int | None, as_json: bool
) -> int:
    """Run `solimon reproduce`, print the comparison, and return the exit code: 0, or 130 if interrupted.

    The default ``out`` is a new folder in the working directory. Blocks for minutes if the test is run.

    Raises
    ------
    UsageError
        ``seed`` and ``data_dir`` are both given, or an item does not exist.
    StorageError
        The output folder, or the test's, cannot be used.
    SolimonError
        The test on the twin failed.
    """
    if seed is not None and data_dir is not None:
        raise UsageError(
            "--seed is for a new test on the twin; the test of --from has been run: leave one out"
        )
    items = choose_items(only)
    folder = (out or build_new_folder_path("reproduction")).absolute()

    report = partial(click.echo, err=True)
    with stop_on_signals() as stop, ExitStack() as stack:
        executor = stack.enter_context(start_one_worker())
        try:
            result, finished = compute_and_write_items(
                folder, items, data_dir=data_dir, seed=seed, executor=executor, stop=stop, report=report
            )
        finally:
            executor.shutdown(wait=False, cancel_futures=True)
    if as_json:
        click.echo(json.dumps(result))
    else:
        print_result(result)
    return EXIT_OK if finished else EXIT_INTERRUPTED


def compute_and_write_items(
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
    SolimonError
        The test on the twin failed.
    """
    # The slips use a test only if there is one.
    needed = any(item.needs_test for item in items)
    settings = load_twin_settings(seed) if needed and data_dir is None else None
    if data_dir is not None:
        read_evidence(data_dir.absolute(), with_traces=False)
    elif settings is not None and (out / DATA_FOLDER).exists():
        check_owner(settings, out / DATA_FOLDER)
    prepare_output(out)
    run = Outcome(out=out, started_s=time.monotonic(), facts=collect_run_facts())
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="test") as tests:
        evidence = None
        if data_dir is not None and (needed or any(item.name == SLIPS for item in items)):
            evidence = tests.submit(read_evidence, data_dir.absolute())
        elif settings is not None:
            evidence = tests.submit(_run_and_read_test, settings, out / DATA_FOLDER, stop, report)
        jobs = dict.fromkeys(job for item in items for job in item.jobs.values())
        futures = {job: executor.submit(job.function, *job.arguments) for job in jobs}
        try:
            for item in sorted(items, key=lambda item: (item.needs_test, item.name == SLIPS)):
                _complete_item(run, item, futures, evidence, stop, report)
        except _StoppedError:
            report("interrupted: what is finished stays; the same command with the same --out goes on")
        except BaseException:
            stop.set()  # ends the recorder, which the thread waits for
            raise
    order = [item.name for item in items]
    run.sections.sort(key=lambda section: order.index(section.item.name))
    return write_outcome(run, [item.name for item in items], interrupted=stop.is_set()), not stop.is_set()


# The test and the models ---------------------------------------------------------------------------


def _run_and_read_test(settings: Settings, folder: Path, stop: threading.Event, report: Report) -> Evidence:
    """Run the test on the twin, report each tenth of its sets, and return its results.

    Blocks. Raises `_StoppedError` if it was interrupted, otherwise the errors of `run_twin_test`.
    """
    report(f"test on the twin (seed {settings.twin.seed}) in {folder}")
    last_tenth = -1

    def progress(done: int, planned: int, due_h: float) -> None:
        """Report the progress of the test at each tenth of the sets."""
        nonlocal last_tenth
        tenth = 10 * done // max(planned, 1)
        if tenth > last_tenth:
            last_tenth = tenth
            report(f"test: hour {due_h:g}, {done} of {planned} sets")

    if not run_twin_test(settings, folder, stop=stop, progress=progress):
        raise _StoppedError
    return read_evidence(folder)


def _wait_for_result(future: Future[T], stop: threading.Event) -> T:
    """Wait without limit for a result and return it, or raise its error.

    Raises `_StoppedError` once ``stop`` is set, which is checked every `POLL_S`.
    """
    while not future.done():
        if stop.wait(POLL_S):
            raise _StoppedError
    return future.result()


# One item ------------------------------------------------------------------------------------------


def _complete_item(
    run: Outcome,
    item: Item,
    futures: Mapping[Job, Future[object]],
    evidence: Future[Evidence] | None,
    stop: threading.Event,
    report: Report,
) -> None:
    """Wait for the inputs of an item, compute it, write its files, and add its section to ``run``.

    An item that is not available gets a section with the reason. A SimulatorError or ValueError of a job
    becomes its result; other errors of jobs or test are raised, and `_StoppedError` on an interruption.
    """
    results: dict[str, object] = {}
    for name, job in item.jobs.items():
        try:
            results[name] = _wait_for_result(futures[job], stop)
        except (SimulatorError, ValueError) as error:
            results[name] = error
    wants_test = item.needs_test or item.name == SLIPS
    test = _wait_for_result(evidence, stop) if evidence is not None and wants_test else None
    if stop.is_set():
        raise _StoppedError
    if test is not None:
        add_test_facts(run.facts, test, _describe_origin(test))
    with mpl.rc_context(RULES):
        try:
            product = item.make(Material(evidence=test, results=results))
        except NotAvailableError as error:
            report(f"{item.name}: not available: {error}")
            rows = compare_item(item.name, {}, origin="shipped", missing_reason=str(error))
            run.sections.append(Section(item=item, trouble=str(error), rows=rows))
            return
        pictures = {} if product.drawing is None else render_figure(product.drawing)
    run.sections.append(_write_item(run, item, product, pictures, origin=_describe_origin(test)))
    if item.name == SLIPS:
        table = product.tables[""]
        run.slips = [dict(zip(table.columns, row, strict=True)) for row in table.rows()]
    report(f"{item.name}: done ({time.monotonic() - run.started_s:.0f} s)")


def _write_item(
    run: Outcome, item: Item, product: Product, pictures: Mapping[str, bytes], *, origin: str
) -> Section:
    """Write figures and CSV files of an item and return its section of the report.

    ``pictures`` has the encoded figures by file ending. Raises StorageUnavailableError if a file cannot be
    written.
    """
    stem = f"fig{int(item.name[3:]):02d}" if item.name.startswith("fig") else item.name
    contents = {f"{stem}.{ending}": content for ending, content in pictures.items()}
    for ending, table in product.tables.items():
        contents[f"{stem}_{ending}.csv" if ending else f"{stem}.csv"] = format_csv(table)
    for name, content in contents.items():
        write_output(run.out / name, content)
    return Section(
        item=item,
        files=tuple(contents),
        png=pictures.get("png", b""),
        table=product.tables.get("" if product.drawing is None else "detections"),
        numbers={name: one.value for name, one in product.found.items() if one.value is not None},
        rows=compare_item(item.name, product.found, origin=origin),
        notes=product.notes,
    )


def _describe_origin(test: Evidence | None) -> str:
    """Return the origin of the measurements: "specimen", "twin" or "shipped".

    "shipped" is the twin with the shipped settings, up to seed and alarm rule; also without a test.
    """
    if test is not None and not test.from_twin:
        return "specimen"
    if test is None:
        return "shipped"
    # What raises an alarm changes no measurement.
    alarms = {**test.settings.alarms.model_dump(mode="json"), **BY_SETS["alarms"]}
    stored = {**test.settings.model_dump(mode="json"), "alarms": alarms}
    return "twin" if list_settings_differences(stored, load_twin_settings(test.seed)) else "shipped"
