"""Progress output of a running test, and the condition to open the page."""

import io
import logging
import sys
import threading
import webbrowser

import pytest
from support.machine import clock_in_seconds
from support.waiting import happened

from daq_service.cli import terminal
from daq_service.cli.terminal import ProgressReport, describe_missing_screen, format_duration, open_page

ALARM = {"change": "alarm_raised", "hour": 12.5, "priority": "high", "message": "hole at C: inspect"}
GAP = {"state": "missed", "positions": ["A", "B"], "reason": "paused by ann: door open"}


class Log:
    """Progress report with a clock that the test moves."""

    def __init__(self):
        self.now_s = 0.0
        self.report = ProgressReport(machine=clock_in_seconds(lambda: self.now_s))

    def after(self, seconds, event, **values):
        self.now_s += seconds
        self.report(event, **values)

    def progress(self, seconds, done):
        self.after(seconds, "progress", done=done, planned=100, due_h=done / 2.0)


def lines(capsys):
    captured = capsys.readouterr()
    assert captured.out == "", "standard output belongs to whoever asked for something"
    return captured.err.splitlines()


def test_a_log_has_a_line_per_set_and_at_most_one_per_minute(capsys):
    log = Log()
    with log.report:
        for done, pause_s in enumerate((0.0, 1800.0, 1800.0, 1.0, 1.0, 60.0), start=1):
            log.progress(pause_s, done)
        log.progress(1.0, 100)
    assert [line.partition(", ")[2] for line in lines(capsys)] == [
        f"set {done} of 100" for done in (1, 2, 3, 6, 100)
    ]


def test_the_first_due_set_is_printed_with_hour_utc_and_minutes(capsys):
    log = Log()
    with log.report:
        log.after(0.0, "due", set_index=0, due_h=0.5, due_utc_ns=1_704_069_000_000_000_000, in_s=1799.6)
    assert lines(capsys) == ["set 0 is due at hour 0.5, 2024-01-01 00:30 UTC, in 30 min"]


def test_each_requested_action_is_one_line(capsys):
    log = Log()
    asked = {"text": "strike C now", "position": "C", "set_index": 3, "shot_index": 6, "attempt": 0}
    with log.report:
        log.after(0.0, "asked", **asked, within_s=400.0)
        log.after(8.0, "asked_over")
        log.after(0.0, "asked", text="close the door", within_s=30.0)
    assert lines(capsys) == ["strike C now (position C, shot 7): within 7 min", "close the door: within 30 s"]


def test_alarms_are_printed_when_raised_and_when_cleared(capsys):
    log = Log()
    with log.report:
        for change in (
            "alarm_raised",
            "alarm_priority_raised",
            "alarm_reactivated",
            "alarm_cleared",
            "alarm_reset",
        ):
            log.after(0.0, "alarm", **{**ALARM, "change": change})
    stands = "hour 12.5, ALARM, high: hole at C: inspect"
    assert lines(capsys) == [
        *(stands,) * 3,
        "hour 12.5, alarm cleared: hole at C: inspect",
        "hour 12.5, alarm reset: hole at C: inspect",
    ]


def test_the_first_and_last_of_consecutive_gaps_with_one_reason_are_printed(capsys):
    log = Log()
    with log.report:
        for index in (3, 4, 5):
            log.after(0.0, "gap", set_index=index, **GAP)
            log.progress(1.0, index + 1)
        log.progress(1.0, 7)
        log.after(0.0, "gap", set_index=9, **GAP)
        log.after(0.0, "gap", set_index=10, **{**GAP, "reason": "the computer slept"})
    assert lines(capsys) == [
        "set 3 missed at A, B: paused by ann: door open",
        "hour 2.0, set 4 of 100",
        "sets 4 to 5, too, missed at A, B: paused by ann: door open",
        "set 9 missed at A, B: paused by ann: door open",
        "set 10 missed at A, B: the computer slept",
    ]


def test_a_long_preparation_is_one_line_with_its_duration(capsys):
    log = Log()
    with log.report:
        for part, seconds in ((1, 1.0), (2, 20.0), (3, 20.0)):
            log.after(seconds, "preparing", what=f"compiling: part {part} of 3")
        log.after(1.0, "prepared", what="compiling")
        log.after(0.0, "preparing", what="compiling")
        log.after(1.9, "prepared", what="compiling")
        log.after(9.0, "prepared", what="that of which nobody heard")
    assert lines(capsys) == ["compiling: took 41 s"]


def test_the_progress_line_names_the_long_step(capsys):
    log = Log()
    text = log.report._compose_progress_line
    log.after(1.0, "beat", doing="opening the rig", process=1)
    assert text().plain == "opening the rig"
    log.after(0.0, "preparing", what="compiling: part 2 of 3, 7 s")
    assert text().plain == "compiling: part 2 of 3, 7 s"
    log.after(1.0, "prepared", what="compiling")
    log.after(0.0, "beat", doing="opening the rig", process=1)
    log.now_s += 41.0
    assert text().plain == "opening the rig; 41 s so far"
    log.progress(0.0, 5)
    log.after(0.0, "beat", doing="waiting for set 5", process=1)
    assert text().plain == "hour 2.5, set 5 of 100"
    log.now_s += 600.0
    assert text().plain == "hour 2.5, set 5 of 100; waiting for set 5; 10 min so far"
    log.after(0.0, "beat", doing="taking set 5", pace_h_per_s=1.23)
    assert text().plain == "hour 2.5, set 5 of 100; slower than set: 1.2 h per s"
    capsys.readouterr()


