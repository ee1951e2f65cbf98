"""Executors by name: same interface and digits; a killed worker costs only its task."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.drifting_wall import RAISED
from support.dying_worker import die_always, die_once

from daq_service.errors import BusyError, UsageError
from daq_service.processes import executors
from daq_service.processes.executors import list_worker_lost_errors, open_executor, validate_executor_name

NUMBERS = range(6)
SILENT_CLUSTER = "dask://127.0.0.1:1"


def test_a_killed_process_costs_its_task_and_not_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr(executors, "MOST_TRIES", 2)
    with open_executor("processes", 1) as executor:
        futures = [executor.submit(die_once, tmp_path / "noted", number) for number in NUMBERS]
        assert [future.result() for future in futures] == list(NUMBERS)
        # One that kills every worker is given up, and the pool serves on.
        with pytest.raises(list_worker_lost_errors()):
            executor.submit(die_always, 0).result()
        assert executor.submit(math.sqrt, 4.0).result() == 2.0


def test_pending_tasks_are_cancelled_and_an_error_belongs_to_its_task():
    with open_executor("processes", 1) as executor:
        with pytest.raises(ValueError, match="math domain"):
            executor.submit(math.sqrt, -1.0).result()
        held = [executor.submit(math.sqrt, float(number)) for number in range(500)]
        assert held[-1].cancel()
        assert held[-1].cancelled()
    assert {future.cancelled() or future.result() >= 0.0 for future in held} == {True}


def test_executor_names_are_checked_before_the_start():
    for name in ("processes", "threads", "dask://there", "dask://there:9000"):
        assert validate_executor_name(name, None) == name
    for name in ("process", "dask://", "dask:there", "http://there"):
        with pytest.raises(UsageError, match="give processes, threads, or dask"):
            validate_executor_name(name, None)
    with pytest.raises(UsageError, match="--workers does not belong to a cluster"):
        validate_executor_name("dask://there", 4)


def test_a_silent_cluster_and_a_missing_extra_are_reported(monkeypatch):
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    with (
        pytest.raises(BusyError, match="no Dask scheduler answers at tcp:"),
        open_executor(SILENT_CLUSTER, 1),
    ):
        pass
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"solimon\[cluster\]"), open_executor(SILENT_CLUSTER, 1):
        pass


@pytest.mark.slow
def test_a_cluster_and_processes_have_the_same_digits_and_a_worker_may_be_killed(tmp_path):
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    # In a process of its own: Dask keeps threads for the life of one.
    command = [sys.executable, "-m", "support.local_cluster", str(tmp_path)]
    tests = Path(__file__).parents[3]
    environment = {**os.environ, "PYTHONPATH": str(tests)}
    done = subprocess.run(command, cwd=tests, env=environment, capture_output=True, text=True, check=True)
    answer = json.loads(done.stdout)
    assert answer["workers"] == 2
    assert answer["died"]
    assert answer["done"] == list(range(6))
    assert answer["sweep"]["cluster"] == answer["sweep"]["threads"]
    assert answer["replay"] == [{"sets": 25, "differences": [], "kept": len(RAISED)}] * 2
