"""Faults on order: the right call, the right number of times, in four kinds."""

import threading

import numpy as np
import pytest
from support.doubles_bench import Caller, SteppedClock
from support.waiting import ended, happened

from simulator.doubles.chassis.description import build_default_description
from simulator.doubles.device_model import Brain
from simulator.doubles.faults import Faults, build_wrong_answer
from simulator.doubles.vendor_api.entry_points import ENTRY_POINTS, Role
from simulator.doubles.vendor_api.statuses import TEXTS, Status


class DeathError(Exception):
    """Stands for the end of the process."""


def die():
    raise DeathError


@pytest.fixture
def brain():
    return Brain(build_default_description(), clock=SteppedClock(), die=die)


@pytest.fixture
def me(brain):
    return Caller(brain)


def outcome(call, *arguments, **more):
    try:
        call(*arguments, **more)
    except Status as status:
        return status.code
    return 0


@pytest.mark.parametrize(
    ("order", "expected"),
    [
        ({}, [-88710, 0, 0, 0]),
        ({"nth": 3}, [0, 0, -88710, 0]),
        ({"nth": 2, "times": 2}, [0, -88710, -88710, 0]),
        ({"times": 0}, [-88710] * 4),
    ],
)
def test_an_injected_error_occurs_at_its_call(brain, me, order, expected):
    brain.faults.inject("DAQmxCreateTask", "error", code=-88710, **order)
    me("GetSystemInfoAttribute", attribute=0x193B)
    assert [outcome(me, "CreateTask") for _ in range(4)] == expected
    # What failed was not done.
    assert len(brain.record()["tasks"]) == expected.count(0)


def test_an_injected_fault_can_name_the_attribute(brain, me):
    brain.faults.inject("DAQmxGetSystemInfoAttribute:Sys.DevNames", "error", code=-50103)
    assert outcome(me, "GetSystemInfoAttribute", attribute=0x1272) == 0
    assert outcome(me, "GetSystemInfoAttribute", attribute=0x193B) == -50103


def test_cleared_faults_are_forgotten(brain, me):
    brain.faults.inject("DAQmxCreateTask", "error", code=-50103)
    brain.faults.clear()
    assert outcome(me, "CreateTask") == 0


def test_the_record_contains_the_answers(brain, me):
    brain.faults.inject("DAQmxGetSystemInfoAttribute", "error", code=-50103)
    outcome(me, "GetSystemInfoAttribute", attribute=0x193B)
    call = brain.record()["calls"][-1]
    assert call["function"] == "DAQmxGetSystemInfoAttribute"
    assert call["attribute"] == "Sys.DevNames"
    assert (call["client"], call["status"]) == (me.name, -50103)
    assert 0 < call["begin_ns"] <= call["end_ns"]


@pytest.mark.parametrize(
    ("order", "reason"),
    [
        ({"function": "DAQmxNoSuch", "kind": "error", "code": -1}, "entry points"),
        ({"function": "DAQmxGetExtendedErrorInfo", "kind": "hang"}, "entry points"),
        ({"function": "DAQmxGetChanAttribute:No.Such", "kind": "hang"}, "attributes"),
        ({"function": "DAQmxStartTask", "kind": "misery"}, "error, hang, lie, death"),
        ({"function": "DAQmxStartTask", "kind": "error"}, "needs its code"),
        ({"function": "DAQmxStartTask", "kind": "hang", "nth": 0}, "at least 1"),
    ],
)
def test_invalid_commands_are_rejected(order, reason):
    with pytest.raises(ValueError, match=reason):
        Faults().inject(**order)


def test_a_warning_can_be_injected(brain, me):
    brain.faults.inject("DAQmxCreateTask", "error", code=200010)
    with pytest.raises(Status) as caught:
        me("CreateTask")
    assert caught.value.code == 200010
    assert TEXTS[200010] in caught.value.message


# Hanging


def hanging_call(brain, me, **order):
    """Start a call that hangs, in a thread of its own."""
    brain.faults.inject("DAQmxCreateTask", "hang", **order)
    found = []
    thread = threading.Thread(target=lambda: found.append(outcome(me, "CreateTask", session_name="late")))
    thread.start()
    happened(brain.faults.wait_until_hanging, "a call hung")
    return thread, found


def test_a_hanging_call_waits_for_its_release_and_is_then_done(brain, me):
    thread, found = hanging_call(brain, me)
    assert found == []
    # The rest of the double goes on.
    assert outcome(me, "CreateTask", session_name="other") == 0
    brain.faults.release()
    ended(thread, "the hanging call came back")
    assert found == [0]
    assert {task["task"] for task in brain.record()["tasks"]} == {"late", "other"}


def test_a_hang_can_end_by_itself(brain, me):
    brain.faults.inject("DAQmxCreateTask", "hang", seconds=0.001)
    assert outcome(me, "CreateTask") == 0


def test_a_call_whose_caller_went_away_while_it_hung_is_not_done(brain, me):
    thread, found = hanging_call(brain, me)
    brain.close_client(me.name)
    brain.faults.release()
    ended(thread, "the hanging call came back")
    assert found == [-50405]
    assert brain.record()["tasks"] == []


# Lies


def test_a_call_without_an_answer_pretends_success(brain, me):
    coil = me.coil("PXI1Slot3/ctr0", initial_delay=0.0)
    brain.faults.inject("DAQmxStartTask", "lie")
    me("StartTask", coil)
    brain.bench.clock.pass_s(1.0)
    assert brain.record()["lines"] == []
    assert brain.record()["tasks"][0]["state"] == "unverified"


def test_a_lying_read_is_short(brain, me):
    task, coil = me.digitizer("PXI1Slot3/ai0"), me.coil("PXI1Slot3/ctr0")
    me("StartTask", task)
    me("StartTask", coil)
    brain.faults.inject("DAQmxReadBinaryI16", "lie")
    answer = me("ReadBinaryI16", task, timeout=1.0)
    assert answer["samps_per_chan_read"] == 6_800
    assert answer["read_array"].size == 6_800


def test_a_lying_handle_belongs_to_no_task(brain, me):
    brain.faults.inject("DAQmxCreateTask", "lie")
    assert outcome(me, "StartTask", me("CreateTask")["task"]) == -200088


def test_a_lying_rate_looks_coerced(brain, me):
    task = me.digitizer("PXI1Slot3/ai0")
    brain.faults.inject("DAQmxGetTimingAttribute:SampClk.Rate", "lie")
    rate_hz = me("GetTimingAttribute", task, attribute=0x1344)["value"]
    assert rate_hz != 10e6
    assert rate_hz == pytest.approx(10e6, rel=0.02)


@pytest.mark.parametrize("entry", ENTRY_POINTS.values(), ids=lambda entry: entry.name)
def test_every_call_that_answers_can_lie(entry):
    outputs = [parameter for parameter in entry.parameters if parameter.goes_out]
    truth = {}
    for parameter in outputs:
        if parameter.role is Role.OUT_TEXT:
            truth[parameter.name] = "something"
        elif parameter.role is Role.OUT_ARRAY:
            truth[parameter.name] = np.arange(2, 12)
        else:
            truth[parameter.name] = 8
    lied = build_wrong_answer(entry, {}, lambda: truth)
    assert lied.keys() == truth.keys()
    for name, value in truth.items():
        assert not np.array_equal(lied[name], value)


# Death


def test_death_ends_the_process_before_anything_is_done(brain, me):
    brain.faults.inject("DAQmxCreateTask", "death")
    with pytest.raises(DeathError):
        me("CreateTask")
    assert brain.record()["tasks"] == []
