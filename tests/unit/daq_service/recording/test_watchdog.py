"""The recording line feeds the watchdog of the service manager, and stops when the line hangs."""

import os
import socket
from itertools import pairwise

import pytest
from support.machine import NS_PER_S, Machine
from support.memory_line import Line, healthy, memory_settings

from daq_service.clock import parse_utc, wall
from daq_service.processes.heartbeat import Heartbeat
from daq_service.processes.service_manager import forward_to_service_manager, notify_manager
from hardware_drivers.measurement import ShotKey

pytestmark = pytest.mark.skipif(
    not hasattr(socket, "AF_UNIX"), reason="no service manager of this system speaks over a Unix socket"
)

DEADLINE_S = 60.0
HANGS_S = 10 * DEADLINE_S


class Manager:
    """Service manager's end of the notify socket; records messages with the machine's time."""

    def __init__(self, channel, machine):
        self.channel, self.machine = channel, machine
        self.heard: list[tuple[float, list[str]]] = []

    def report_message(self):
        while True:
            try:
                datagram = self.channel.recv(4096)
            except BlockingIOError:
                return
            self.heard.append((self.machine.elapsed_ns / NS_PER_S, datagram.decode().split("\n")))

    def times_s(self, assignment):
        return [at_s for at_s, lines in self.heard if assignment in lines]


class ListeningMachine(Machine):
    """Machine whose service manager listens during each sleep."""

    manager: Manager

    def sleep(self, seconds):
        self.manager.report_message()
        super().sleep(seconds)


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path, monkeypatch):
    """Listen at a path, or at an abstract address (Linux)."""
    address = str(tmp_path / "notify") if request.param == "path" else f"@solimon-{os.getpid()}-{id(request)}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
        try:
            channel.bind(address.replace("@", "\0", 1))
        except OSError as error:
            pytest.skip(f"no abstract sockets here: {error}")
        channel.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", address)
        monkeypatch.setattr(wall, "IDLE_INTERVAL_S", DEADLINE_S / 2)
        machine = ListeningMachine(parse_utc("2024-01-01T00:00:00Z"))
        machine.manager = Manager(channel, machine)
        yield machine.manager


def run(manager, folder, hang=None):
    """Run a line in real time on the manager's machine; return every event with its activity."""
    machine, events, hung = manager.machine, list[tuple[str, str]](), list[ShotKey]()

    def script(key):
        manager.report_message()
        if key == hang and not hung:
            hung.append(key)
            machine.elapsed_ns += round(HANGS_S * NS_PER_S)
            machine.utc_ns += round(HANGS_S * NS_PER_S)
            manager.report_message()  # messages sent meanwhile count as sent now
        return healthy(key)

    def report(event, **values):
        events.append((event, str(values.get("doing", ""))))

    settings = memory_settings(
        clock={"kind": "wall"}, schedule={"phases": [{"until_h": 1.0, "interval_h": 0.5}]}
    )
    clock = machine.clock()
    with forward_to_service_manager(report) as report_and_notify:
        heartbeat = Heartbeat(
            folder, deadline_s=DEADLINE_S, notify=report_and_notify, machine=machine.machine_clock()
        )
        line = Line(folder, settings=settings, script=script, heartbeat=heartbeat)
        heartbeat.beat("opening the rig")
        assert line.run(clock=clock, notify=report_and_notify)
        manager.report_message()
    manager.report_message()
    return events


def test_each_beat_of_the_line_feeds_the_watchdog(manager, tmp_path):
    events = run(manager, tmp_path)
    beats = [doing for event, doing in events if event == "beat"]
    (_, opening), (_, ready), *later, (_, stopping) = manager.heard
    lasts = f"EXTEND_TIMEOUT_USEC={DEADLINE_S * 1e6:.0f}"
    assert opening == ["WATCHDOG=1", lasts, "STATUS=opening the rig"], (
        "not ready yet, and it may take its time"
    )
    assert ready == ["READY=1"]
    assert [lines for _, lines in later] == [
        ["READY=1", "WATCHDOG=1", lasts, f"STATUS={doing}"] for doing in beats[1:]
    ]
    assert stopping[0] == "STOPPING=1"
    times_s = manager.times_s("WATCHDOG=1")
    assert times_s[-1] - times_s[0] >= 1800.0, "it waited for a set"
    assert max(after - before for before, after in pairwise(times_s)) <= DEADLINE_S


def test_a_hanging_line_does_not_feed_the_watchdog(manager, tmp_path):
    run(manager, tmp_path, hang=ShotKey(position="C", set_index=1, shot_index=2))
    gaps_s = [after - before for before, after in pairwise(manager.times_s("WATCHDOG=1"))]
    assert max(gaps_s) >= HANGS_S
    assert sum(gap_s > DEADLINE_S for gap_s in gaps_s) == 1


def test_no_notification_is_sent_without_a_service_manager(tmp_path, monkeypatch):
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    notify_manager("WATCHDOG=1")
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "gone"))
    notify_manager("WATCHDOG=1")
    assert list(tmp_path.iterdir()) == []


def test_the_activity_is_sent_in_one_line():
    sent: list[tuple[str, ...]] = []
    with forward_to_service_manager(
        lambda event, **values: None, lambda *lines: sent.append(lines)
    ) as report:
        report("beat", deadline_s=1.5, doing="waiting for the rig:\nWATCHDOG=trigger")
    assert sent[0] == (
        "WATCHDOG=1",
        "EXTEND_TIMEOUT_USEC=1500000",
        "STATUS=waiting for the rig: WATCHDOG=trigger",
    )


def test_a_manager_of_another_program_is_sent_nothing(manager, monkeypatch):
    """A shell of a service (Jupyter, tmux) passes its notify socket on."""
    monkeypatch.setenv("SYSTEMD_EXEC_PID", "1")
    notify_manager("STOPPING=1")
    monkeypatch.setenv("SYSTEMD_EXEC_PID", str(os.getpid()))
    notify_manager("READY=1")
    manager.report_message()
    assert [lines for _, lines in manager.heard] == [["READY=1"]]
