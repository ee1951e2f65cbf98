"""HTTP client of an address: loopback directly, others by the proxies of the environment.

httpx2 itself reads every variable, also those for other addresses, raises raw errors for them, and supports
fewer forms of NO_PROXY.
"""

from __future__ import annotations

import os
import ssl
from fnmatch import fnmatchcase
from ipaddress import ip_address, ip_network
from pathlib import Path
from urllib.request import getproxies, proxy_bypass

import httpx2

from daq_service.client.errors import ClientError

LOOPBACK = ("localhost", "*.localhost", "127.0.0.0/8", "::1", "::ffff:127.0.0.0/104")
"""Addresses of this computer, as entries of NO_PROXY."""


def create_http_client(address: str, *, headers: dict[str, str], timeout_s: float) -> httpx2.Client:
    """Create an HTTP client of an address, without opening a connection.

    The environment sets only proxies and certificates: passwords of a ``.netrc`` are not used. ``timeout_s``
    is the time limit in s of connecting, and of each read and write.

    Raises
    ------
    ClientError
        The address is invalid, or a variable that concerns it cannot be used; the message names the variable.
    """
    variable = ""
    try:
        variable, proxy = find_proxy(url := httpx2.URL(address))
        return httpx2.Client(
            base_url=address,
            headers=headers,
            timeout=timeout_s,
            verify=_create_tls_context(url.scheme),
            proxy=proxy,
            trust_env=False,
        )
    except OSError as error:  # ssl.SSLError is one
        name = next(filter(os.environ.get, CERTIFICATES), "the trust store of this system")
        raise ClientError(f"{name} names no readable certificates ({error}); correct or unset it") from error
    except (httpx2.InvalidURL, ImportError, ValueError) as error:
        if not variable:
            raise ClientError(f"{address!r}: {error}; give an address like http://127.0.0.1:8750") from error
        remedy = "correct it, or add the host to NO_PROXY"
        raise ClientError(f"{variable} names a proxy that cannot be used ({error}); {remedy}") from error


def find_proxy(url: httpx2.URL) -> tuple[str, str | None]:
    """Find the proxy of an address: return the environment variable that names it, and its URL.

    Empty and None: no proxy, as for loopback addresses and those in ``NO_PROXY``. For a proxy that only the
    operating system's settings name, the first is "the proxy setting of this system".
    """
    proxies, host = getproxies(), url.host.lower()
    scheme = next(filter(proxies.get, (url.scheme, "all")), None)
    exceptions = (*LOOPBACK, *proxies.get("no", "").lower().split(","))
    is_direct = any(_matches_host(entry.strip(), host) for entry in exceptions)
    if scheme is None or is_direct or proxy_bypass(url.netloc.decode()):
        return "", None
    names = (f"{scheme}_proxy", f"{scheme}_proxy".upper())
    variable = next(filter(os.environ.get, names), "the proxy setting of this system")
    return variable, proxies[scheme] if "://" in proxies[scheme] else f"http://{proxies[scheme]}"


def proxy_note(url: httpx2.URL) -> str:
    """Return " through the proxy of <variable>" for an error message; empty without a proxy."""
    variable, _ = find_proxy(url)
    return variable and f" through the proxy of {variable}"


def _matches_host(entry: str, host: str) -> bool:
    """Return whether an entry of NO_PROXY (IP network, or pattern of names with wildcards) matches a host."""
    try:
        return ip_address(host) in ip_network(entry.strip("[]"), strict=False)
    except ValueError:
        return fnmatchcase(host, entry)


CERTIFICATES = ("SSL_CERT_FILE", "SSL_CERT_DIR")


def _create_tls_context(scheme: str) -> ssl.SSLContext:
    """Create the TLS context with the certificates of the environment, or else of this system.

    For another scheme than ``https`` it has no certificates.

    Raises
    ------
    OSError
        A file or folder that the environment names cannot be read.
    """
    if scheme != "https":  # nothing is encrypted: to read all certificates would take longer than the answer
        return ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    if next(filter(os.environ.get, CERTIFICATES), "") == "SSL_CERT_DIR":
        list(Path(os.environ["SSL_CERT_DIR"]).iterdir())  # to OpenSSL an absent folder is an empty one
    return httpx2.create_ssl_context()
