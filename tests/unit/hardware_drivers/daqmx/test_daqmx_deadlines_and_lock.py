"""Every gRPC call ends, and one process of a computer uses a client name."""

import os
import subprocess
import sys
import uuid
from types import SimpleNamespace

import pytest

from hardware_drivers.daqmx.client_lock import ClientLock
from hardware_drivers.daqmx.connection import build_client_name
from hardware_drivers.daqmx.instruments import open_daqmx
from hardware_drivers.daqmx.parameters import DaqmxParameters, TransducerWiring
from hardware_drivers.errors import BusyError, ConfigurationError


@pytest.fixture
def client():
    """Return a unique name."""
    return f"test-{uuid.uuid4().hex}"


def test_a_name_is_held_by_one_and_free_again_after_it(client):
    first = ClientLock("chassis:1", client)
    with pytest.raises(BusyError, match=f"process {os.getpid()}"):
        ClientLock("chassis:1", client)
    ClientLock("chassis:2", client).release()
    first.release()
    first.release()
    ClientLock("chassis:1", client).release()


def test_a_killed_process_leaves_no_lock(client):
    code = (
        "import sys\nfrom hardware_drivers.daqmx.client_lock import ClientLock\n"
        f"lock = ClientLock('chassis:1', {client!r})\nprint('held', flush=True)\nsys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(BusyError, match=f"process {holder.pid}"):
            ClientLock("chassis:1", client)
        holder.kill()
    ClientLock("chassis:1", client).release()


def test_the_client_is_named_by_the_settings_or_the_computer():
    wiring = {"B": TransducerWiring(board_serial="1")}
    assert build_client_name(DaqmxParameters(transducers=wiring, grpc_client_name="rig-2")) == "rig-2"
    assert build_client_name(DaqmxParameters(transducers=wiring))


@pytest.mark.parametrize(
    ("method", "request_", "expected_s"),
    [
        ("/nidaqmx_grpc.NiDAQmx/StartTask", SimpleNamespace(), 2.0),
        ("/nidaqmx_grpc.NiDAQmx/WaitUntilTaskDone", SimpleNamespace(time_to_wait=1.5), 3.5),
        ("/nidaqmx_grpc.NiDAQmx/ReadBinaryI16", SimpleNamespace(timeout=5.0), 7.0),
        ("/nidaqmx_grpc.NiDAQmx/ReadBinaryI32", SimpleNamespace(timeout=-1.0), 2.0),
        ("/nidaqmx_grpc.NiDAQmx/SelfCal", SimpleNamespace(), 20.0),
        ("/nidaqmx_grpc.NiDAQmx/ResetDevice", SimpleNamespace(), 20.0),
    ],
)
def test_a_call_has_its_own_wait_and_then_the_deadline(method, request_, expected_s):
    pytest.importorskip("grpc", reason="the grpc extra is not installed")
    from hardware_drivers.daqmx.remote import Deadlines

    assert Deadlines(2.0).deadline_s(method, request_) == expected_s


def test_the_deadline_reaches_the_call():
    pytest.importorskip("grpc", reason="the grpc extra is not installed")
    from hardware_drivers.daqmx.remote import Deadlines

    sent = []
    details = SimpleNamespace(
        method="/nidaqmx_grpc.NiDAQmx/StartTask",
        timeout=None,
        metadata=(("ni-api-key", "k"),),
        credentials=None,
        wait_for_ready=None,
        compression=None,
    )
    Deadlines(2.0).intercept_unary_unary(lambda bounded, _: sent.append(bounded), details, SimpleNamespace())
    assert (sent[0].method, sent[0].timeout, sent[0].metadata) == (details.method, 2.0, details.metadata)


def test_grpc_without_its_extra_is_reported_with_the_remedy(monkeypatch):
    for name in ("hardware_drivers.daqmx.remote", "nidaqmx._grpc_interpreter"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, "grpc", None)
    parameters = DaqmxParameters(
        transducers={"B": TransducerWiring(board_serial="1")},
        transport="grpc",
        grpc_address="127.0.0.1:1",
        grpc_client_name=f"test-{uuid.uuid4().hex[:20]}",
    )
    with pytest.raises(ConfigurationError, match=r"grpc is not installed; .*solimon\[grpc\]"):
        open_daqmx(parameters).__enter__()
