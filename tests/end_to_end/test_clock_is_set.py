"""The computer's clock is set during a test with a real recorder: the next recorder finds it."""

import threading
import time

import pytest
from support.machine import Machine
from support.small_experiment import rows_of, run, small_settings

from daq_service.catalogue import open_catalogue
from daq_service.clock import boot_name, wall
from daq_service.recording import session


@pytest.mark.skipif(boot_name() is None, reason="this system names no boot")
@pytest.mark.parametrize("by_h", [1.0, -1.0, 400.0])
def test_a_recorder_goes_on_with_the_time_of_the_one_before(tmp_path, monkeypatch, by_h):
    machine, stop = Machine(time.time_ns()), threading.Event()
    monkeypatch.setattr(session, "elapsed_ns", lambda: machine.elapsed_ns)
    monkeypatch.setattr(wall, "IDLE_INTERVAL_S", 60.0)
    settings = small_settings(clock={"kind": "wall"}, schedule={"end_h": 2.0})
    settings = settings.model_copy(update={"positions": {name: settings.positions[name] for name in "AB"}})
    machine.after(1.2, stop.set)
    assert not run(settings, tmp_path, stop=stop, wall_clock=machine.clock)
    machine.sleep(60.0)
    machine.set_clock(by_h)
    stop.clear()
    machine.after(20.0, stop.set)  # who waits for a set clock here waits in vain
    assert run(settings, tmp_path, stop=stop, wall_clock=machine.clock)
    rows = rows_of(tmp_path)
    assert [(row.set_index, row.state) for row in rows["sets"]] == [
        (index, "done") for index in range(4) for _ in "AB"
    ]
    shots = sorted(rows["shots"], key=lambda shot: shot.sequence)
    assert [shot.utc_ns for shot in shots] == sorted(shot.utc_ns for shot in shots)
    with open_catalogue(tmp_path) as catalogue:
        step = catalogue.last_service_event("clock_step")
    assert step.payload["step_s"] == by_h * 3600.0
