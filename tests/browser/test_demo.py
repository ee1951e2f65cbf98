"""`solimon demo` as a stranger meets it: the printed address, opened in a browser."""

import os
import queue
import re
import signal
import subprocess
import sys
import threading
from functools import partial

import httpx
import pytest
from support.browser_pages import dashboard, expect
from support.command_line import first_match
from support.waiting import until

pytestmark = [
    pytest.mark.browser,
    pytest.mark.timeout(900),  # its waits together
    pytest.mark.skipif(os.name == "nt", reason="the demo is ended by SIGINT, which Windows lacks"),
]

LIMIT_S = 240.0
"""Far beyond any wait, on a loaded machine too; compiling the kernels and reducing the plates included."""
HOURS = 24
"""Past baseline and first alarm, so that limits are drawn; long enough to be held on a busy machine."""
QUICK = {
    "SOLIMON_PLATE__ELEMENTS_PER_EDGE": "16",
    "SOLIMON_SCHEDULE__SHOTS_PER_SET": "3",
    "SOLIMON_BASELINE__HOURS": "16",  # 32 sets, of which 12 are enough: those held are missed
    "SOLIMON_BASELINE__MINIMUM_SETS": "12",
    "SOLIMON_BASELINE__MINIMUM_VALID_SHOTS": "2",
    "SOLIMON_ALARMS__HOLE_SHOTS": "2",
    "SOLIMON_ALARMS__THICKNESS_LOSS_FRACTION": "0.01",  # A is so thin at hour 9
}
"""A coarse mesh, a third of the strikes, an early baseline and alarm: the page draws the same."""


class Demo:
    """Running command and its lines."""

    def __init__(self, folder, cache):
        self.process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "daq_service.cli",
                "demo",
                "--hours",
                str(HOURS),
                "--pace",
                "0.2",  # an hour in five seconds: time to look, and to be held on a busy machine
                "--data-dir",
                str(folder),
            ],
            # A cache of its own: the first start on a fresh machine.
            env={**os.environ, **QUICK, "XDG_CACHE_HOME": str(cache)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.lines = queue.Queue()
        self.reader = threading.Thread(target=self._read)
        self.reader.start()

    def _read(self):
        for line in self.process.stdout:
            self.lines.put(line)
        self.lines.put("")

    def line_with(self, pattern):
        return first_match(iter(partial(self.lines.get, timeout=LIMIT_S), ""), pattern)[0]

    def end(self):
        self.process.kill()
        self.process.wait()
        self.reader.join(LIMIT_S)  # the children hear of the end by their pipes, and let go of this one
        self.process.stdout.close()


@pytest.fixture
def demo(tmp_path):
    running = Demo(tmp_path / "data", tmp_path / "cache")
    yield running
    running.end()


def asked_until(page, found, what):
    """Query repeatedly and leave the page time: Playwright handles events only while it waits."""

    def ask():
        page.evaluate("new Promise(done => setTimeout(done, 100))")
        return found()

    until(ask, what)


@pytest.mark.slow
def test_the_demo_is_paused_resumed_finished_and_an_alarm_acknowledged(demo, open_page):
    url = demo.line_with(r"http://127\.0\.0\.1:\d+")
    # The page stays open while the demo ends: only then it may miss its service.
    page = open_page(url, forgiven=r"net::ERR_|WebSocket connection")
    first = expect(page.locator("#waveform"), within_s=LIMIT_S)
    first.to_have_attribute("data-sequence", re.compile(r"\d+"))
    waveform, tof = page.locator("#waveform"), page.locator("#tof")
    first_points = tof.get_attribute("data-points") or "0"
    for _ in range(2):
        expect(waveform).not_to_have_attribute("data-sequence", waveform.get_attribute("data-sequence"))
    expect(tof).not_to_have_attribute("data-points", first_points)

    page.get_by_role("button", name="Pause", exact=True).click()
    page.keyboard.type("hands in the rig")
    page.keyboard.press("Enter")
    expect(page.locator("#paused")).to_contain_text("Paused by dashboard: hands in the rig")
    with httpx.Client(base_url=url) as api:

        def counts():
            return api.get("/api/v1/health").json()["counts"]

        def wait_for_missed(number):
            asked_until(page, lambda: counts()["missed_sets"] >= number, f"{number} sets were missed")

        # A set that was cut short by the order is stored after the banner, and before the next one is missed.
        wait_for_missed(1)
        shots = counts()["shots"]
        wait_for_missed(2)
        assert counts()["shots"] == shots
        page.get_by_role("button", name="Resume", exact=True).click()
        page.get_by_role("button", name="Resume test").click()
        expect(page.locator("#paused")).to_be_hidden()
        expect(waveform).not_to_have_attribute("data-sequence", waveform.get_attribute("data-sequence"))
        asked_until(page, lambda: counts()["shots"] > shots, "a shot was taken")
        causes = {row["reason"] for row in api.get("/api/v1/sets?state=missed").json()["items"]}
        assert causes == {"paused by dashboard: hands in the rig"}

        page.get_by_role("button", name="Finish now").click()
        page.get_by_role("button", name="Run to the end").click()
        demo.line_with("The test is done")
        trend = api.get("/api/v1/trends/B").json()["columns"]
        assert trend["due_h"][-1] == HOURS
        # A set that the order cut short may have too few strikes for a value.
        for chart, column in (("#tof", trend["tof_pp_s"]), ("#distance", trend["distance_squared"])):
            points = sum(value is not None for value in column)
            assert points > 10, "of two sets an hour, but those held"
            expect(page.locator(chart)).to_have_attribute("data-points", str(points))
        charts = dashboard(page, "charts")
        in_us = [None if value is None else value * 1e6 for value in trend["tof_pp_s"]]
        assert charts["tof"]["y"]["tof_pp_us"] == in_us
        assert charts["distance"]["y"]["distance_squared"] == trend["distance_squared"]
        # An order given after the last set is carried out all the same.
        (first, *_) = api.get("/api/v1/alarms").json()["items"]
        assert first["state"].endswith("unacknowledged")
        body = {"author": "ann", "note": "seen in the demo"}
        order = api.post(f"/api/v1/alarms/{first['id']}/acknowledge", json=body).json()

        def answer():
            return api.get(f"/api/v1/commands/{order['id']}").json()

        waiting = ("pending", "started")
        asked_until(page, lambda: answer()["state"] not in waiting, "the order was carried out")
        order = answer()
        assert order["state"] == "done", order
        assert api.get(f"/api/v1/alarms/{first['id']}").json()["acknowledged_by"] == "ann"

    demo.process.send_signal(signal.SIGINT)
    assert demo.process.wait(LIMIT_S) == 130
