"""A connection that stays open and brings nothing, as an SSH tunnel whose network is gone, is noticed."""

import socket
import socketserver
import threading
from contextlib import contextmanager, suppress

import pytest
from support.browser_pages import DESK, dashboard, expect
from support.filled_folder import filled_folder
from support.served_web import served
from support.waiting import until

pytestmark = pytest.mark.browser

BEAT_S = 0.5


class Tunnel(socketserver.ThreadingTCPServer):
    """Tunnel to a service; frozen, it accepts connections and data and forwards nothing."""

    daemon_threads = True
    block_on_close = False

    def __init__(self, service):
        super().__init__(("127.0.0.1", 0), None)
        host, _, port = service.netloc.partition(":")
        self.service = host, int(port)
        self.alive = threading.Event()
        self.alive.set()
        self.came = []
        """What the service sent through it."""
        self.opened = self.open = 0

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server_address[1]}/"

    def freeze(self):
        self.alive = threading.Event()

    def thaw(self):
        self.alive = threading.Event()
        self.alive.set()

    def finish_request(self, request, client_address):
        self.opened += 1
        its = self.alive
        with socket.create_connection(self.service) as there:
            back = threading.Thread(
                target=self._pump, args=(there, request, its, self.came.append), daemon=True
            )
            back.start()
            self.open += 1
            self._pump(request, there, its, lambda data: None)
            self.open -= 1

    def _pump(self, source, sink, its, note):
        with suppress(OSError):
            while data := source.recv(65536):
                if its is self.alive and its.is_set():
                    note(data)
                    sink.sendall(data)
        if its is self.alive:  # a frozen end is not passed on either
            with suppress(OSError):
                sink.shutdown(socket.SHUT_RDWR)


@contextmanager
def tunnel_to(service):
    with Tunnel(service) as tunnel:
        thread = threading.Thread(target=tunnel.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        try:
            yield tunnel
        finally:
            tunnel.shutdown()
            thread.join()


@pytest.fixture
def filled(tmp_path):
    with filled_folder(tmp_path, shots_per_set=1) as folder:
        for index in range(3):
            folder.add_set(index, stored=False, shown=index == 2)
        yield folder


def see_it_lost_and_found(filled, page, tunnel, after_freezing=lambda: None):
    """Check the page from "Live" over freezing to thawing, with the missed events and the live record."""
    tile = page.locator('.tile[data-position="B"]')
    expect(page.locator("#connection")).to_have_text("Live")
    expect(tile).to_have_attribute("data-stale", "false")
    # Others that the browser keeps would be tried first, one after the other.
    until(lambda: tunnel.open == 2, "only the stream of events and the live records are left")
    before = tunnel.opened
    tunnel.freeze()
    filled.add_alarm("B", 2)
    after_freezing()
    expect(page.locator("#connection")).to_contain_text("Connection lost")
    expect(tile).to_have_attribute("data-stale", "true")
    expect(tile).to_contain_text("Stale")
    until(lambda: tunnel.opened > before, "a new connection is tried")
    tunnel.thaw()
    after_freezing()
    expect(page.locator("#connection")).to_have_text("Live")
    until(lambda: dashboard(page, "alarms"), "the alarm of meanwhile is shown")
    expect(tile).to_have_attribute("data-stale", "false")
    filled.show_set(1)
    newest = next(record for record in filled.records(1) if record.key.position == "B").sequence
    expect(page.locator("#waveform")).to_have_attribute("data-sequence", str(newest))


@pytest.mark.parametrize("shared", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_frozen_connection_is_lost_after_two_missed_heartbeats(filled, browser, shared):
    context = browser.new_context(viewport=DESK)
    if not shared:
        context.add_init_script("delete window.SharedWorker")
    with served(filled.settings, filled.folder) as service, tunnel_to(service) as tunnel:
        service.app.state.context.hub.heartbeat_interval_s = BEAT_S
        page = context.new_page()
        page.goto(f"{tunnel.url}?position=B")
        for heartbeat in (b"event: heartbeat", b'{"interval_s":0.5}'):
            until(
                lambda heartbeat=heartbeat: heartbeat in b"".join(tunnel.came), "the page knows the interval"
            )
        see_it_lost_and_found(filled, page, tunnel)
        context.close()


@pytest.mark.slow
def test_a_page_that_wakes_from_sleep_connects_again(filled, browser):
    """The computer slept for an hour: its connections look open and are dead."""
    context = browser.new_context(viewport=DESK)
    context.add_init_script("delete window.SharedWorker")
    with served(filled.settings, filled.folder) as service, tunnel_to(service) as tunnel:
        page = context.new_page()
        page.clock.install()
        page.goto(f"{tunnel.url}?position=B")
        see_it_lost_and_found(filled, page, tunnel, lambda: page.clock.fast_forward("01:00:00"))
        context.close()
