"""The gRPC front, met by the unmodified `nidaqmx` package on a real channel; the brain is a script here."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from simulator.doubles.vendor_api.entry_points import ENTRY_POINTS, HANDLE, Role, Tail
from simulator.doubles.vendor_api.statuses import Status

grpc = pytest.importorskip("grpc", reason='needs the extra "solimon[grpc]"')
nidaqmx = pytest.importorskip("nidaqmx")

from nidaqmx import GrpcSessionOptions, SessionInitializationBehavior  # noqa: E402
from nidaqmx._stubs import nidaqmx_pb2, nidaqmx_pb2_grpc  # noqa: E402
from nidaqmx.constants import Slope  # noqa: E402
from nidaqmx.errors import DaqError, DaqReadError, RpcError  # noqa: E402
from nidaqmx.stream_readers import AnalogUnscaledReader  # noqa: E402

from simulator.doubles.errors import DoublesError  # noqa: E402
from simulator.doubles.transports import grpc_front  # noqa: E402
from simulator.doubles.transports.grpc_front import GrpcFront, Sessions, entry_of, fill_response, to_arguments  # noqa: E402

METHODS = {
    method.name: method
    for method in nidaqmx_pb2.DESCRIPTOR.services_by_name["NiDAQmx"].methods
    if entry_of(method.name) is not None
}
CHANNELS = 0x1273
VERSION = {0x1272: 24, 0x1923: 8, 0x2F22: 0}


class Script:
    """A brain with scripted answers that records its calls."""

    def __init__(self):
        self.calls: list[tuple[str, Mapping[str, Any]]] = []
        self.answers: dict[str, Mapping[str, Any] | Status] = {}
        self._next_task = 100

    def __call__(self, function, arguments):
        if function == "DAQmxGetSystemInfoAttribute" and arguments["attribute"] in VERSION:
            return {"value": VERSION[arguments["attribute"]]}
        if function == "DAQmxGetErrorString":
            return {"error_string": f"text of {arguments['error_code']}"}
        if function == "DAQmxGetTaskAttribute":
            return {"value": "PXI1Slot2/ai0" if arguments["attribute"] == CHANNELS else "a task"}
        if function == "DAQmxGetReadAttribute":
            return {"value": 1}
        self.calls.append((function, arguments))
        answer = self.answers.get(function, {})
        if isinstance(answer, Status):
            raise answer
        if function in ("DAQmxCreateTask", "DAQmxCreateWatchdogTimerTaskEx") and not answer:
            self._next_task += 1
            return {"task": self._next_task}
        return answer

    def asked(self, function):
        return [arguments for name, arguments in self.calls if name == function]


@pytest.fixture
def script():
    return Script()


@pytest.fixture
def channel(script):
    front = GrpcFront(script)
    channel = grpc.insecure_channel(front.address)
    yield channel
    channel.close()
    front.close()


@pytest.fixture
def options(channel):
    return GrpcSessionOptions(channel, "")


@pytest.fixture
def task(options):
    with nidaqmx.Task(grpc_options=options) as task:
        yield task


def test_attributes_come_and_go_by_their_numbers(script, task):
    script.answers["DAQmxGetTimingAttribute"] = {"value": 9_999_999.5}
    assert task.timing.samp_clk_rate == 9_999_999.5
    task.timing.samp_clk_rate = 5e6
    assert script.asked("DAQmxSetTimingAttribute") == [{"task": 101, "attribute": 0x1344, "value": 5e6}]
    script.answers["DAQmxGetTrigAttribute"] = {"value": Slope.RISING.value}
    assert task.triggers.reference_trigger.anlg_edge_slope is Slope.RISING


def test_a_warning_is_no_error(script, task):
    script.answers["DAQmxStopTask"] = Status(200010)
    task.stop()


def test_a_short_read_returns_the_number_of_samples(script, task):
    task.ai_channels.add_ai_voltage_chan("PXI1Slot2/ai0")
    script.answers["DAQmxReadBinaryI16"] = Status(
        -200284, values={"read_array": np.zeros(10, dtype=np.int16), "samps_per_chan_read": 7}
    )
    buffer = np.full((1, 10), 3, dtype=np.int16)
    with pytest.raises(DaqReadError) as raised:
        AnalogUnscaledReader(task.in_stream).read_int16(buffer, 10, timeout=0.1)
    assert (raised.value.error_code, raised.value.samps_per_chan_read) == (-200284, 7)
    # Over the library the buffer stays as it was: a driver must not use it after an error in any case.
    assert not buffer.any()


def test_a_read_without_samples_is_an_error(script, task):
    task.ai_channels.add_ai_voltage_chan("PXI1Slot2/ai0")
    script.answers["DAQmxReadBinaryI16"] = Status(-200279)
    with pytest.raises(DaqError) as raised:
        AnalogUnscaledReader(task.in_stream).read_int16(np.zeros((1, 10), dtype=np.int16), 10)
    assert raised.value.error_code == -200279


def test_unknown_calls_are_unimplemented(task):
    with pytest.raises(RpcError) as raised:
        task.timing.cfg_handshaking_timing()
    assert raised.value.rpc_code == grpc.StatusCode.UNIMPLEMENTED


def test_an_unnamed_task_is_always_new(script, options):
    with nidaqmx.Task(grpc_options=options) as one, nidaqmx.Task(grpc_options=options) as other:
        one.start()
        other.start()
    assert [call["task"] for call in script.asked("DAQmxStartTask")] == [101, 102]
    assert [call["task"] for call in script.asked("DAQmxClearTask")] == [102, 101]


def named(channel, behavior):
    return GrpcSessionOptions(channel, "striker", initialization_behavior=behavior)


def test_a_named_task_is_attached_to_and_outlives_who_attached(script, channel):
    auto = named(channel, SessionInitializationBehavior.AUTO)
    attach = named(channel, SessionInitializationBehavior.ATTACH_TO_SERVER_SESSION)
    with nidaqmx.Task("striker", grpc_options=auto):
        for options in (auto, attach):
            with nidaqmx.Task("striker", grpc_options=options) as again:
                again.start()
        assert [call["session_name"] for call in script.asked("DAQmxCreateTask")] == ["striker"]
        assert [call["task"] for call in script.asked("DAQmxStartTask")] == [101, 101]
        assert script.asked("DAQmxClearTask") == []
    assert [call["task"] for call in script.asked("DAQmxClearTask")] == [101]
    with nidaqmx.Task("striker", grpc_options=auto):
        assert len(script.asked("DAQmxCreateTask")) == 2


def test_names_that_contradict_the_wish_are_refused(channel):
    attach = named(channel, SessionInitializationBehavior.ATTACH_TO_SERVER_SESSION)
    initialize = named(channel, SessionInitializationBehavior.INITIALIZE_SERVER_SESSION)
    with pytest.raises(RpcError, match="no session named 'striker'") as raised:
        nidaqmx.Task("striker", grpc_options=attach)
    assert raised.value.rpc_code == grpc.StatusCode.FAILED_PRECONDITION
    with nidaqmx.Task("striker", grpc_options=initialize):
        with pytest.raises(RpcError, match="exists already") as raised:
            nidaqmx.Task("striker", grpc_options=initialize)
        assert raised.value.rpc_code == grpc.StatusCode.ALREADY_EXISTS


def test_a_task_that_cannot_be_created_leaves_no_name(script, channel):
    script.answers["DAQmxCreateTask"] = Status(-200089)
    auto = named(channel, SessionInitializationBehavior.AUTO)
    with pytest.raises(DaqError):
        nidaqmx.Task("striker", grpc_options=auto)
    del script.answers["DAQmxCreateTask"]
    with nidaqmx.Task("striker", grpc_options=auto) as task:
        task.start()


def test_a_task_s_name_is_free_again_even_if_clearing_it_failed(script, channel):
    """As NI's server does: it drops the name before it asks the driver."""
    auto = named(channel, SessionInitializationBehavior.AUTO)
    script.answers["DAQmxClearTask"] = Status(-50405)
    with pytest.raises(DaqError):
        nidaqmx.Task("striker", grpc_options=auto).close()
    script.answers.clear()
    with nidaqmx.Task("striker", grpc_options=auto) as task:
        task.start()
    assert script.asked("DAQmxStartTask") == [{"task": 102}]


