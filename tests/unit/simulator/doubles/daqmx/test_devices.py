"""Boards that are unplugged, come back under another name, are reset, calibrated and watched."""

import pytest
from support.doubles_bench import Caller, SteppedClock

from simulator.doubles.chassis.description import SIMULTANEOUS_16_BIT, build_default_description
from simulator.doubles.device_model import Brain
from simulator.doubles.vendor_api.statuses import Status

SERIAL, BOARD = SIMULTANEOUS_16_BIT.serial_number, SIMULTANEOUS_16_BIT.name
INPUT, COUNTER, LINE = f"{BOARD}/ai0", f"{BOARD}/ctr0", f"{SERIAL}/PFI12"
SERIAL_NUMBER, DEVICE_NAMES, COEFFICIENTS = 0x632, 0x193B, 0x1930
COMMIT, RESET_TIMER, CLEAR_EXPIRATION, EXPIRED = 3, 0, 1, 0x21A8
LOW, HIGH, TRISTATE, NO_CHANGE = 10214, 10192, 10310, 10160


@pytest.fixture
def brain():
    return Brain(build_default_description(), clock=SteppedClock(0))


@pytest.fixture
def me(brain):
    return Caller(brain)


def code_of(call, *arguments, **more):
    with pytest.raises(Status) as caught:
        call(*arguments, **more)
    return caught.value.code


def names(me):
    return me("GetSystemInfoAttribute", attribute=DEVICE_NAMES)["value"]


def test_the_first_call_after_unplugging_returns_the_reason_and_later_ones_a_lost_device(brain, me):
    task = me.digitizer(INPUT)
    me("StartTask", task)
    brain.unplug(SERIAL)
    read = {"timeout": 1.0}
    assert code_of(me, "ReadBinaryI16", task, **read) == -88710
    assert code_of(me, "ReadBinaryI16", task, **read) == -88709
    assert code_of(me, "StopTask", task) == -88709
    assert brain.record()["reservations"] == {}
    me("ClearTask", task)
    assert brain.record()["tasks"] == []


def test_a_coil_falls_when_its_board_is_unplugged(brain, me):
    coil = me.coil(COUNTER, initial_delay=0.0, high_time=10.0)
    me("StartTask", coil)
    brain.bench.clock.time_ns = 30_000_000
    brain.unplug(SERIAL)
    brain.bench.clock.pass_s(60.0)
    record = brain.record()
    assert [(event["ns"], event["level"]) for event in record["lines"]] == [(0, 1), (30_000_000, 0)]


def test_an_unplugged_board_is_not_listed_and_cannot_be_used(brain, me):
    brain.unplug(SERIAL)
    assert names(me) == "PXI1Slot2, PXI1Slot4, Dev1"
    assert code_of(me, "GetDeviceAttribute", device_name=BOARD, attribute=SERIAL_NUMBER) == -201003
    assert code_of(me, "ResetDevice", device_name=BOARD) == -200324
    assert code_of(me, "SelfCal", device_name=BOARD) == -200324
    task = me("CreateTask")["task"]
    assert code_of(me, "CreateAIVoltageChan", task, physical_channel=INPUT) == -201003


def test_a_board_comes_back_under_another_name_with_its_serial_number(brain, me):
    brain.unplug(SERIAL)
    brain.plug(SERIAL, "Dev7")
    assert names(me) == "PXI1Slot2, Dev7, PXI1Slot4, Dev1"
    assert me("GetDeviceAttribute", device_name="Dev7", attribute=SERIAL_NUMBER)["value"] == SERIAL
    assert code_of(me, "GetDeviceAttribute", device_name=BOARD, attribute=SERIAL_NUMBER) == -201003
    me("StartTask", me.digitizer("Dev7/ai0"))


def test_an_unknown_board_has_no_name(me):
    assert code_of(me, "GetDeviceAttribute", device_name="Dev99", attribute=SERIAL_NUMBER) == -200220


def test_other_boards_go_on(brain, me):
    task = me.digitizer("PXI1Slot2/ai0")
    me("StartTask", task)
    brain.unplug(SERIAL)
    assert not me.is_done(task)


def test_a_reset_takes_the_board_from_everybody(brain, me):
    other = Caller(brain)
    coil = other.coil(COUNTER, initial_delay=0.0, high_time=10.0)
    other("StartTask", coil)
    brain.occupy(f"{BOARD}/ai", "someone's LabVIEW")
    me("ResetDevice", device_name=BOARD)
    record = brain.record()
    assert record["reservations"] == {}
    assert record["levels"][LINE] == 0
    assert code_of(other, "StopTask", coil) == -88709
    other("ClearTask", coil)


def test_a_reset_takes_a_pin_low_that_was_left_high(brain, me):
    # A released counter may go on driving its pin (ni/nidaqmx-python issue 130).
    brain.bench.lines.drive(LINE, 1, 0, "left by somebody")
    assert brain.record()["levels"][LINE] == 1
    me("ResetDevice", device_name=BOARD)
    assert brain.record()["levels"][LINE] == 0


