"""Remote boards: a channel to NI's gRPC device server, with a deadline for every call.

Importing this module needs the `grpc` extra. NI's client sets no deadline on any call and gRPC's
limit of a message is 4 MB; both are set here. No web proxy is used.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from pathlib import Path
from typing import Any

import grpc

from hardware_drivers.daqmx.parameters import GrpcTls
from hardware_drivers.errors import ConfigurationError

SLOW_CALLS = frozenset({"SelfCal", "ResetDevice"})
"""Calls that take seconds on a sound board."""
SLOWER = 10.0

BYTES_PER_SAMPLE = 10
"""Largest varint of a negative 32-bit sample."""
OTHER_BYTES = 4 * 1024 * 1024

FIRST_PAUSE_MS, LONGEST_PAUSE_MS = 100, 1_000
"""Between attempts to connect, after which a call fails at once; gRPC's own grow to two minutes, in which
a server that is back would cost shot after shot."""


class _CallDetails(
    namedtuple(
        "_CallDetails", ("method", "timeout", "metadata", "credentials", "wait_for_ready", "compression")
    ),
    grpc.ClientCallDetails,  # type: ignore[misc] # grpc ships no types
):
    """Call details of gRPC with another deadline."""


class Deadlines(grpc.UnaryUnaryClientInterceptor):  # type: ignore[misc] # grpc ships no types
    """Interceptor that gives every call a deadline.

    The time of the call's own wait plus one for the response.
    """

    def __init__(self, call_timeout_s: float) -> None:
        """Store the time in s that a call may take in addition to its own wait."""
        self._call_timeout_s = call_timeout_s

    def intercept_unary_unary(
        self, continuation: Callable[..., grpc.Call], details: grpc.ClientCallDetails, request: Any
    ) -> grpc.Call:
        """Send the request with the deadline of `deadline_s` in place of the caller's; return the call.

        ``continuation`` sends it; the other details of the call stay.
        """
        bounded = _CallDetails(
            details.method,
            self.deadline_s(details.method, request),
            details.metadata,
            details.credentials,
            details.wait_for_ready,
            details.compression,
        )
        return continuation(bounded, request)

    def deadline_s(self, method: str, request: Any) -> float:
        """Return the longest time in s that a call of this gRPC method may take.

        It is the call timeout plus the wait that the request itself asks for, or `SLOWER` times the timeout
        for `SLOW_CALLS`.
        """
        name = method.rsplit("/", 1)[-1]
        if name in SLOW_CALLS:
            return SLOWER * self._call_timeout_s
        waits_s = 0.0
        if name == "WaitUntilTaskDone":
            waits_s = float(request.time_to_wait)
        elif name.startswith("Read"):
            waits_s = float(request.timeout)
        return self._call_timeout_s + max(0.0, waits_s)


class Channel:
    """Channel of gRPC that is closed only once."""

    def __init__(
        self, address: str, *, call_timeout_s: float, record_samples: int, tls: GrpcTls | None = None
    ) -> None:
        """Create the channel to a server (HOST:PORT); it connects at the first call.

        Raise ConfigurationError for a TLS file that cannot be read or is no PEM.
        """
        largest = BYTES_PER_SAMPLE * record_samples + OTHER_BYTES
        options: list[tuple[str, int | str]] = [
            ("grpc.max_receive_message_length", largest),
            # gRPC shares connections between channels, and with them the pause after a failed attempt: a
            # new channel to a server that is back would be refused by what the old one met.
            ("grpc.use_local_subchannel_pool", 1),
            # The web proxies of the environment (http_proxy, grpc_proxy, GRPC_ADDRESS_HTTP_PROXY) know no
            # chassis, and gRPC sends even 127.0.0.1 through them.
            ("grpc.enable_http_proxy", 0),
            ("grpc.address_http_proxy_enabled_addresses", ""),
            ("grpc.initial_reconnect_backoff_ms", FIRST_PAUSE_MS),
            ("grpc.max_reconnect_backoff_ms", LONGEST_PAUSE_MS),
        ]
        if tls is None:
            self._plain = grpc.insecure_channel(address, options=options)
        else:
            if tls.server_name:
                options.append(("grpc.ssl_target_name_override", tls.server_name))
            self._plain = grpc.secure_channel(address, _read_credentials(tls), options=options)
        self.calls = grpc.intercept_channel(self._plain, Deadlines(call_timeout_s))

    def close(self) -> None:
        """Close the channel; calls on it fail from then on."""
        self._plain.close()


def _read_credentials(tls: GrpcTls) -> grpc.ChannelCredentials:
    """Build the credentials of an encrypted channel from PEM files; ConfigurationError for an invalid file.

    The client's key and certificate are optional.
    """
    root, key, certificate = map(_read_pem_file, (tls.root_certificate, tls.private_key, tls.certificate))
    return grpc.ssl_channel_credentials(root, key, certificate)


def _read_pem_file(file: Path | None) -> bytes | None:
    """Read a PEM file as bytes; None without a file.

    Raise ConfigurationError if it cannot be read or is no PEM, which would later look like an unreachable
    server.
    """
    if file is None:
        return None
    try:
        text = file.read_bytes()
    except OSError as error:
        raise ConfigurationError(
            f"grpc_tls: {file} cannot be read ({error.strerror}); correct its path"
        ) from error
    if b"-----BEGIN " not in text:
        raise ConfigurationError(f"grpc_tls: {file} is no PEM file; convert it with openssl")
    return text