def test_an_address_in_use_is_refused(script):
    front = GrpcFront(script)
    try:
        with pytest.raises(DoublesError, match=front.address):
            GrpcFront(script, front.address)
    finally:
        front.close()


def test_without_grpc_the_package_to_install_is_named(script, monkeypatch):
    monkeypatch.setattr(grpc_front, "_is_installed", lambda name: name != "grpc")
    with pytest.raises(DoublesError, match=r'grpc not installed: python -m pip install "solimon\[grpc\]"'):
        GrpcFront(script)


def test_every_entry_with_a_method_is_served():
    without = {name for name in ENTRY_POINTS if name.startswith("DAQmx")} - {
        entry_of(method).name for method in METHODS
    }
    assert without == {
        "DAQmxSetRuntimeEnvironment",
        "DAQmxInternalGetLastCreatedChan",
    }


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_every_input_of_the_table_is_found_in_the_request(method):
    entry = entry_of(method.name)
    request = getattr(nidaqmx_pb2, method.input_type.name)()
    arguments = to_arguments(entry, request, Sessions())
    wanted = {p.name for p in entry.parameters if p.goes_in}
    wanted |= {"value"} if entry.tail is Tail.SET_ATTRIBUTE else set()
    wanted |= {"channel_names"} if entry.tail in (Tail.SET_STATES, Tail.GET_STATES) else set()
    wanted |= {"state"} if entry.tail is Tail.SET_STATES else set()
    assert set(arguments) == wanted


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_every_output_of_the_table_has_its_field(method):
    entry = entry_of(method.name)
    response = getattr(nidaqmx_pb2, method.output_type.name)()
    fields = response.DESCRIPTOR.fields_by_name
    outputs = [p for p in entry.parameters if p.goes_out and p.c_type != HANDLE]
    for parameter in outputs:
        assert parameter.name in fields, parameter.name
        value = {Role.OUT: 1, Role.OUT_TEXT: "x", Role.OUT_ARRAY: np.ones(2, dtype=np.int16)}[parameter.role]
        fill_response(entry, response, {parameter.name: value}, 0)
        assert getattr(response, parameter.name), parameter.name


def test_power_up_states_travel_both_ways(script, options):
    script.answers["DAQmxGetDigitalPowerUpStates"] = {"state": np.array([10214, 10310], dtype=np.int32)}
    client = nidaqmx_pb2_grpc.NiDAQmxStub(options.grpc_channel)
    got = client.GetDigitalPowerUpStates(
        nidaqmx_pb2.GetDigitalPowerUpStatesRequest(device_name="Dev1", channel_name=["a", "b"])
    )
    assert list(got.power_up_states) == [10214, 10310]
    assert script.asked("DAQmxGetDigitalPowerUpStates")[0]["channel_names"] == "a\nb"
    low = nidaqmx_pb2.DigitalPowerUpChannelsAndState(channel_names="a", state=10214)
    client.SetDigitalPowerUpStates(
        nidaqmx_pb2.SetDigitalPowerUpStatesRequest(device_name="Dev1", power_up_states=[low])
    )
    asked = script.asked("DAQmxSetDigitalPowerUpStates")[0]
    assert (asked["channel_names"], asked["state"].tolist()) == ("a", [10214])