# Calibration


def test_self_calibration_changes_the_polynomial_and_its_date(brain, me):
    task = me.digitizer(INPUT)
    before = me("GetChanAttribute", task, attribute=COEFFICIENTS)["value"]
    dated = me("GetSelfCalLastDateAndTime", device_name=BOARD)
    assert dated == {"year": 2026, "month": 1, "day": 12, "hour": 9, "minute": 30}
    me("SelfCal", device_name=BOARD)
    after = me("GetChanAttribute", task, attribute=COEFFICIENTS)["value"]
    assert after[0] - before[0] == pytest.approx(2e-4, rel=1e-9)
    assert me("GetSelfCalLastDateAndTime", device_name=BOARD) != dated
    assert me("GetCalInfoAttribute", device_name=BOARD, attribute=0x1864)["value"] == 38.5


def test_self_calibration_fails_while_a_task_reserves_the_board(brain, me):
    me.control(me.digitizer(INPUT, name="digitizer C"), COMMIT)
    with pytest.raises(Status, match="digitizer C") as caught:
        Caller(brain)("SelfCal", device_name=BOARD)
    assert caught.value.code == -50103
    # Another board is free.
    me("SelfCal", device_name="PXI1Slot2")


# Power-up states


def test_power_up_states_are_kept_line_by_line(brain, me):
    lines = f"{BOARD}/port2/line4\n{BOARD}/port2/line5"
    me("SetDigitalPowerUpStates", device_name=BOARD, channel_names=lines, state=[LOW, 10310])
    found = me("GetDigitalPowerUpStates", device_name=BOARD, channel_names=lines + f"\n{BOARD}/port1/line0")
    assert found["state"] == [LOW, 10310, 10310]
    wrong = {"device_name": BOARD, "channel_names": f"{BOARD}/port9/line0", "state": [LOW]}
    assert code_of(me, "SetDigitalPowerUpStates", **wrong) == -200170


# Watchdog


def watchdog(me, timeout_s=0.5):
    return line_watchdog(me, f"{BOARD}/port2/line4", [LOW], timeout_s)


def test_a_watchdog_that_is_reset_in_time_does_nothing(brain, me):
    watch = watchdog(me)
    for _ in range(5):
        brain.bench.clock.pass_s(0.4)
        me("ControlWatchdogTask", watch, action=RESET_TIMER)
    assert me("GetWatchdogAttribute", watch, attribute=EXPIRED)["value"] == 0


def test_after_expiry_nothing_pulses_until_it_is_cleared(brain, me):
    watch = watchdog(me)
    brain.bench.clock.pass_s(1.0)
    coil = me.coil(COUNTER)
    assert code_of(me, "StartTask", coil) == -201434
    # The refused start holds nothing: only the watchdog does.
    assert set(brain.record()["reservations"]) == {f"{SERIAL}/watchdog"}
    assert code_of(me, "ControlWatchdogTask", watch, action=RESET_TIMER) == -200644
    me("ControlWatchdogTask", watch, action=CLEAR_EXPIRATION)
    me("StartTask", coil)


def line_watchdog(me, lines, states, timeout_s=0.5):
    made = me("CreateWatchdogTimerTaskEx", device_name=BOARD, session_name="lines", timeout=timeout_s)
    arguments = {"channel_names": lines, "expir_state_array": states, "array_size": len(states)}
    me("CfgWatchdogDOExpirStates", made["task"], **arguments)
    me("StartTask", made["task"])
    return made["task"]


def watched_lines(brain, me, names, states):
    """Let a watchdog expire over lines that are low; return those that it takes high."""
    line_watchdog(me, names, states)
    brain.bench.clock.pass_s(1.0)
    found = brain.record()["lines"]
    assert {(event["level"], event["ns"], event["cause"]) for event in found} == {
        (1, 500_000_000, "watchdog")
    }
    return [event["line"] for event in found]


@pytest.mark.parametrize(
    ("names", "terminals"),
    [
        (f"{BOARD}/port2/line4", ["PFI12"]),
        (f"{BOARD}/port2/line4:6", ["PFI12", "PFI13", "PFI14"]),
        (f"{BOARD}/port2/line6:4", ["PFI14", "PFI13", "PFI12"]),
        (f"/{BOARD.lower()}/port1/line0:1, {BOARD}/PORT2/line0", ["PFI0", "PFI1", "PFI8"]),
        (f"{BOARD}/port1/line7,{BOARD}/port2/line7", ["PFI7", "PFI15"]),
    ],
)
def test_expiry_takes_the_terminals_that_the_lines_are(brain, me, names, terminals):
    high = [HIGH] * len(terminals)
    assert watched_lines(brain, me, names, high) == [f"{SERIAL}/{terminal}" for terminal in terminals]


