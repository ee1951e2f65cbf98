"""Recorders killed at any moment, one after the other, on one folder: as if nothing had happened."""

import random
from multiprocessing import Pipe

import pytest
from support.daqmx_brains import in_a_process
from support.small_experiment import rows_of, run, small_settings
from support.waiting import ended

from daq_service.archive import FolderSetReader
from daq_service.archive.journal.reader import read_journal

LONGEST_LIFE_S = 0.5
"""Some sets, on this machine or a busy one; some kills come before the first one."""


def settings_for(kills):
    """A set or so for each kill."""
    return small_settings(schedule={"phases": [{"until_h": 0.6 * kills, "interval_h": 0.5}]})


def record_until_killed(kills, folder, told):
    """Child: go on with the test; each acknowledged shot is told at once."""
    run(settings_for(kills), folder, acknowledged=told.send)


@pytest.mark.parametrize("kills", [20, pytest.param(200, marks=pytest.mark.slow)])
def test_kills_at_any_moment_lose_no_acknowledged_shot_and_change_no_row(tmp_path, kills):
    moments, folder = random.Random(kills), tmp_path / "data"
    acknowledged, killed = [], 0
    here, there = Pipe(duplex=False)
    with here, there:
        while killed < kills:
            recorder = in_a_process(record_until_killed, kills, folder, there)
            recorder.join(moments.uniform(0.0, LONGEST_LIFE_S))
            if recorder.exitcode is not None:
                break  # it was done before
            recorder.kill()
            ended(recorder, "the kill")
            recorder.close()
            killed += 1
            while here.poll():
                acknowledged.append(here.recv())
    assert killed >= kills / 2, "the test was over before it was disturbed"
    assert run(settings_for(kills), folder, acknowledged=acknowledged.append)
    assert run(settings_for(kills), tmp_path / "undisturbed")
    found = rows_of(folder)
    assert found == rows_of(tmp_path / "undisturbed")
    assert {row.sequence for row in found["shots"]} == set(acknowledged)
    reader = FolderSetReader(folder)
    assert set(reader.sets()) == {row.set_index for row in found["sets"]}
    assert not any(reader.verify_set(file) for file in reader.sets().values())
    assert read_journal(folder) == {}
