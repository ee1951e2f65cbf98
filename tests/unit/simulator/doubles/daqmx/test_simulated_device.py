"""A board that behaves as NI's own simulated devices do."""

from dataclasses import replace

import numpy as np
import pytest
from support.doubles_bench import Caller, SteppedClock

from simulator.doubles.chassis.description import (
    SIMULTANEOUS_16_BIT,
    build_default_description,
    from_json,
    to_json,
)
from simulator.doubles.device_model import Brain
from simulator.doubles.vendor_api.statuses import Status

BOARD = SIMULTANEOUS_16_BIT.name
SIMULATED = replace(
    build_default_description(),
    boards=(replace(SIMULTANEOUS_16_BIT, serial_number=0, simulated=True),),
    transducers={},
)
IS_SIMULATED, SERIAL_NUMBER, LAST_TEMPERATURE, COEFFICIENTS = 0x22CA, 0x632, 0x1864, 0x1930


@pytest.fixture
def brain():
    return Brain(from_json(to_json(SIMULATED)), clock=SteppedClock(0))


@pytest.fixture
def me(brain):
    return Caller(brain)


def test_a_simulated_device_reports_itself_and_has_no_calibration(me):
    assert me("GetDeviceAttribute", device_name=BOARD, attribute=IS_SIMULATED)["value"] == 1
    assert me("GetDeviceAttribute", device_name=BOARD, attribute=SERIAL_NUMBER)["value"] == 0
    assert me("GetCalInfoAttribute", device_name=BOARD, attribute=LAST_TEMPERATURE)["value"] == 0.0
    with pytest.raises(Status) as caught:
        me("GetSelfCalLastDateAndTime", device_name=BOARD)
    assert caught.value.code == -200077
    me("SelfCal", device_name=BOARD)  # it does not complain


def test_a_record_is_there_at_once_though_nothing_triggered(brain, me):
    task = me.digitizer(f"{BOARD}/ai0", range_v=5.0)
    records = []
    for _ in range(2):
        me("StartTask", task)
        me("WaitUntilTaskDone", task, time_to_wait=0.0)
        records.append(np.asarray(me("ReadBinaryI16", task, timeout=0.0)["read_array"]))
        me("StopTask", task)
    assert brain.bench.clock.now_ns() == 0
    # A full-scale sine wave with three percent of noise; codes reach 2 % beyond the range.
    full_scale = 32768 / 1.02
    for record in records:
        assert record.size == 13_600
        assert record.std() == pytest.approx(full_scale / 2**0.5, rel=0.01)
    assert not np.array_equal(*records)


def test_a_pulse_is_over_at_once_and_no_line_moves(brain, me):
    coil = me.coil(f"{BOARD}/ctr0", initial_delay=1e-3, high_time=0.02)
    me("StartTask", coil)
    assert me.is_done(coil)
    me("StopTask", coil)
    brain.bench.clock.pass_s(1.0)
    assert not any(event["level"] for event in brain.record()["lines"])
    assert brain.record()["strikes"] == []
