"""The server: its port, its end, and its import time."""

import asyncio
import queue
import socket
import threading

import httpx2
import pytest
from support.filled_folder import filled_folder
from support.served_web import DEADLINE_S, served
from support.waiting import until
from websockets.sync.client import connect

from daq_service.errors import BusyError, UsageError
from daq_service.settings.tree import Settings
from daq_service.web.app import create_app
from daq_service.web.bounded_http import LARGEST_HEADERS_BYTES, BoundedHttp
from daq_service.web.port import bind_socket
from daq_service.web.server import serve


@pytest.fixture
def filled(tmp_path):
    with filled_folder(tmp_path) as folder:
        folder.add_set(0, stored=False, shown=True)
        yield folder


def test_port_zero_takes_a_free_port(filled):
    with served(filled.settings, filled.folder) as service:
        port = int(service.netloc.rpartition(":")[2])
        assert port > 0
        assert httpx2.get(f"{service.url}healthz").json() == {
            "status": "ok",
            "data": True,
            "recorder": None,
            "doing": None,
        }


def test_port_in_use_is_a_clear_error(tmp_path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(
            BusyError, match=f"Port {port} is in use. Choose another with --port; 0"
        ) as caught:
            serve(create_app(Settings(), tmp_path), "127.0.0.1", port, on_bound=pytest.fail)
        assert caught.value.exit_code == 5


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "example.org"])
def test_other_addresses_need_authentication(host):
    with pytest.raises(UsageError, match="without tokens and encryption"):
        bind_socket(host, 0)


def test_localhost_is_this_machine():
    with bind_socket("localhost", 0) as listener:
        assert listener.getsockname()[0] == "127.0.0.1"


def test_stop_ends_all_waiting_streams(filled):
    read_to_end = queue.Queue()

    def read(url):
        with httpx2.stream("GET", url, timeout=DEADLINE_S) as response:
            connected.release()
            read_to_end.put(response.read())

    with served(filled.settings, filled.folder) as service:
        connected = threading.Semaphore(0)
        readers = [threading.Thread(target=read, args=(f"{service.url}api/v1/stream",)) for _ in range(8)]
        for reader in readers:
            reader.start()
        for _ in readers:
            assert connected.acquire(timeout=DEADLINE_S)
        with connect(f"ws://{service.netloc}/api/v1/waveforms/live?positions=B") as socket_:
            assert socket_.recv(timeout=DEADLINE_S)
            # Uvicorn alone would wait for its clients forever.
            service.stop.set()
            service.thread.join(DEADLINE_S)
            assert not service.thread.is_alive()
        for reader in readers:
            reader.join(DEADLINE_S)
    assert all(read_to_end.get(timeout=DEADLINE_S).endswith(b"event: bye\ndata: {}\n\n") for _ in readers)


