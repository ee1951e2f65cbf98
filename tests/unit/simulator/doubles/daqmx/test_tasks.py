"""Tasks go through NI's states, hold what they reserve, and answer for what they lost."""

import pytest
from support.doubles_bench import Caller, SteppedClock, one_board_description

from simulator.doubles.chassis.description import build_default_description
from simulator.doubles.device_model import Brain
from simulator.doubles.vendor_api.statuses import Status

BOARD = "PXI1Slot3"
INPUT, COUNTER = f"{BOARD}/ai0", f"{BOARD}/ctr0"
VERIFY, COMMIT, RESERVE, UNRESERVE, ABORT = 2, 3, 4, 5, 6


@pytest.fixture
def brain():
    return Brain(one_board_description(), clock=SteppedClock())


@pytest.fixture
def me(brain):
    return Caller(brain)


def state(brain):
    (task,) = brain.record()["tasks"]
    return task["state"]


def refused(code, *arguments, **more):
    call, *rest = arguments
    with pytest.raises(Status) as caught:
        call(*rest, **more)
    assert caught.value.code == code, caught.value.message
    return caught.value.message


@pytest.mark.parametrize(
    ("action", "reached"), [(VERIFY, "verified"), (RESERVE, "reserved"), (COMMIT, "committed")]
)
def test_stopping_goes_back_to_the_state_before_the_start(brain, me, action, reached):
    task = me.digitizer(INPUT)
    assert state(brain) == "unverified"
    me.control(task, action)
    assert state(brain) == reached
    me("StartTask", task)
    assert state(brain) == "running"
    refused(200010, me, "StopTask", task)
    assert state(brain) == reached
    assert bool(brain.record()["reservations"]) == (reached != "verified")


def test_a_start_from_nothing_verifies_and_releases_again(brain, me):
    task = me.coil(COUNTER)
    me("StartTask", task)
    assert set(brain.record()["reservations"]) == {"31547526/ctr0", "31547526/PFI12"}
    refused(200010, me, "StopTask", task)
    assert state(brain) == "verified"
    assert brain.record()["reservations"] == {}


def test_stopping_a_finished_or_unstarted_task_gives_no_warning(brain, me):
    task = me.coil(COUNTER)
    me("StopTask", task)
    me("StartTask", task)
    me("WaitUntilTaskDone", task, time_to_wait=1.0)
    me("StopTask", task)


def test_unreserving_keeps_the_task_verified(brain, me):
    task = me.digitizer(INPUT)
    me.control(task, COMMIT)
    me.control(task, UNRESERVE)
    assert state(brain) == "verified"
    assert brain.record()["reservations"] == {}


def test_aborting_a_running_task_releases_it(brain, me):
    task = me.digitizer(INPUT)
    me("StartTask", task)
    me.control(task, ABORT)
    assert state(brain) == "verified"
    assert brain.record()["reservations"] == {}


@pytest.mark.parametrize("action", [UNRESERVE])
def test_a_running_task_is_not_unreserved(brain, me, action):
    task = me.digitizer(INPUT)
    me("StartTask", task)
    refused(-200479, me.control, task, action)


def test_a_running_task_takes_no_new_settings(brain, me):
    task = me.digitizer(INPUT)
    me("StartTask", task)
    refused(-200479, me, "CfgSampClkTiming", task, rate=1e6, samps_per_chan=100)
    refused(-200479, me, "CreateAIVoltageChan", task, physical_channel=f"{BOARD}/ai1")
    refused(-200557, me, "SetTimingAttribute", task, attribute=0x1344, value=1e6)
    refused(-200479, me, "StartTask", task)


def test_a_committed_task_with_a_new_setting_is_verified_again(brain, me):
    task = me.digitizer(INPUT)
    me.control(task, COMMIT)
    me("SetTimingAttribute", task, attribute=0x1344, value=20e6)
    assert state(brain) == "reserved"
    refused(-200077, me, "StartTask", task)
    refused(-200077, me.control, task, COMMIT)


def test_a_cleared_task_is_invalid_and_holds_nothing(brain, me):
    task = me.digitizer(INPUT)
    me("StartTask", task)
    me("ClearTask", task)
    assert brain.record()["tasks"] == []
    assert brain.record()["reservations"] == {}
    refused(-200088, me, "StartTask", task)
    refused(-200088, me, "ClearTask", task)


def test_a_task_belongs_to_its_client(brain, me):
    task = me.digitizer(INPUT)
    refused(-200088, Caller(brain), "StartTask", task)


def test_names_are_unique_within_a_client_and_made_up_when_missing(brain, me):
    me("CreateTask", session_name="striker")
    refused(-200089, me, "CreateTask", session_name="striker")
    Caller(brain)("CreateTask", session_name="striker")
    made_up = me("CreateTask")["task"]
    assert me("GetTaskAttribute", made_up, attribute=0x1276)["value"].startswith("_unnamedTask<")


