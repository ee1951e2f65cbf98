"""The X Series watchdog stands over each strike: started before the pulse, asked and stopped after it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest
from support.daqmx_rig import meet, parameters_of, quick_description, take, why_no

from hardware_drivers.daqmx import WatchdogWiring, open_daqmx
from hardware_drivers.daqmx.coil import Coil
from hardware_drivers.errors import AcquisitionTimeoutError
from hardware_drivers.measurement import ShotKey
from simulator.doubles.doors.control import running_doubles


class Recorder:
    """Stands for a vendor object: notes what is asked of it, in order, together with its sibling."""

    def __init__(self, name, notes, *, expired=False):
        self._name, self._notes, self._expired = name, notes, expired

    def __getattr__(self, method):
        def note(*_):
            self._notes.append(f"{self._name}.{method}")

        return note

    @property
    def expired(self):
        self._notes.append(f"{self._name}.expired")
        return self._expired


def coil(notes, *, expired=False):
    return Coil(
        position="B",
        board=SimpleNamespace(label="PXIe-6396 01E18096"),
        task=Recorder("counter", notes),
        watchdog=Recorder("watchdog", notes, expired=expired),
        longest_s=0.01,
    )


def test_it_is_armed_before_the_pulse_and_disarmed_after_it():
    notes = []
    coil(notes).pulse()
    assert notes == [
        "watchdog.start", "counter.start", "counter.wait_until_done", "counter.stop",
        "watchdog.expired", "watchdog.stop",
    ]  # fmt: skip


def test_an_expired_one_is_cleared_and_the_strike_counts_as_missed():
    notes = []
    with pytest.raises(AcquisitionTimeoutError, match=r"expired .* watchdog\.timeout_s"):
        coil(notes, expired=True).pulse()
    assert notes[-3:] == ["watchdog.expired", "watchdog.clear_expiration", "watchdog.stop"]


@pytest.fixture(params=["library", "grpc"])
def guarded(request, monkeypatch):
    if reason := why_no(request.param):
        pytest.skip(reason)
    description = quick_description(positions="C")
    with running_doubles(description) as doubles:
        if request.param == "library":
            meet(doubles, monkeypatch)
        parameters = parameters_of(description, doubles, transport=request.param)
        serial = parameters.transducers["C"].board_serial
        watchdog = WatchdogWiring(board_serial=serial, lines=("port2/line4",), timeout_s=1.0)
        yield doubles, replace(parameters, watchdog=watchdog)


def test_a_guarded_strike_is_an_ordinary_shot(guarded):
    doubles, parameters = guarded
    with open_daqmx(parameters) as rig:
        for shot in range(2):
            take(rig, doubles, ShotKey(position="C", set_index=0, shot_index=shot))
    record = doubles.control.record()
    assert record["tasks"] == []
    assert record["reservations"] == {}
    assert [event["cause"] for event in record["lines"]] == ["pulse"] * 4


def test_a_program_that_hangs_in_a_strike_is_cut_short_by_the_board(guarded):
    doubles, parameters = guarded
    parameters = replace(parameters, pulse_s=0.5, watchdog=replace(parameters.watchdog, timeout_s=0.9))
    object.__setattr__(parameters.watchdog, "timeout_s", 0.1)  # shorter than the pulse: as if it hung
    with open_daqmx(parameters) as rig:
        rig.digitizer.arm(ShotKey(position="C", set_index=0, shot_index=0))
        with pytest.raises(AcquisitionTimeoutError, match="expired during the strike"):
            rig.striker.strike(ShotKey(position="C", set_index=0, shot_index=0))
    high, low = doubles.control.record()["lines"]
    assert low["cause"] == "watchdog"
    # The watchdog's 0.1 s run from just before the pulse.
    assert (low["ns"] - high["ns"]) / 1e9 < 0.1
