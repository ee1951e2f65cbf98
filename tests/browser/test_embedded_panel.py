"""One chart in a page of another origin: it draws, without errors; elsewhere the browser refuses it."""

import http.server
import threading
from urllib.parse import quote, unquote

import pytest
from axe_playwright_python.sync_playwright import Axe
from support.browser_pages import expect
from support.filled_folder import filled_folder
from support.served_web import served
from support.waiting import until

from daq_service.settings.tree import Settings

pytestmark = pytest.mark.browser

PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Wiki</title><link rel="icon"
href="data:,"></head><body><main><h1>Wiki</h1><iframe title="Time of flight at B" width="720" height="420"
src="{}"></iframe></main></body></html>"""
PANEL = "?position=B&panel=tof&embed=1"


class Wiki(http.server.BaseHTTPRequestHandler):
    """A page that embeds the address in its query."""

    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.end_headers()
        self.wfile.write(PAGE.format(unquote(self.path.partition("?")[2]).replace("&", "&amp;")).encode())

    def log_message(self, *arguments):
        pass


@pytest.fixture(scope="module")
def wiki():
    """Return the port of a server with another origin than the service."""
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Wiki) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server.server_port
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def filled(tmp_path_factory, wiki):
    """Return a test that a wiki may embed, from the same site and, as localhost, from another."""
    origins = [f"http://{host}:{wiki}" for host in ("127.0.0.1", "localhost")]
    settings = Settings(web={"embed_origins": origins})
    with filled_folder(tmp_path_factory.mktemp("embedded"), settings, sets=12) as folder:
        folder.add_alarm("B", 9)
        yield folder


def embed(open_page, service, wiki, *, host="127.0.0.1", panel=PANEL, forgiven=None):
    """Open the wiki's page, and return it with the frame of the panel."""
    page = open_page(f"http://{host}:{wiki}/?{quote(service.url + panel)}", forgiven=forgiven, name=None)
    until(lambda: len(page.frames) == 2 and page.frames[1].url != "", "the frame has an address")
    return page, page.frames[1]


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_a_page_of_another_origin_shows_one_panel_and_cannot_command(open_page, service, wiki, host):
    page, frame = embed(open_page, service, wiki, host=host)
    ready = "window.solimonDashboard?.ready && window.solimonDashboard.charts.tof.x.length === 12"
    until(lambda: frame.evaluate(ready), "the chart has its sets")
    expect(frame.locator("#tof canvas").first).to_be_visible()
    shown = frame.locator("#charts > :visible, main > :visible, body > :visible")
    assert sorted(filter(None, shown.evaluate_all("all => all.map((one) => one.id)"))) == [
        "charts",
        "main",
        "tof",
    ]
    box = frame.locator("#tof").bounding_box()
    assert box["width"] > 600
    assert frame.evaluate("document.documentElement.scrollWidth <= innerWidth")
    frame.locator("#tof .plot").hover()
    page.keyboard.press("n")
    assert frame.locator("dialog[open]").count() == 0
    assert frame.locator("button:visible", has_text="note").count() == 0
    found = Axe().run(frame)  # from outside it would post messages to the wrong origin
    assert found.violations_count == 0, found.generate_report()


def test_an_embedded_list_of_alarms_has_no_commands(open_page, service, wiki):
    _, frame = embed(open_page, service, wiki, panel=PANEL.replace("tof", "alarms"))
    until(lambda: frame.evaluate("window.solimonDashboard?.ready"), "the page is there")
    expect(frame.locator("#alarms .alarm").first).to_be_visible()
    assert frame.locator("button:visible", has_text="Acknowledge").count() == 0


@pytest.mark.parametrize("panel", ["?position=B&panel=tof", ""])
def test_a_page_without_embed_is_refused_by_the_browser(open_page, service, wiki, panel):
    _, frame = embed(open_page, service, wiki, panel=panel, forgiven="frame-ancestors")
    until(lambda: frame.url.startswith("chrome-error:"), "the browser refuses it")


def test_without_configuration_the_browser_refuses_the_panel(open_page, filled, wiki):
    with served(Settings(), filled.folder) as service:
        _, frame = embed(open_page, service, wiki, forgiven="frame-ancestors")
        until(lambda: frame.url.startswith("chrome-error:"), "the browser refuses it")
