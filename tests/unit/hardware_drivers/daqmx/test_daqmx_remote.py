"""The channel to a remote chassis: whose server was away, past web proxies, with gRPC's own reasons."""

import socket
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import pytest
from support.daqmx_rig import Forwarder

from hardware_drivers.daqmx.connection import Connection
from hardware_drivers.daqmx.parameters import DaqmxParameters, TransducerWiring
from hardware_drivers.errors import ConnectionLostError

grpc = pytest.importorskip("grpc")

UNUSED_ADDRESS = "127.0.0.1:1"


def answer(channel):
    """Status of a call that no server knows: a server that is there says so."""
    with pytest.raises(grpc.RpcError) as refused:
        channel.calls.unary_unary("/nobody/knows")(b"")
    return refused.value.code()


def channel_to(address):
    from hardware_drivers.daqmx.remote import Channel

    return Channel(address, call_timeout_s=5.0, record_samples=1_000)


def test_a_new_channel_reaches_a_server_that_is_back_at_once():
    """For any pause of an old channel: the rungs of the recovery are few."""
    with ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor(1))
        server = grpc.server(pool)
        port = server.add_insecure_port("127.0.0.1:0")
        server.start()
        stack.callback(lambda: server.stop(None).wait())
        forwarder = stack.enter_context(Forwarder(UNUSED_ADDRESS))
        old = channel_to(forwarder.address)
        stack.callback(old.close)
        for _ in range(5):
            assert answer(old) is grpc.StatusCode.UNAVAILABLE
        forwarder.target = f"127.0.0.1:{port}"
        new = channel_to(forwarder.address)
        stack.callback(new.close)
        assert answer(new) is grpc.StatusCode.UNIMPLEMENTED


PROXY_VARIABLES = ("http_proxy", "https_proxy", "grpc_proxy", "all_proxy", "HTTP_PROXY", "HTTPS_PROXY")


def test_no_variable_leads_the_channel_through_a_web_proxy(monkeypatch):
    for variable in PROXY_VARIABLES:
        monkeypatch.setenv(variable, f"http://{UNUSED_ADDRESS}")
    monkeypatch.setenv("GRPC_ADDRESS_HTTP_PROXY", UNUSED_ADDRESS)
    monkeypatch.setenv("GRPC_ADDRESS_HTTP_PROXY_ENABLED_ADDRESSES", "127.0.0.0/8")
    with ExitStack() as stack:
        server = grpc.server(stack.enter_context(ThreadPoolExecutor(1)))
        port = server.add_insecure_port("127.0.0.1:0")
        server.start()
        stack.callback(lambda: server.stop(None).wait())
        channel = channel_to(f"127.0.0.1:{port}")
        stack.callback(channel.close)
        assert answer(channel) is grpc.StatusCode.UNIMPLEMENTED


@pytest.mark.parametrize(
    ("address", "reason"),
    [
        (UNUSED_ADDRESS, "Connection refused"),
        (f"{'x' * 64}.lab:31763", "errors resolving x"),
        (None, "Deadline Exceeded"),
    ],
)
def test_the_grpc_reason_is_in_the_message_and_in_the_finding_of_doctor(address, reason):
    """NI's package has one text for every unavailable server."""
    pytest.importorskip("nidaqmx")
    from hardware_drivers.daqmx.survey import survey_rig

    with socket.create_server(("127.0.0.1", 0)) as silent:  # it takes connections and answers nothing
        given = address or "{}:{}".format(*silent.getsockname())
        wiring = {"B": TransducerWiring(board_serial="1")}
        parameters = DaqmxParameters(
            transducers=wiring,
            transport="grpc",
            grpc_address=given,
            call_timeout_s=0.1 if address is None else 5.0,
        )
        connection = Connection(parameters)
        with pytest.raises(ConnectionLostError, match=reason):
            connection.driver_version()
        connection.close()
        (finding,) = survey_rig(parameters).findings
    assert (finding.subject, finding.state) == ("driver", "fail")
    assert reason in finding.detail
