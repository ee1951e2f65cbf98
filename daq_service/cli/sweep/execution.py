"""Compute the rows of a plan in an executor and store each as soon as it is complete."""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import replace

from daq_service.cli.sweep.plan import Plan, Row
from daq_service.cli.sweep.shot import Outcome, compute_rows
from daq_service.errors import SolimonError
from daq_service.processes.executors import list_worker_lost_errors

ROWS_PER_TASK = 8
"""Maximum: small enough for fast stop and progress, large enough that sending costs little."""

TASKS_IN_ALL = 16
"""At least so many for each worker, where there are rows enough, so that all end together."""

TASKS_PER_WORKER = 2
"""Sent ahead, so that no worker waits."""

STOP_SEEN_WITHIN_S = 0.2

Task = list[Row]


def compute_plan_rows(
    plan: Plan,
    rows: Sequence[Row],
    executor: Executor,
    *,
    workers: int,
    keep: Callable[[Sequence[Outcome]], None],
    stop: threading.Event,
) -> None:
    """Compute rows of a plan, until all are finished or `stop` is set.

    Blocks; a stop is noticed within `STOP_SEEN_WITHIN_S`, and then running tasks are awaited.

    Parameters
    ----------
    rows
        Those still to be done; refused ones are left out by the caller.
    keep
        Called in this thread with outcomes, in the order in which they are ready. Once `stop` is set it still
        gets what is under way.

    Raises
    ------
    SolimonError
        Workers were lost repeatedly.
    """
    tasks = iter(group_rows_into_tasks(rows, workers))
    running: set[Future[list[Outcome]]] = set()
    try:
        while True:
            if stop.is_set():
                running = {future for future in running if not future.cancel()}
            else:
                for task in itertools.islice(tasks, TASKS_PER_WORKER * workers - len(running)):
                    rows_of_task = [(row.index, row.specimen) for row in task if row.specimen is not None]
                    running.add(executor.submit(compute_rows, plan.model, rows_of_task, plan.waveforms))
            if not running:
                return
            # Not for ever: on Windows a signal is seen only between two waits.
            done, running = wait(running, timeout=STOP_SEEN_WITHIN_S, return_when=FIRST_COMPLETED)
            for future in done:
                keep(future.result())
    except list_worker_lost_errors() as error:
        raise SolimonError(
            "workers ended by themselves again and again (killed, or out of memory); finished rows are kept: "
            "give the same command again, with fewer --workers if memory is short"
        ) from error


def group_rows_into_tasks(rows: Sequence[Row], workers: int) -> list[Task]:
    """Group rows by plate, then by chain; the first task of each plate comes first.

    So every plate is reduced once, by the worker of its first task, and read from the cache afterwards. A
    task has at most `ROWS_PER_TASK` rows; refused rows must be left out.
    """
    plates: dict[object, dict[object, list[Row]]] = {}
    for row in rows:
        assert row.specimen is not None, "the caller leaves refused rows out"
        chain, plate, corrosion = row.specimen
        outline = plate, replace(corrosion, depth_fraction=0.0)
        plates.setdefault(outline, {}).setdefault(chain, []).append(row)
    size = min(ROWS_PER_TASK, math.ceil(len(rows) / (TASKS_IN_ALL * workers)))
    firsts: list[Task] = []
    others: list[Task] = []
    for chains in plates.values():
        rows_of_plate = [row for members in chains.values() for row in members]
        tasks = [rows_of_plate[k : k + size] for k in range(0, len(rows_of_plate), size)]
        firsts.append(tasks[0])
        others += tasks[1:]
    return [*firsts, *others]
