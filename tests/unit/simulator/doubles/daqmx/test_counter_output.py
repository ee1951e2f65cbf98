"""Pulses, and the record of the lines they drive."""

import pytest
from support.doubles_bench import Caller, SteppedClock

from simulator.doubles.chassis.description import build_default_description
from simulator.doubles.daqmx.lines import LineRecord, Pulse
from simulator.doubles.device_model import Brain
from simulator.doubles.vendor_api.statuses import Status

COUNTER, LINE = "PXI1Slot3/ctr0", "31547526/PFI12"
HIGH, LOW = 10192, 10214
IDLE_STATE, HIGH_TIME, PULSE_TERMINAL = 0x1170, 0x18BA, 0x18E1


@pytest.fixture
def brain():
    return Brain(build_default_description(), clock=SteppedClock(0))


@pytest.fixture
def me(brain):
    return Caller(brain)


def edges(brain, line=LINE):
    return [(event["ns"], event["level"]) for event in brain.record()["lines"] if event["line"] == line]


def test_one_pulse_is_recorded_to_the_nanosecond(brain, me):
    coil = me.coil(COUNTER, initial_delay=1e-3, high_time=0.02, low_time=0.5)
    me("StartTask", coil)
    assert edges(brain) == []
    brain.bench.clock.time_ns = 999_999
    assert edges(brain) == []
    brain.bench.clock.time_ns = 1_000_000
    assert edges(brain) == [(1_000_000, 1)]
    assert brain.record()["levels"][LINE] == 1
    me("WaitUntilTaskDone", coil, time_to_wait=1.0)
    assert brain.bench.clock.now_ns() == 21_000_000
    assert edges(brain) == [(1_000_000, 1), (21_000_000, 0)]
    assert me("GetChanAttribute", coil, attribute=IDLE_STATE)["value"] == LOW
    position = {event["position"] for event in brain.record()["lines"]}
    assert position == {"C"}


def test_times_are_whole_ticks_of_the_timebase(brain, me):
    coil = me.coil(COUNTER, initial_delay=0.0, high_time=0.0200000049)
    assert me("GetChanAttribute", coil, attribute=HIGH_TIME)["value"] == 0.02
    me("StartTask", coil)
    brain.bench.clock.pass_s(1.0)
    assert edges(brain) == [(0, 1), (20_000_000, 0)]


@pytest.mark.parametrize("end", ["StopTask", "ClearTask"])
def test_ending_a_task_ends_its_pulse(brain, me, end):
    coil = me.coil(COUNTER, initial_delay=0.0, high_time=10.0)
    me("StartTask", coil)
    brain.bench.clock.time_ns = 30_000_000
    if end == "StopTask":
        with pytest.raises(Status, match="200010"):
            me("StopTask", coil)
    else:
        me("ClearTask", coil)
    brain.bench.clock.pass_s(60.0)
    assert edges(brain) == [(0, 1), (30_000_000, 0)]
    assert brain.record()["lines"][-1]["cause"] == "stop"


def test_a_pin_that_would_idle_high_is_refused(brain, me):
    with pytest.raises(Status, match="low between pulses") as caught:
        me.coil(COUNTER, idle_state=HIGH)
    assert caught.value.code == -200077


def test_a_commit_drives_the_pin_low(brain, me):
    brain.bench.lines.drive(LINE, 1, 0, "left by somebody")
    brain.bench.clock.time_ns = 5
    me.control(me.coil(COUNTER), 3)
    assert edges(brain) == [(0, 1), (5, 0)]


def test_a_pulse_sent_to_another_pin_moves_no_striker(brain, me):
    coil = me.coil(COUNTER)
    me("SetChanAttribute", coil, attribute=PULSE_TERMINAL, value="/PXI1Slot3/PFI3")
    assert me("GetChanAttribute", coil, attribute=PULSE_TERMINAL)["value"] == "/PXI1Slot3/PFI3"
    me("StartTask", coil)
    brain.bench.clock.pass_s(1.0)
    assert edges(brain) == []
    assert len(edges(brain, "31547526/PFI3")) == 2
    assert brain.record()["strikes"] == []


def test_a_pin_that_is_not_there_is_refused(me):
    coil = me.coil(COUNTER)
    with pytest.raises(Status, match="-200077"):
        me("SetChanAttribute", coil, attribute=PULSE_TERMINAL, value="/PXI1Slot3/PFI99")