def test_each_line_goes_to_its_own_state(brain, me):
    names, states = f"{BOARD}/port1/line0:3", [NO_CHANGE, HIGH, TRISTATE, LOW]
    assert watched_lines(brain, me, names, states) == [f"{SERIAL}/PFI1"]


def test_an_expired_watchdog_cuts_the_output_line_of_a_counter(brain, me):
    watch = line_watchdog(me, f"{BOARD}/port2/line4", [LOW])
    coil = me.coil(COUNTER, initial_delay=0.0, high_time=2.0)
    me("StartTask", coil)
    brain.bench.clock.time_ns = 1_000_000_000
    assert me("GetWatchdogAttribute", watch, attribute=EXPIRED)["value"] == 1
    events = [(event["ns"], event["level"], event["cause"]) for event in brain.record()["lines"]]
    assert events == [(0, 1, "pulse"), (500_000_000, 0, "watchdog")]
    (strike,) = brain.record()["strikes"]
    assert strike["released_ns"] == 500_000_000
    assert not me.is_done(coil)
    brain.bench.clock.time_ns = 2_000_000_000
    assert me.is_done(coil)
    assert len(brain.record()["lines"]) == 2


@pytest.mark.parametrize(("lines", "states"), [("line5", [LOW]), ("line4:5", [NO_CHANGE, LOW])])
def test_a_counter_whose_line_is_not_guarded_pulses_on(brain, me, lines, states):
    line_watchdog(me, f"{BOARD}/port2/{lines}", states)
    both = [me.coil(f"{BOARD}/ctr{number}", initial_delay=0.0, high_time=2.0) for number in (0, 1)]
    for coil in both:
        me("StartTask", coil)
    brain.bench.clock.time_ns = 3_000_000_000
    ends = {event["line"]: event["ns"] for event in brain.record()["lines"] if not event["level"]}
    assert ends == {LINE: 2_000_000_000, f"{SERIAL}/PFI13": 500_000_000}


def test_a_reset_takes_low_what_expiry_took_high(brain, me):
    watched_lines(brain, me, f"{BOARD}/port1/line0", [HIGH])
    me("ResetDevice", device_name=BOARD)
    assert [event["level"] for event in brain.record()["lines"]] == [1, 0]


@pytest.mark.parametrize(
    ("names", "states", "code"),
    [
        (f"{BOARD}/port2/line8", [LOW], -200170),
        (f"{BOARD}/port2/line6:8", [LOW] * 3, -200170),
        (f"{BOARD}/port3/line0", [LOW], -200170),
        (f"{BOARD}/port2", [LOW], -200170),
        (f"{BOARD}/ctr0", [LOW], -200170),
        ("Dev99/port2/line4", [LOW], -200220),
        ("PXI1Slot2/port2/line4", [LOW], -200648),
        (f"{BOARD}/port2/line4:6", [LOW], -200077),
        (f"{BOARD}/port2/line4", [17], -200077),
    ],
)
def test_a_watchdog_guards_lines_of_its_own_board_only(brain, me, names, states, code):
    assert code_of(line_watchdog, me, names, states) == code
    # The task exists without settings: it guards nothing.
    (task,) = brain.bench.tasks
    me("StartTask", task)
    brain.bench.clock.pass_s(1.0)
    assert brain.record()["lines"] == []


def test_lines_are_guarded_by_watchdog_tasks_only(me):
    arguments = {"channel_names": f"{BOARD}/port2/line4", "expir_state_array": [LOW], "array_size": 1}
    assert code_of(me, "CfgWatchdogDOExpirStates", me.coil(COUNTER), **arguments) == -200635


def test_expiry_is_readable_only_while_the_watchdog_is_reserved(me):
    watch = watchdog(me)
    assert me("GetWatchdogAttribute", watch, attribute=EXPIRED)["value"] == 0
    me("StopTask", watch)
    assert code_of(me, "GetWatchdogAttribute", watch, attribute=EXPIRED) == -200983


@pytest.mark.parametrize(("timeout_s", "code"), [(34.4, -200668), (0.0, -200668), (-2.0, -200668)])
def test_a_watchdog_runs_34_seconds_at_most(me, timeout_s, code):
    assert code_of(watchdog, me, timeout_s) == code


def test_boards_without_a_watchdog_are_reported(me):
    arguments = {"device_name": "PXI1Slot4", "session_name": "", "timeout": 1.0}
    assert code_of(me, "CreateWatchdogTimerTaskEx", **arguments) == -200662


def test_two_watchdogs_do_not_share_a_board(brain, me):
    watchdog(me)
    other = Caller(brain)
    assert code_of(watchdog, other) == -50103


def test_only_watchdog_tasks_are_controlled_as_such(me):
    task = me.coil(COUNTER)
    assert code_of(me, "ControlWatchdogTask", task, action=RESET_TIMER) == -200635
