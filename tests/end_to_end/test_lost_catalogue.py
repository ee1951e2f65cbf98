"""A catalogue that is lost in the midst of a test in real time: hour 0 stays, and so does every row."""

import json
import os
import threading
import time

import pytest
from support.command_line import solimon_here
from support.machine import Machine
from support.small_experiment import run, small_settings
from support.stored_files import set_files
from support.table_rows import lose_catalogue, table_rows

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.rows import SetRow
from daq_service.clock import boot_name, wall
from daq_service.recording import session

SCHEDULE = {"phases": [{"until_h": 3.0, "interval_h": 0.5}], "shots_per_set": 2}
MACHINE_NAMES_ITS_BOOT = pytest.mark.skipif(boot_name() is None, reason="this system names no boot")


def settings_of(**chain):
    return small_settings(clock={"kind": "wall"}, schedule=SCHEDULE, chain=chain, baseline={"hours": 1.5})


@pytest.fixture
def machine(monkeypatch):
    machine = Machine(time.time_ns())
    monkeypatch.setattr(session, "elapsed_ns", lambda: machine.elapsed_ns)
    monkeypatch.setattr(wall, "IDLE_INTERVAL_S", 60.0)
    return machine


@pytest.fixture
def started_folder(machine, tmp_path):
    """Return the folder of a test in real time, stopped after two sets."""
    stop = threading.Event()
    machine.after(1.2, stop.set)
    assert not run(settings_of(), tmp_path, stop=stop, wall_clock=machine.clock)
    assert len(set_files(tmp_path)) == 2
    return tmp_path


@MACHINE_NAMES_ITS_BOOT
def test_the_next_recorder_rebuilds_the_catalogue_and_continues_from_the_same_hour_0(machine, started_folder):
    before = table_rows(started_folder)
    lose_catalogue(started_folder)
    # The computer was off for a while: one set is missed.
    machine.sleep(3000.0)
    assert run(settings_of(), started_folder, wall_clock=machine.clock)
    after = table_rows(started_folder)
    # Counts go on, and only the newest states are kept.
    del before["counts"], before["assessor_states"]
    for name, rows in before.items():
        columns = 4 if name == "assessments" else None  # those of the baseline's sets waited for it
        assert [row[:columns] for row in after[name][: len(rows)]] == [row[:columns] for row in rows], name
    with open_catalogue(started_folder) as catalogue:
        states = [row.state for row in catalogue.rows(SetRow, position="B")]
        assert states == ["done", "done", "missed", "done", "done", "done"]
        event = catalogue.read_last_service_event("catalogue_rebuilt")
        assert (event.payload["sets"], event.payload["warnings"]) == (2, [])
        assert all(len(row.file_sha256) == 64 for row in catalogue.rows(SetRow) if row.file)
    whole = table_rows(started_folder)
    lose_catalogue(started_folder)
    answer = solimon_here("rebuild", "--data-dir", str(started_folder), "--json", env=os.environ)
    assert (answer.returncode, json.loads(answer.stdout)["warnings"]) == (0, [])
    assert "5 of 5 sets" in answer.stderr
    assert table_rows(started_folder) == whole