@pytest.mark.parametrize("function", ["StartTask", "TaskControl"])
def test_a_task_without_channels_does_nothing(brain, me, function):
    task = me("CreateTask")["task"]
    arguments = {"action": COMMIT} if function == "TaskControl" else {}
    refused(-200478, me, function, task, **arguments)


def test_a_task_takes_one_channel(brain, me):
    task = me.digitizer(INPUT)
    assert f"The task has the channel {INPUT}" in refused(
        -200077, me, "CreateAIVoltageChan", task, physical_channel=f"{BOARD}/ai1"
    )
    refused(-200077, me, "CreateCOPulseChanTime", task, counter=COUNTER)


@pytest.mark.parametrize(
    ("name", "code"),
    [
        (f"{BOARD}/ai8", -200170),
        (f"{BOARD}/ai0:1", -200170),
        (f"{BOARD}/ai0, {BOARD}/ai1", -200170),
        (f"{BOARD}/ctr0", -200170),
        (f"{BOARD}/", -200170),
        ("Dev9/ai0", -200220),
        ("", -200220),
    ],
)
def test_missing_channels_are_refused(brain, me, name, code):
    task = me("CreateTask")["task"]
    refused(code, me, "CreateAIVoltageChan", task, physical_channel=name)


def test_the_last_channel_is_returned(brain, me):
    me.digitizer(f"{BOARD}/ai5")
    assert me("InternalGetLastCreatedChan")["value"] == f"{BOARD}/ai5"


def test_missing_channels_and_attributes_are_refused(brain, me):
    task = me.digitizer(INPUT)
    refused(-200486, me, "GetChanAttribute", task, channel=f"{BOARD}/ai3", attribute=0x1815)
    refused(-200233, me, "GetChanAttribute", task, attribute=0x1344)
    refused(-200197, me, "GetChanAttribute", task, attribute=0x18BA)
    refused(-200231, me, "SetChanAttribute", task, attribute=0x1815, value=1.0)


def test_an_attribute_that_the_drivers_never_ask_for_is_refused_by_name_and_number(me):
    task = me.digitizer(INPUT)
    assert "The double has no Chan attribute 0x17dd" in refused(
        -200233, me, "GetChanAttribute", task, attribute=0x17DD
    )


# Reservations


def test_another_task_of_the_same_process_is_named(brain, me):
    me.control(me.digitizer(INPUT, name="digitizer B"), RESERVE)
    other = me.digitizer(f"{BOARD}/ai1", name="digitizer C")
    assert "digitizer B" in refused(-200022, me.control, other, RESERVE)
    assert "Task Name: digitizer C" in refused(-200022, me, "StartTask", other)


def test_another_process_is_named_with_its_task(brain, me):
    me.control(me.coil(COUNTER, name="coil B"), COMMIT)
    other = Caller(brain, label="pid 77")
    message = refused(-50103, other.control, other.coil(COUNTER), COMMIT)
    assert "coil B" in message
    assert me.name in message


def test_a_refused_start_holds_nothing(brain, me):
    brain.occupy(f"{BOARD}/PFI12", "someone's LabVIEW")
    task = me.coil(COUNTER)
    assert "someone's LabVIEW" in refused(-50103, me, "StartTask", task)
    assert set(brain.record()["reservations"]) == {"31547526/PFI12"}
    brain.vacate("someone's LabVIEW")
    me("StartTask", task)


def test_boards_do_not_share_reservations():
    brain = Brain(build_default_description(), clock=SteppedClock())
    me = Caller(brain)
    for board in ("PXI1Slot2", "PXI1Slot3", "PXI1Slot4"):
        me.control(me.digitizer(f"{board}/ai0"), COMMIT)
    assert len(brain.record()["reservations"]) == 3


# Clients that go away


def test_a_library_s_tasks_end_with_its_process_and_are_noted(brain, me):
    clock = brain.bench.clock
    task = me.coil(COUNTER, name="coil B")
    me("StartTask", task)
    clock.pass_s(0.01)
    brain.close_client(me.name)
    record = brain.record()
    assert record["tasks"] == []
    assert record["reservations"] == {}
    assert record["levels"]["31547526/PFI12"] == 0
    (leak,) = record["leaked"]
    assert (leak["task"], leak["state"]) == ("coil B", "running")
    assert set(leak["reservations"]) == {"31547526/ctr0", "31547526/PFI12"}


def test_a_grpc_server_s_tasks_stay(brain):
    server = Caller(brain, kind="grpc", label="server")
    server.control(server.digitizer(INPUT), COMMIT)
    brain.close_client(server.name)
    assert state(brain) == "committed"
    assert set(brain.record()["reservations"]) == {"31547526/ai"}
    assert len(brain.record()["leaked"]) == 1


def test_a_tidy_client_leaks_nothing(brain, me):
    me("ClearTask", me.digitizer(INPUT))
    brain.close_client(me.name)
    assert brain.record()["leaked"] == []
