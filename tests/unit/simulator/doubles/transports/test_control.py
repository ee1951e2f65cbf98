"""The control channel and the process around the brain."""

import json
import threading

import pytest
from support.doubles_bench import one_board_description
from support.waiting import WAIT_S, happened
from support.wire_client import decode_answer, encode_call

from hardware_drivers.measurement import ShotKey
from simulator.doubles.device_model import Brain
from simulator.doubles.errors import DoublesProcessError
from simulator.doubles.transports.control import DoublesControl, running_doubles
from simulator.doubles.transports.control_server import ControlServer
from simulator.doubles.transports.server import WireServer
from simulator.doubles.vendor_api import wire
from simulator.doubles.vendor_api.entry_points import ENTRY_POINTS

DESCRIPTION = one_board_description()
POLL_S = 0.01
"""The servers notice within this time that they shall end."""


@pytest.fixture
def served():
    """A brain, its two servers in threads, and a connected control."""
    brain = Brain(DESCRIPTION)
    with WireServer(brain) as library, ControlServer(brain) as control:
        for server in (library, control):
            threading.Thread(target=server.serve_forever, args=(POLL_S,), daemon=True).start()
        with DoublesControl(control.address) as client:
            yield brain, library, client
        for server in (library, control):
            server.shutdown()


def test_each_command_reaches_the_brain(served):
    brain, _, control = served
    control.announce(ShotKey(position="B", set_index=3, shot_index=1), 12.5)
    assert brain.bench.strikes.plan("B", 0, 20_000_000).key == ShotKey(
        position="B", set_index=3, shot_index=1
    )
    control.occupy("PXI1Slot3/ctr0", "someone")
    assert control.record()["reservations"] == {
        "31547526/ctr0": {"client": "another process", "task": "someone"}
    }
    control.vacate("someone")
    assert control.record()["reservations"] == {}
    control.unplug(0x01E16086)
    assert [board["plugged"] for board in control.record()["boards"]] == [False]
    control.plug(0x01E16086, "Dev4")
    assert [board["name"] for board in control.record()["boards"]] == ["Dev4"]
    control.inject("DAQmxCreateTask", "error", code=-50103)
    assert brain.faults.due("DAQmxCreateTask", "").code == -50103
    control.inject("DAQmxCreateTask", "error", code=-50103)
    control.clear_faults()
    assert brain.faults.due("DAQmxCreateTask", "") is None
    assert control.wait_until_hanging(0.0) is False
    control.release_hangs()
    assert control.wait_until_no_tasks(0.0) is True
    control.clear_record()
    assert control.record()["calls"] == []


def test_the_rig_waits_until_every_striker_has_landed(served):
    brain, _, control = served
    assert control.wait_until_quiet(0.0) is True
    now_ns = brain.bench.clock.now_ns()
    strike = brain.bench.strikes.plan("B", now_ns, now_ns + 50_000_000)
    assert control.wait_until_quiet(0.0) is False
    happened(control.wait_until_quiet, "the striker landed")
    assert brain.bench.clock.now_ns() > strike.contact_ns


@pytest.mark.parametrize(
    ("request_text", "reason"),
    [
        ('{"command": "explode"}', "no such command"),
        ('{"command": "unplug", "serial_number": 5}', "KeyError"),
        (
            '{"command": "announce", "key": {"position": "Z", "set_index": 0, "shot_index": 0}, "hour_h": 0}',
            "nothing is wired",
        ),
        ('{"command": "occupy", "resource": "Dev77/ai", "owner": "me"}', "-200220"),
        ("no JSON", "JSONDecodeError"),
        ("[1]", "TypeError|ValueError"),
    ],
)
def test_an_invalid_message_is_answered_and_the_channel_continues(served, request_text, reason):
    *_, control = served
    control._socket.sendall(request_text.encode() + b"\n")
    answer = json.loads(control._file.readline())
    assert any(word in answer["error"] for word in reason.split("|"))
    assert control.record()["tasks"] == []


def connect(library):
    """A Python client of the wire: joined like the C library."""
    import socket
    import struct

    host, port = library.address.split(":")
    connection = socket.create_connection((host, int(port)), timeout=WAIT_S)
    connection.sendall(struct.pack("<I", wire.HELLO.size) + wire.HELLO.pack(4711, 0))
    (number,) = struct.unpack("<Q", wire.receive_exactly(connection, 8))
    assert number > 0
    return connection


def ask(connection, name, **arguments):
    entry = ENTRY_POINTS[name]
    wire.send_frame(connection, encode_call(entry, arguments))
    return decode_answer(entry, arguments, wire.receive_frame(connection))


def test_the_wire_serves_a_client_and_tears_down_after_it(served):
    brain, library, control = served
    with connect(library) as connection:
        status, _, values = ask(connection, "DAQmxCreateTask", session_name="mine")
        assert status == 0
        assert control.record()["tasks"][0]["client"].startswith("library:pid 4711")
        assert ask(connection, "DAQmxStartTask", task=values["task"])[0] == -200478
    happened(control.wait_until_no_tasks, "the brain heard that its client is gone")
    assert [leak["task"] for leak in brain.record()["leaked"]] == ["mine"]


def test_a_fault_of_the_double_names_itself(served, monkeypatch):
    brain, library, _ = served
    monkeypatch.setattr(brain, "call", lambda *_: 1 / 0)
    with connect(library) as connection:
        status, text, _ = ask(connection, "DAQmxCreateTask", session_name="mine")
    assert status == -50150
    assert "DAQmxCreateTask failed inside the double: ZeroDivisionError" in text


def test_a_peer_that_sends_invalid_data_is_disconnected(served):
    _, library, control = served
    with connect(library) as connection:
        wire.send_frame(connection, b"\x05\x00nonse")
        assert wire.receive_frame(connection) is None
    assert control.record()["tasks"] == []


# The process


def test_the_double_prints_its_address_and_ends_with_its_standard_input():
    with running_doubles(DESCRIPTION, warm_up=False) as running:
        assert [board["name"] for board in running.control.record()["boards"]] == ["PXI1Slot3"]
    assert running.process.returncode == 0


def test_a_killed_double_is_reported(served):
    *_, another = served
    with running_doubles(DESCRIPTION, warm_up=False) as running:
        running.kill()
        with pytest.raises(DoublesProcessError, match=r"gone|does not answer"):
            running.control.record()
    assert another.record()["tasks"] == []


def test_a_double_that_does_not_start_reports_it(monkeypatch):
    monkeypatch.setattr("simulator.doubles.transports.control.to_json", lambda description: '{"boards": 5}')
    with pytest.raises(DoublesProcessError, match="ended with code 1"), running_doubles(DESCRIPTION):
        pytest.fail("it started")
