"""The way to a remote chassis, encrypted as NI's gRPC device server is configured: by one side or by both."""

import re
import shutil
import subprocess
from functools import partial

import pytest

from hardware_drivers.daqmx.parameters import DaqmxParameters, GrpcTls, TransducerWiring
from hardware_drivers.daqmx.translation import translate_error
from hardware_drivers.errors import ConfigurationError
from simulator.doubles.chassis.description import SIMULTANEOUS_16_BIT, Description
from simulator.doubles.device_model import Brain
from simulator.doubles.transports.grpc_front import GrpcFront

grpc = pytest.importorskip("grpc")
nidaqmx = pytest.importorskip("nidaqmx")
REFUSED = str(grpc.StatusCode.UNAVAILABLE)
pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the certificates")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Self-signed pairs of a server, a client and a stranger, made for this run."""
    folder = tmp_path_factory.mktemp("tls")
    for name in ("server", "client", "stranger"):
        subprocess.run(
            [
                *("openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1"),
                *("-nodes", "-keyout", f"{name}.key", "-out", f"{name}.crt", "-days", "1"),
                *("-subj", f"/CN={name}", "-addext", "subjectAltName=DNS:chassis.lab"),
            ],
            cwd=folder,
            check=True,
            capture_output=True,
        )
    return folder


def reached(made, *, mutual, tls):
    """Make a task through the driver's channel: its name, or the code of the error and our message."""
    from hardware_drivers.daqmx.remote import Channel

    brain = Brain(Description(boards=(SIMULTANEOUS_16_BIT,)))
    front = GrpcFront(
        partial(brain.call, brain.open_client("grpc", "server")),
        credentials=grpc.ssl_server_credentials(
            [((made / "server.key").read_bytes(), (made / "server.crt").read_bytes())],
            root_certificates=(made / "client.crt").read_bytes() if mutual else None,
            require_client_auth=mutual,
        ),
    )
    try:
        channel = Channel(front.address, call_timeout_s=60.0, record_samples=1_000, tls=tls)
        try:
            with nidaqmx.Task("t", grpc_options=nidaqmx.GrpcSessionOptions(channel.calls, "")) as task:
                return task.name
        except nidaqmx.errors.RpcError as error:
            return f"{error.rpc_code}: {translate_error(error, 'making a task')}"
        finally:
            channel.close()
    finally:
        front.close()


def tls_of(made, root="server", client="", name="chassis.lab"):
    return GrpcTls(
        root_certificate=made / f"{root}.crt",
        certificate=made / f"{client}.crt" if client else None,
        private_key=made / f"{client}.key" if client else None,
        server_name=name,
    )


@pytest.mark.parametrize(
    ("mutual", "given", "outcome"),
    [
        (False, {}, "t"),
        (False, {"root": "stranger"}, f"{REFUSED}.*CERTIFICATE_VERIFY_FAILED"),
        (False, {"name": "elsewhere.lab"}, f"{REFUSED}.*Hostname Verification"),
        (False, None, REFUSED),
        (True, {"client": "client"}, "t"),
        (True, {"client": "stranger"}, REFUSED),
        (True, {}, REFUSED),
    ],
)
def test_only_authenticated_peers_are_connected(made, mutual, given, outcome):
    tls = None if given is None else tls_of(made, **given)
    found = reached(made, mutual=mutual, tls=tls)
    assert re.match(outcome, found), found


def test_a_file_that_cannot_be_used_is_named_before_anything_is_sent(made, tmp_path):
    from hardware_drivers.daqmx.remote import Channel

    (tmp_path / "server.der").write_bytes(b"0\x82")
    for file, complaint in (("absent.crt", "absent.crt cannot be read"), ("server.der", "is no PEM file")):
        with pytest.raises(ConfigurationError, match=complaint):
            Channel(
                "127.0.0.1:1",
                call_timeout_s=1.0,
                record_samples=1,
                tls=GrpcTls(root_certificate=tmp_path / file),
            )


def test_a_certificate_needs_its_key_and_tls_needs_grpc(made):
    with pytest.raises(ValueError, match="give both, or neither"):
        GrpcTls(root_certificate=made / "server.crt", certificate=made / "client.crt")
    wiring = TransducerWiring(board_serial="1", input="ai0", counter="ctr0", output_terminal="PFI12")
    with pytest.raises(ValueError, match="set transport = 'grpc'"):
        DaqmxParameters(transducers={"B": wiring}, grpc_tls=tls_of(made))
