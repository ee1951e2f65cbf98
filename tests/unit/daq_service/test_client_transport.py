"""The client connects to loopback directly, without a proxy; otherwise an error names the variable."""

import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer

import httpx2
import pytest

from daq_service import client
from daq_service.client.transport import LOOPBACK, find_proxy

VARIABLES = ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY", "NO_PROXY", "SSL_CERT_FILE", "SSL_CERT_DIR", "NETRC")
DEAD_PROXY = "http://127.0.0.1:9"


@pytest.fixture(autouse=True)
def without_proxies(monkeypatch):
    """Remove the proxy variables of the machine that runs the tests."""
    for variable in VARIABLES:
        monkeypatch.delenv(variable, raising=False)
        monkeypatch.delenv(variable.lower(), raising=False)


@contextmanager
def serve_response(status, body):
    """Serve the same response to every request; yield the port and the requests."""
    requests = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            requests.append((self.path, dict(self.headers)))
            self.send_response(status)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *arguments):
            pass

    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield server.server_address[1], requests
        finally:
            server.shutdown()
            thread.join()


@pytest.mark.parametrize(
    "variables",
    [
        {"HTTP_PROXY": DEAD_PROXY, "NO_PROXY": "[::1]"},
        {"http_proxy": DEAD_PROXY},
        {"ALL_PROXY": "socks5://127.0.0.1:9"},
        {"all_proxy": "no address: at all"},
        {"NO_PROXY": "[::1],*.lab,10.0.0.0/8,:::,http://["},
        {"SSL_CERT_FILE": "/absent/certificates.pem", "SSL_CERT_DIR": "/absent"},
    ],
    ids=",".join,
)
def test_loopback_is_connected_directly(variables, monkeypatch, tmp_path):
    (tmp_path / "netrc").write_text("default login ann password secret\n")
    monkeypatch.setenv("NETRC", str(tmp_path / "netrc"))
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    with serve_response(200, b'{"name": "plate 7"}') as (port, requests):
        for host in ("127.0.0.1", "localhost"):
            with client.open(f"http://{host}:{port}") as test:
                assert test.info() == {"name": "plate 7"}
        assert [path for path, _ in requests] == ["/api/v1/info"] * 2
        assert not any("Authorization" in headers for _, headers in requests)


@pytest.mark.parametrize(
    "host",
    ["127.0.0.1", "127.255.0.9", "[::1]", "[::ffff:127.0.0.1]", "localhost", "LOCALHOST", "a.localhost"],
)
def test_every_address_of_this_computer_is_loopback(host, monkeypatch):
    monkeypatch.setenv("ALL_PROXY", DEAD_PROXY)
    assert find_proxy(httpx2.URL(f"http://{host}:8750")) == ("", None)


@pytest.mark.parametrize(
    ("host", "no_proxy", "direct"),
    [
        ("rig.lab", "", False),
        ("rig.lab", "*", True),
        ("rig.lab", "other.example, rig.lab", True),
        ("rig.lab", "lab", True),
        ("rig.lab", ".LAB", True),
        ("rig.lab", "*.lab", True),
        ("rig.lab", "rig.lab:8750", True),
        ("rig.lab", "rig.lab:80", False),
        ("notrig.lab", "rig.lab", False),
        ("10.1.2.3", "10.0.0.0/8", True),
        ("10.1.2.3", "10.1.2.3", True),
        ("11.1.2.3", "10.0.0.0/8,[::1]", False),
        ("[fd00::7]", "fd00::/8", True),
        ("[fd00::7]", "[fd00::7]", True),
        ("[fe00::7]", "[fd00::7],10.0.0.0/8", False),
        ("128.0.0.1", ",".join(LOOPBACK), False),
    ],
)
def test_the_forms_of_no_proxy(host, no_proxy, direct, monkeypatch):
    monkeypatch.setenv("HTTP_PROXY", "proxy.lab:3128")
    monkeypatch.setenv("NO_PROXY", no_proxy)
    found = find_proxy(httpx2.URL(f"http://{host}:8750"))
    assert found == (("", None) if direct else ("HTTP_PROXY", "http://proxy.lab:3128"))


@pytest.mark.parametrize(
    ("address", "variable", "value"),
    [
        ("http://rig.lab", "ALL_PROXY", "socks9://127.0.0.1:9"),
        ("http://rig.lab", "HTTP_PROXY", "http://proxy:port"),
        ("http://rig.lab", "http_proxy", "ftp://ann:secret@proxy"),
        ("https://rig.lab", "HTTPS_PROXY", "http://[::1"),
        ("https://rig.lab", "SSL_CERT_FILE", "/absent/certificates.pem"),
        ("https://rig.lab", "SSL_CERT_FILE", __file__),
        ("https://127.0.0.1:8750", "SSL_CERT_FILE", "/absent/certificates.pem"),
        ("https://rig.lab", "SSL_CERT_DIR", "/absent"),
    ],
)
def test_a_variable_that_cannot_be_used_is_named(address, variable, value, monkeypatch):
    monkeypatch.setenv(variable, value)
    with pytest.raises(client.ClientError, match=f"^{variable} names ") as refused:
        client.open(address)
    assert "secret" not in str(refused.value)


def test_an_invalid_address_raises_a_client_error():
    with pytest.raises(client.ClientError, match="give an address like"):
        client.open("http://[::1")


@pytest.mark.parametrize(
    ("status", "body"), [(502, b"<h1>Bad Gateway</h1>"), (200, b"<h1>Log in</h1>"), (407, b'["who?"]')]
)
def test_a_proxy_response_is_reported_with_the_proxy_variable(status, body, monkeypatch):
    with serve_response(status, body) as (port, requests):
        monkeypatch.setenv("HTTP_PROXY", f"127.0.0.1:{port}")
        with (
            client.open("http://rig.lab") as test,
            pytest.raises(client.RefusedError, match="proxy of HTTP_PROXY"),
        ):
            test.info()
        assert requests[0][0] == "http://rig.lab/api/v1/info"
    with client.open("http://rig.lab") as test, pytest.raises(client.UnreachableError, match="HTTP_PROXY"):
        test.info()
