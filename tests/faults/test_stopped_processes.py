"""Real processes: when one of a test is missing, another one raises, stores and sends the alarm of it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from contextlib import ExitStack

import pytest
from support.receivers import http_receiver
from support.waiting import ended, until

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.errors import NoDataYetError
from daq_service.catalogue.rows import AlarmRow
from daq_service.processes.heartbeat import WEB_FILE, read_heartbeat

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="Windows stops no process"),
]

INTERVAL_S = 4.0
CONFIGURATION = f"""
[clock]
kind = "wall"
[schedule]
phases = [{{ until_h = 1.0, interval_h = {INTERVAL_S / 3600.0} }}]
shots_per_set = 1
shot_interval_s = 0.1
[baseline]
minimum_valid_shots = 1
[plate]
elements_per_edge = 16
[notifications.receivers.duty]
url = "%s"
secret_env = "DUTY_SECRET"
[[notifications.rules]]
group_s = 0.0
kinds = ["recorder_not_running", "web_not_responding"]
"""
CHANGED = """
import os, sys
from daq_service.processes import heartbeat
heartbeat.WEB_DEADLINE_S = 2.0
if "record" in sys.orig_argv and os.path.exists(os.environ["BREAKS"]):
    from unittest.mock import patch
    from daq_service.recording import acquire_set
    fault = RuntimeError("the digitizer's driver has a fault of its own")
    patch.object(acquire_set, "take_set", side_effect=fault).start()
"""
"""What each process does first: a shorter deadline, and a driver that raises at each shot where one asks."""


class Processes:
    """Processes of a test, started from the command line."""

    def __init__(self, folder, url, stack):
        self.folder, self.data, self.breaks = folder, folder / "data", folder / "breaks"
        self.config = folder / "test.toml"
        self.config.write_text(CONFIGURATION % url, encoding="utf-8")
        (folder / "sitecustomize.py").write_text(CHANGED, encoding="utf-8")
        self._environment = {
            **os.environ,
            "PYTHONPATH": str(folder),
            "BREAKS": str(self.breaks),
            "DUTY_SECRET": "correct-horse-battery-staple",
        }
        self._stack = stack

    def start(self, *words):
        command = [sys.executable, "-m", "daq_service.cli", *words, str(self.config), "--data-dir"]
        process = subprocess.Popen([*command, str(self.data)], env=self._environment)
        self._stack.enter_context(process)
        self._stack.callback(process.kill)
        return process

    def alarm(self, kind):
        """Return the state of its newest alarm; empty if none was raised."""
        try:
            with open_catalogue(self.data) as catalogue:
                rows = catalogue.rows(AlarmRow, kind=kind)
        except NoDataYetError:
            return ""
        return rows[-1].state if rows else ""

    def has_sets(self):
        try:
            with open_catalogue(self.data) as catalogue:
                return catalogue.read_newest_recorded() is not None
        except NoDataYetError:
            return False

    def recorder(self):
        beat = read_heartbeat(self.data)
        assert beat is not None
        return beat.process

    def web(self):
        beat = read_heartbeat(self.data, WEB_FILE)
        return 0 if beat is None else beat.process


@pytest.fixture
def receiver():
    with http_receiver() as running:
        yield running


@pytest.fixture
def test(tmp_path, receiver):
    with ExitStack() as stack:
        yield Processes(tmp_path, receiver.url, stack)


def news(receiver):
    """Return kind and change of each alarm in the next message."""
    return [(item["kind"], item["change"]) for item in receiver.next().message["alarms"]]


def became(test, kind, state):
    return lambda: test.alarm(kind) == state


RECORDER, WEB = "recorder_not_running", "web_not_responding"


def test_services_of_a_service_manager_notice_each_other(test, receiver):
    recorder, web = test.start("record"), test.start("serve", "--port", "0")
    until(lambda: test.has_sets() and test.web(), "the first set and a web service")
    web.send_signal(signal.SIGSTOP)
    assert news(receiver) == [(WEB, "raised")], "the recorder sends it"
    assert test.alarm(WEB) == "unacknowledged"
    web.send_signal(signal.SIGCONT)
    assert news(receiver) == [(WEB, "over")]
    recorder.kill()
    assert news(receiver) == [(RECORDER, "raised")]
    recorder = test.start("record")
    assert news(receiver) == [(RECORDER, "over")]
    until(became(test, RECORDER, "returned_unacknowledged"), "a stored set")
    web.terminate()
    ended(web, "the web service")
    lines = (test.data / "notifications.jsonl").read_bytes().splitlines()
    sent = [line for line in lines if json.loads(line)["row"]["what"] == "sent"]
    assert len(sent) == 4, "each is sent once"


def test_under_the_supervisor_both_are_noticed_and_started_again(test, receiver):
    test.start("run", "--port", "0")
    until(lambda: test.has_sets() and test.web(), "the first set and a web service")
    stalled = test.web()
    os.kill(stalled, signal.SIGSTOP)
    until(lambda: test.web() not in (0, stalled), "another web service")
    test.breaks.touch()
    os.kill(test.recorder(), signal.SIGKILL)
    found = news(receiver)
    while (RECORDER, "raised") not in found:  # the web service may have been away for long enough, too
        found = news(receiver)
    test.breaks.unlink()
    while (RECORDER, "over") not in found:
        found = news(receiver)
    assert test.alarm(RECORDER) == "returned_unacknowledged"


def test_without_a_web_service_the_supervisor_watches_and_sends(test, receiver):
    test.breaks.touch()
    test.start("run", "--no-web")
    assert news(receiver) == [(RECORDER, "raised")]
    test.breaks.unlink()
    assert news(receiver) == [(RECORDER, "over")]
