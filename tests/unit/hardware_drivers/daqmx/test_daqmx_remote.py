"""The channel to a remote chassis whose server was away."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import pytest
from support.daqmx_rig import Forwarder

grpc = pytest.importorskip("grpc")

NOBODY = "127.0.0.1:1"


def answer(channel):
    """Status of a call that no server knows: a server that is there says so."""
    with pytest.raises(grpc.RpcError) as refused:
        channel.calls.unary_unary("/nobody/knows")(b"")
    return refused.value.code()


def channel_to(address):
    from hardware_drivers.daqmx.remote import Channel

    return Channel(address, call_timeout_s=5.0, record_samples=1_000)


def test_a_new_channel_reaches_a_server_that_is_back_at_once():
    """Whatever pause an old channel is in: the rungs of the recovery are few."""
    with ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor(1))
        server = grpc.server(pool)
        port = server.add_insecure_port("127.0.0.1:0")
        server.start()
        stack.callback(lambda: server.stop(None).wait())
        forwarder = stack.enter_context(Forwarder(NOBODY))
        old = channel_to(forwarder.address)
        stack.callback(old.close)
        for _ in range(5):
            assert answer(old) is grpc.StatusCode.UNAVAILABLE
        forwarder.target = f"127.0.0.1:{port}"
        new = channel_to(forwarder.address)
        stack.callback(new.close)
        assert answer(new) is grpc.StatusCode.UNIMPLEMENTED