@pytest.mark.parametrize("times", [{"high_time": 1e-8}, {"initial_delay": -1.0}, {"high_time": 43.0}])
def test_times_beyond_the_counter_are_refused(me, times):
    coil = me.coil(COUNTER, **times)
    with pytest.raises(Status, match="-200077"):
        me("StartTask", coil)


def test_a_start_trigger_of_the_digitizer_starts_the_pulse(brain, me):
    coil = me.coil(COUNTER, initial_delay=0.0)
    me("CfgDigEdgeStartTrig", coil, trigger_source="/PXI1Slot3/ai/StartTrigger", trigger_edge=10280)
    me("StartTask", coil)
    brain.bench.clock.time_ns = 50
    assert edges(brain) == []
    digitizer = me.digitizer("PXI1Slot3/ai0")
    me("StartTask", digitizer)
    me("WaitUntilTaskDone", digitizer, time_to_wait=1.0)
    assert edges(brain)[0] == (50, 1)


def test_a_trigger_travels_over_routes_and_the_backplane(brain, me):
    me(
        "ConnectTerms",
        source_terminal="/PXI1Slot2/ai/StartTrigger",
        destination_terminal="/PXI1Slot2/PXI_Trig0",
        signal_modifiers=0,
    )
    coil = me.coil(COUNTER, initial_delay=0.0)
    me("CfgDigEdgeStartTrig", coil, trigger_source="/PXI1Slot3/PXI_Trig0", trigger_edge=10280)
    me("StartTask", coil)
    me("StartTask", me.digitizer("PXI1Slot2/ai0"))
    brain.bench.clock.pass_s(0.1)
    assert len(edges(brain)) == 2


def test_without_the_route_nothing_starts(brain, me):
    route = {"source_terminal": "/PXI1Slot2/ai/StartTrigger", "destination_terminal": "/PXI1Slot2/PXI_Trig0"}
    me("ConnectTerms", **route, signal_modifiers=0)
    with pytest.raises(Status, match="-89137"):
        me("ConnectTerms", **route | {"source_terminal": "/PXI1Slot2/PFI0"}, signal_modifiers=0)
    me("DisconnectTerms", **route)
    coil = me.coil(COUNTER)
    me("CfgDigEdgeStartTrig", coil, trigger_source="/PXI1Slot3/PXI_Trig0", trigger_edge=10280)
    me("StartTask", coil)
    me("StartTask", me.digitizer("PXI1Slot2/ai0"))
    brain.bench.clock.pass_s(0.1)
    assert edges(brain) == []
    assert not me.is_done(coil)


def test_a_terminal_is_let_go_unless_a_route_needs_it(brain, me):
    brain.bench.lines.drive(LINE, 1, 0, "left by somebody")
    assert brain.record()["levels"][LINE] == 1
    me("TristateOutputTerm", output_terminal="/PXI1Slot3/PFI12")
    assert brain.record()["levels"][LINE] == 0
    route = {"source_terminal": "/PXI1Slot3/PFI0", "destination_terminal": "/PXI1Slot3/PFI12"}
    me("ConnectTerms", **route, signal_modifiers=0)
    with pytest.raises(Status, match="-89127"):
        me("TristateOutputTerm", output_terminal="/PXI1Slot3/PFI12")


@pytest.mark.parametrize(
    ("ends", "code"),
    [
        ({"source_terminal": "/Dev1/PFI99", "destination_terminal": "/Dev1/PFI1"}, -200040),
        ({"source_terminal": "/Dev1/PFI0", "destination_terminal": "/Dev9/PFI1"}, -200041),
    ],
)
def test_routes_between_missing_terminals_are_refused(me, ends, code):
    with pytest.raises(Status) as caught:
        me("ConnectTerms", **ends, signal_modifiers=0)
    assert caught.value.code == code


def test_lines_are_recorded_together_in_order_of_time():
    lines = LineRecord()
    for name, begin_ns in (("1/PFI12", 5), ("2/PFI12", 7)):
        lines.start(Pulse(line=name, start_ns=begin_ns, end_ns=begin_ns + 10))
    lines.settle(1_000)
    assert [(event.ns, event.line) for event in lines.events] == [
        (5, "1/PFI12"),
        (7, "2/PFI12"),
        (15, "1/PFI12"),
        (17, "2/PFI12"),
    ]
