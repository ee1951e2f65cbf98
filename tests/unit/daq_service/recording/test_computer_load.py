"""Each taken set has a reading of the computer's load, which a rebuild restores from the history."""

import sys
from contextlib import ExitStack

import numpy as np
import pytest
from support.life_of_a_test import run
from support.machine import Machine
from support.memory_line import SETS, Line, healthy
from support.table_rows import lose_catalogue

from daq_service.processes import resource_use as own_use
from daq_service.processes.disk_policy import DiskSpace
from daq_service.recording.computer_load import MACHINE_READ, ComputerLoadWatch
from daq_service.recording.reassessment.rebuild import rebuild_folder_catalogue
from daq_service.recording.recorder import Cost
from hardware_drivers.errors import AcquisitionTimeoutError
from simulator.clock import SimulatedClock

NOW_NS = 1_800_000_000_000_000_000
SPACE = DiskSpace(free_bytes=3, total_bytes=4, level="ample")
needs_readable_memory = pytest.mark.skipif(
    sys.platform not in ("linux", "win32"), reason="this system tells neither memory nor handles"
)


def watch(clock=None, space=SPACE, **changes):
    options = {"space": lambda: space, "files_read": lambda: 7, **changes}
    return ComputerLoadWatch(clock or SimulatedClock(NOW_NS), **options)


@needs_readable_memory
def test_files_that_are_opened_are_counted(tmp_path):
    before = own_use.open_handles()
    with ExitStack() as stack:
        for number in range(5):
            stack.enter_context((tmp_path / str(number)).open("w"))
        assert own_use.open_handles() == before + 5


@needs_readable_memory
def test_memory_that_is_written_is_counted():
    n_bytes = 64 * 2**20
    before = own_use.resident_bytes()
    array = np.ones(n_bytes, dtype=np.uint8)
    # Freed pages of what was there may be used again: never so many.
    assert own_use.resident_bytes() - before > n_bytes // 2
    assert array.any()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows is asked in another way")
def test_values_not_provided_by_the_system_are_none(tmp_path, monkeypatch):
    monkeypatch.setattr(own_use, "_PROC", tmp_path / "not mounted")
    assert (own_use.resident_bytes(), own_use.open_handles()) == (None, None)
    before_a_look = DiskSpace(free_bytes=0, total_bytes=0, level="ample")
    reading = watch(space=before_a_look).read(Cost().seconds)
    unknown = {name for name, value in reading.items() if value is None}
    assert unknown == {
        *("resident_bytes", "open_handles", "free_bytes", "total_bytes"),
        *("clock_ahead_s", "clock_synchronised"),  # simulated time
    }


def test_stage_times_count_since_the_previous_reading():
    cost, watched = Cost(), watch()
    cost.seconds["judge_s"] = 1.5
    assert watched.read(cost.seconds)["stage_s"]["judge_s"] == 1.5
    cost.seconds["judge_s"] = 1.75
    reading = watched.read(cost.seconds)
    assert (reading["stage_s"]["judge_s"], reading["stage_s"]["fsync_s"]) == (0.25, 0.0)
    assert (reading["free_bytes"], reading["total_bytes"], reading["files_read"]) == (3, 4, 7)


def test_a_step_of_the_computer_s_clock_is_how_far_it_is_ahead_from_then_on():
    machine = Machine(NOW_NS)
    watched = watch(machine.clock(None), system_ns=lambda: machine.utc_ns)
    assert watched.read(Cost().seconds)["clock_ahead_s"] == 0.0
    machine.set_clock(1.0)
    assert watched.read(Cost().seconds)["clock_ahead_s"] == 3600.0


def test_each_taken_set_has_one_reading_which_a_rebuild_restores_and_a_missed_one_has_none(tmp_path):
    def script(key):
        return AcquisitionTimeoutError("nothing triggered") if key.set_index == 3 else healthy(key)

    line = Line(tmp_path, script=script)
    run(line, machine=watch())
    events = [row for row in line.rows("events") if row.topic == "machine"]
    assert [row.set_index for row in events] == [index for index in range(SETS) if index != 3]
    assert {row.kind for row in events} == {MACHINE_READ}
    assert len({row.payload["recorder_wall_utc_ns"] for row in events}) == 1
    lose_catalogue(line.folder)
    rebuild_folder_catalogue(line.folder, features_of=line.features_of)
    assert [row for row in line.rows("events") if row.topic == "machine"] == events