def test_stop_does_not_wait_for_a_client_that_does_not_read(filled):
    with served(filled.settings, filled.folder) as service:
        host, _, port = service.netloc.partition(":")
        with socket.create_connection((host, int(port))) as silent:
            silent.sendall(b"GET /api/v1/stream HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            assert silent.recv(12) == b"HTTP/1.1 200"
            service.stop.set()
            service.thread.join(DEADLINE_S)
            assert not service.thread.is_alive()


# Limits of connections, requests and responses


def everything_from(client):
    """Read until the service closes the connection."""
    return b"".join(iter(lambda: client.recv(65536), b""))


@pytest.mark.parametrize(
    "request_start", [b"", b"GET / HT", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: a"]
)
def test_missing_headers_end_the_connection(filled, monkeypatch, request_start):
    monkeypatch.setattr("daq_service.web.bounded_http.HEADERS_WITHIN_S", 0.05)
    with served(filled.settings, filled.folder) as service, service.connection() as client:
        client.sendall(request_start)
        assert everything_from(client).startswith(b"HTTP/1.1 408 ")


def test_a_second_request_of_a_connection_is_waited_for_as_the_first(filled, monkeypatch):
    monkeypatch.setattr("daq_service.web.bounded_http.HEADERS_WITHIN_S", 0.05)
    with served(filled.settings, filled.folder) as service, service.connection() as client:
        client.sendall(b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\nGET /healthz HT")
        answers = everything_from(client)
    assert answers.count(b"HTTP/1.1 200 ") == 1
    assert b"HTTP/1.1 408 " in answers


def test_a_response_is_not_interrupted_by_a_slow_next_request(filled, monkeypatch):
    monkeypatch.setattr("daq_service.web.bounded_http.HEADERS_WITHIN_S", 0.01)
    waited, polls = BoundedHttp._check_waiting, []
    monkeypatch.setattr(BoundedHttp, "_check_waiting", lambda self: (polls.append(self), waited(self)))
    with served(filled.settings, filled.folder) as service, service.connection() as client:
        client.sendall(b"GET /api/v1/stream HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\nGET /healthz HT")
        until(lambda: len(polls) > 3, "the next request's headers being waited for")
        service.stop.set()
        response = everything_from(client)
    assert b"event: bye" in response
    assert b" 408 " not in response


@pytest.mark.parametrize("ended", [False, True])
def test_headers_without_end_are_refused(filled, ended):
    with served(filled.settings, filled.folder) as service, service.connection() as client:
        client.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n")
        client.sendall(b"X-Large: " + b"a" * LARGEST_HEADERS_BYTES + (b"\r\n\r\n" if ended else b""))
        answer = everything_from(client)
    assert answer.startswith(b"HTTP/1.1 431 ")
    assert b"%d" % LARGEST_HEADERS_BYTES in answer


def test_a_missing_body_is_not_waited_for(filled, monkeypatch):
    monkeypatch.setattr("daq_service.web.guards.BODY_WITHIN_S", 0.05)
    with served(filled.settings, filled.folder) as service, service.connection() as client:
        client.sendall(b"POST /api/v1/commands HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 9\r\n\r\n{")
        answer = everything_from(client)
    assert answer.startswith(b"HTTP/1.1 408 ")
    assert b"urn:solimon:problem:body-too-slow" in answer


def test_more_connections_than_are_served_get_a_503(filled, monkeypatch):
    monkeypatch.setattr("daq_service.web.server.MOST_CONNECTIONS", 3)
    with served(filled.settings, filled.folder) as service, service.connection() as stream:
        with service.client() as first, service.connection() as other:
            for item in (stream, other):
                item.sendall(b"GET /api/v1/stream HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
                assert item.recv(4096).startswith(b"HTTP/1.1 200 ")
            assert first.get("healthz").status_code == 503
        with service.client() as later:
            until(lambda: later.get("healthz").status_code == 200, "a place")


def test_small_responses_are_sent_without_delay():
    """Nagle's algorithm is off on each connection that asyncio accepts here."""

    async def accepted_with(listener):
        found = asyncio.get_running_loop().create_future()

        def answer(_, writer):
            found.set_result(
                writer.get_extra_info("socket").getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
            )
            writer.close()

        server = await asyncio.start_server(answer, sock=listener)
        async with server:
            _, writer = await asyncio.open_connection(*listener.getsockname()[:2])
            writer.close()
            return await found

    assert asyncio.run(accepted_with(bind_socket("127.0.0.1", 0))) != 0


def test_large_answers_are_compressed_and_streams_are_not(filled):
    with served(filled.settings, filled.folder) as service, service.client() as client:
        page = client.get("/")
        assert page.headers["content-encoding"] == "gzip"
        assert "Accept-Encoding" in page.headers["vary"]
        plain = client.get("/", headers={"Accept-Encoding": "identity"})
        assert "content-encoding" not in plain.headers
        assert plain.content == page.content
        assert "content-encoding" not in client.get("healthz").headers
        with client.stream("GET", "api/v1/stream") as stream:
            assert "content-encoding" not in stream.headers