def test_a_restart_is_printed_with_its_cause(capsys):
    log = Log()
    with log.report:
        log.report.report_message(
            "web", {"event": "restarts", "cause": "was killed by signal 9", "in_s": 0.2}
        )
        log.report.report_message("web", {"event": "progress", "done": "of no recorder"})
        log.report.report_message("recorder", {"event": "nobody knows this one"})
        log.report.report_message("recorder", {"event": "alarm", **ALARM})
    assert lines(capsys) == [
        "web was killed by signal 9; started again in 0.2 s",
        "hour 12.5, ALARM, high: hole at C: inspect",
    ]


class GoneTerminal(io.StringIO):
    def write(self, text):
        raise OSError(5, "Input/output error")


def test_a_closed_terminal_ends_no_test(monkeypatch, caplog):
    monkeypatch.setattr(sys, "stderr", GoneTerminal())
    log = Log()
    with caplog.at_level(logging.DEBUG), log.report:
        log.progress(0.0, 1)
    assert "no reader for 'hour 0.5, set 1 of 100'" in caplog.text


class HeldTerminal(io.StringIO):
    """Stream that blocks until it is released, as a terminal after Ctrl-S."""

    def __init__(self):
        super().__init__()
        self.released = threading.Event()

    def write(self, text):
        happened(self.released.wait, "the release of the terminal")
        return super().write(text)


def test_a_blocked_terminal_delays_no_caller(monkeypatch):
    held = HeldTerminal()
    monkeypatch.setattr(sys, "stderr", held)
    log = Log()
    with log.report:
        log.progress(0.0, 1)
        log.report.report_message(
            "recorder", {"event": "restarts", "cause": "was killed by signal 9", "in_s": 0.2}
        )
        log.after(0.0, "alarm", **ALARM)
        assert held.getvalue() == ""
        held.released.set()
    assert len(held.getvalue().splitlines()) == 3, "everything is told when it is released"


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.4, "0 s"), (119.0, "119 s"), (120.0, "2 min"), (7200.0, "2.0 h"), (172_800.0, "2.0 d")],
)
def test_a_duration_has_its_unit(seconds, text):
    assert format_duration(seconds) == text


# A page on a screen ---------------------------------------------------------------------------------------


@pytest.fixture
def at_a_terminal(monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)


@pytest.mark.usefixtures("at_a_terminal")
@pytest.mark.parametrize(
    ("environment", "platform", "why"),
    [
        ({"DISPLAY": ":0"}, "linux", ""),
        ({"WAYLAND_DISPLAY": "wayland-0"}, "linux", ""),
        ({}, "linux", "no DISPLAY"),
        ({}, "win32", ""),
        ({}, "darwin", ""),
        ({"DISPLAY": ":0", "CI": "true"}, "linux", "CI"),
        ({"DISPLAY": ":10", "SSH_CONNECTION": "10.0.0.2 1 10.0.0.3 22"}, "linux", "SSH"),
        ({"SSH_TTY": "/dev/pts/1"}, "darwin", "SSH"),
    ],
)
def test_a_page_is_opened_for_an_interactive_user(environment, platform, why):
    assert describe_missing_screen(environment, platform) == why


def test_no_page_is_opened_for_a_program():
    assert describe_missing_screen({"DISPLAY": ":0"}, "linux") == "no terminal"


class Browser(webbrowser.BackgroundBrowser):
    def __init__(self):
        super().__init__("firefox")
        self.opened = threading.Event()
        self.urls: list[str] = []

    def open(self, url, new=0, autoraise=True):
        self.urls.append(url)
        self.opened.set()
        return True


@pytest.mark.usefixtures("at_a_terminal")
def test_the_page_is_opened_once_in_the_persons_browser(monkeypatch):
    browser = Browser()
    monkeypatch.setattr(terminal, "describe_missing_screen", lambda environment: "")
    monkeypatch.setattr(webbrowser, "get", lambda: browser)
    assert open_page("http://127.0.0.1:8000/")
    assert browser.opened.wait(60.0)
    assert browser.urls == ["http://127.0.0.1:8000/"]
    monkeypatch.setattr(terminal, "describe_missing_screen", lambda environment: "SSH")
    assert not open_page("http://127.0.0.1:8000/")


def test_no_browser_takes_the_terminal_itself(monkeypatch):
    monkeypatch.setattr(terminal, "describe_missing_screen", lambda environment: "")
    monkeypatch.delenv("BROWSER", raising=False)
    monkeypatch.setattr(webbrowser, "get", lambda: webbrowser.GenericBrowser("w3m"))
    assert not open_page("http://127.0.0.1:8000/")

    def none():
        raise webbrowser.Error("could not locate runnable browser")

    monkeypatch.setattr(webbrowser, "get", none)
    assert not open_page("http://127.0.0.1:8000/")
