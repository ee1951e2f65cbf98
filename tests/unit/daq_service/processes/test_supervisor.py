"""The rules of the supervisor on a manual clock with scripted children."""

import io
import json
import subprocess
import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

import pytest
from support.machine import clock_in_seconds

from daq_service.clock import boot_name
from daq_service.processes.child import ANNOUNCEMENT
from daq_service.processes.heartbeat import Beat
from daq_service.processes.supervisor import (
    HEALTHY_AFTER_S,
    LEAVE_WITHIN_S,
    RESTART_DELAYS_S,
    STARTING_GRACE_S,
    ChildPlan,
    Supervisor,
)
from hardware_drivers.nanoseconds import NS_PER_S

KILLED = -9
RECORDER = ChildPlan(name="recorder", arguments=["record", "{cause}"], watched=True, environment={"A": "1"})
WEB = ChildPlan(name="web", arguments=["serve"])


class ScriptedChild:
    """Process double: time and code of its end, output, and time to leave."""

    def __init__(self, code=None, *, after_s=0.0, says=(), leaves_after_s=0.0, announces=True):
        self.code, self.after_s, self.leaves_after_s = code, after_s, leaves_after_s
        if announces and code is not None and code >= 0:
            says = [*says, json.dumps({"event": ANNOUNCEMENT, "code": code})]
        self.stdout = io.BytesIO("".join(f"{line}\n" for line in says).encode())
        self.stdin = io.BytesIO()
        self.pid, self.started_s, self.killed_s = 0, 0.0, None


class World:
    """Time, starts and heartbeats; ends everything at ``until_s``."""

    def __init__(self, *lives, plans=(RECORDER,), until_s=1e4):
        self.now_s, self.until_s = 0.0, until_s
        self.lives = list(lives)
        self.started: list[tuple[float, list[str], Mapping[str, str]]] = []
        self.running: list[ScriptedChild] = []
        self.messages: list[tuple[str, Any]] = []
        self.beat: Callable[[], Beat | None] = lambda: None
        self.guarded_s: list[float] = []
        self.plans = plans
        self.waits_for_a_message = False

    def run(self, *, stay=False, give_up=False):
        supervisor = Supervisor(
            self.plans,
            Path("unused"),
            on_message=lambda name, message: self.messages.append((name, message)),
            give_up=give_up,
            guard=lambda: self.guarded_s.append(self.now_s),
            program=["solimon"],
            start=self._start,
            read_beat=lambda folder: self.beat(),
            machine=clock_in_seconds(lambda: self.now_s),
        )
        return supervisor.run(cast(threading.Event, self), stay=stay)

    # The stop event of the supervisor: a wait for it advances the time.
    def is_set(self):
        return self.now_s >= self.until_s

    def wait(self, seconds):
        if self.waits_for_a_message and not self.messages:
            threading.Event().wait(0.001)  # the time does not advance until a line is received
            return False
        self.now_s += seconds
        return self.is_set()

    def _start(self, command, environment):
        self.started.append((self.now_s, list(command), environment))
        life = self.lives.pop(0) if self.lives else ScriptedChild()
        process = _Process(self, life)
        self.running.append(life)
        return cast("subprocess.Popen[bytes]", process)

    def starts_s(self):
        return [at_s for at_s, _, _ in self.started]

    def causes(self):
        return [command[2] for _, command, _ in self.started]


class _Process:
    """`Popen` double of the supervisor."""

    def __init__(self, world, life):
        self._world, self._life = world, life
        self.stdin, self.stdout, self.pid = life.stdin, life.stdout, 4711
        self.stderr = io.BytesIO()
        life.started_s = world.now_s

    def poll(self):
        life = self._life
        if life.killed_s is not None:
            return KILLED
        ended = life.code is not None and self._world.now_s >= life.started_s + life.after_s
        return life.code if ended else None

    def kill(self):
        self._life.killed_s = self._world.now_s

    def wait(self, timeout=None):
        code = self.poll()
        if code is not None:
            return code
        assert timeout is not None, "whoever waits for ever was killed"
        assert self.stdin.closed, "a child is told to leave before it is waited for"
        leaves_after_s = self._life.leaves_after_s
        if leaves_after_s is None or leaves_after_s > timeout:
            self._world.now_s += timeout
            raise subprocess.TimeoutExpired("child", timeout)
        self._world.now_s += leaves_after_s
        return 0


def beat_at(world, mono_s, *, boot=None, deadline_s=5.0):
    return Beat(
        process=1,
        mono_ns=round(mono_s * NS_PER_S),
        deadline_s=deadline_s,
        doing="taking set 3",
        boot=boot or boot_name(),
    )


def test_a_recorder_that_is_done_ends_the_supervision_unless_the_web_stays():
    assert World(ScriptedChild(0)).run() == 0
    world = World(ScriptedChild(0), ScriptedChild(), plans=(RECORDER, WEB), until_s=100.0)
    assert world.run(stay=True) == 0
    assert world.now_s >= 100.0
    assert len(world.started) == 2


def test_a_recorder_stopped_by_an_operator_is_not_restarted():
    """Exit code 130 is a command of the operator: a restart would strike against it."""
    world = World(ScriptedChild(130))
    assert world.run() == 130
    assert len(world.started) == 1
    assert world.messages == [("recorder", {"event": "stopped"})]


@pytest.mark.parametrize("code", [0, 2, 3, 4, 5, 130])
@pytest.mark.parametrize("plan", [RECORDER, WEB])
def test_an_exit_code_that_was_not_announced_is_a_crash(plan, code):
    """A driver or vendor library ended the process and does not know the exit codes."""
    world = World(
        ScriptedChild(code, after_s=1.0, announces=False), ScriptedChild(), plans=(plan,), until_s=10.0
    )
    assert world.run(stay=True) == 0
    assert len(world.started) == 2
    cause = {"cause": f"ended with exit code {code}, which it had not announced", "in_s": RESTART_DELAYS_S[0]}
    assert world.messages == [(plan.name, {"event": "restarts", **cause})]


def test_an_announced_code_counts_also_where_a_library_ends_the_process_afterwards():
    ended = json.dumps({"event": ANNOUNCEMENT, "code": 3})
    assert World(ScriptedChild(-11, says=[ended])).run() == 3
    assert World(ScriptedChild(0, says=[ended], announces=False)).run() == 3


@pytest.mark.parametrize("code", [2, 3, 4, 5])
def test_a_documented_exit_code_stops_all_processes_and_is_passed_on(code):
    web = ScriptedChild()
    world = World(ScriptedChild(code, after_s=1.0), web, plans=(RECORDER, WEB))
    assert world.run(stay=True) == code
    assert len(world.started) == 2
    assert web.stdin.closed


def test_a_started_test_is_served_after_its_recorder_has_ended():
    """An engineer wants to see the reason; the code is passed on when the dashboard is stopped."""
    line = json.dumps({"event": "progress", "done": 1})
    recorder = ScriptedChild(4, after_s=1.0, says=[line])
    world = World(recorder, ScriptedChild(), plans=(RECORDER, WEB), until_s=100.0)
    world.waits_for_a_message = True
    assert world.run(stay=True) == 4
    assert world.now_s >= 100.0
    assert len(world.started) == 2
    assert ("recorder", {"event": "failed", "code": 4}) in world.messages
    assert world.guarded_s[0] == 0.0, "its drive is guarded from the start, also while a recorder hangs"
    assert world.guarded_s[-1] > 99.0


def test_a_child_that_keeps_failing_waits_longer_each_time():
    world = World(*(ScriptedChild(1) for _ in range(9)), until_s=120.0)
    world.run()
    pauses = [b - a for a, b in zip(world.starts_s(), world.starts_s()[1:], strict=False)]
    expected = [*RESTART_DELAYS_S, RESTART_DELAYS_S[-1], RESTART_DELAYS_S[-1]]
    # The end is detected one poll (0.05 s) after the start, the restart at the first poll after the delay.
    assert pauses == pytest.approx([0.05 + delay_s for delay_s in expected], abs=0.051)
    assert world.causes()[:2] == ["", "ended with exit code 1"]


def test_a_child_that_lived_well_starts_again_at_the_first_delay():
    world = World(
        ScriptedChild(1),
        ScriptedChild(1),
        ScriptedChild(1, after_s=HEALTHY_AFTER_S),
        ScriptedChild(),
        until_s=100.0,
    )
    world.beat = lambda: beat_at(world, world.now_s)
    world.run()
    started = world.starts_s()
    assert started[2] - started[1] == pytest.approx(0.05 + RESTART_DELAYS_S[1], abs=0.051)
    assert started[3] - started[2] == pytest.approx(HEALTHY_AFTER_S + RESTART_DELAYS_S[0], abs=0.101)


def test_a_child_that_always_crashes_is_given_up():
    world = World(*(ScriptedChild(1) for _ in range(20)))
    assert world.run(give_up=True) == 1
    assert len(world.started) == 1 + len(RESTART_DELAYS_S)


def test_a_child_gets_its_environment_and_the_cause_of_its_restart():
    world = World(ScriptedChild(-15), ScriptedChild(0))
    world.run()
    assert world.started[0][1:] == (["solimon", "record", ""], {"A": "1"})
    assert world.causes()[1] == "was killed by signal 15"


def test_a_recorder_is_killed_at_its_deadline():
    hung = ScriptedChild()
    world = World(hung, ScriptedChild(0))
    world.beat = lambda: beat_at(world, min(world.now_s, 20.0))
    world.run()
    assert hung.killed_s == pytest.approx(25.0, abs=0.101)  # the next poll after the deadline
    assert world.causes()[1].startswith("hung while taking set 3: heartbeat 0.")
    assert world.causes()[1].endswith("s past its deadline of 5 s")


def test_a_beat_on_the_pipe_counts_where_the_file_has_none():
    """A full disk must not cause a restart of the recorder."""
    alive = ScriptedChild()
    world = World(alive, ScriptedChild(0))
    beat = beat_at(world, STARTING_GRACE_S / 2, deadline_s=100.0)
    message = {"event": "beat", **asdict(beat)}
    alive.stdout = io.BytesIO(2 * (json.dumps(message).encode() + b"\n"))
    world.run()
    assert alive.killed_s == pytest.approx(STARTING_GRACE_S / 2 + 100.0, abs=0.101)
    restarts = {"event": "restarts", "cause": world.causes()[1], "in_s": 0.2}
    assert world.messages == [("recorder", message), ("recorder", restarts)], "of two beats alike one is news"


def test_a_web_service_that_stalls_is_killed_and_started_again():
    """It has sent one beat and no other: its event loop hangs, or its process is stopped."""
    stalled = ScriptedChild()
    world = World(stalled, ScriptedChild(), plans=(WEB,), until_s=60.0)
    message = {"event": "beat", **asdict(beat_at(world, 1.0, deadline_s=15.0))}
    stalled.stdout = io.BytesIO(json.dumps(message).encode() + b"\n")
    world.beat = lambda: beat_at(world, world.now_s)  # the recorder's file does not count for another process
    world.run(stay=True)
    assert stalled.killed_s == pytest.approx(16.0, abs=0.101)
    assert len(world.started) == 2
    assert world.running[1].killed_s is None, "one that has not beaten yet is left alone"


def test_a_recorder_that_beats_is_left_alone():
    world = World(ScriptedChild(0, after_s=500.0))
    world.beat = lambda: beat_at(world, 4.0 * (world.now_s // 4.0))
    assert world.run() == 0
    assert len(world.started) == 1


def test_an_unreadable_beat_does_not_replace_the_previous_one():
    world = World(ScriptedChild(0, after_s=STARTING_GRACE_S + 20.0))
    world.beat = lambda: None if round(world.now_s / 0.05) % 3 else beat_at(world, world.now_s)
    assert world.run() == 0
    assert len(world.started) == 1


def stale(world):
    """Return the beat of the previous recorder."""
    return beat_at(world, -100.0)


def earlier_boot(world):
    """Return a beat ahead of this boot's monotonic time, with the same process number."""
    return beat_at(world, 1e6, boot="another")


def earlier_boot_of_an_older_version(world):
    return beat_at(world, 1e6)


def no_beat(world):
    return None


@pytest.mark.parametrize("found", [no_beat, stale, earlier_boot, earlier_boot_of_an_older_version])
def test_a_child_without_a_beat_of_its_own_has_its_starting_grace(found):
    silent = ScriptedChild()
    world = World(silent, ScriptedChild(0))
    world.beat = lambda: found(world)
    world.run()
    assert silent.killed_s == pytest.approx(STARTING_GRACE_S, abs=0.101)
    assert world.causes()[1] == f"gave no heartbeat within {STARTING_GRACE_S:g} s of its start"


def test_children_are_stopped_together_and_killed_after_their_time_limit():
    good, bad = ScriptedChild(leaves_after_s=1.0), ScriptedChild(leaves_after_s=None)
    world = World(good, bad, plans=(RECORDER, WEB), until_s=10.0)
    assert world.run(stay=True) == 0
    assert good.killed_s is None
    assert bad.killed_s == pytest.approx(10.0 + LEAVE_WITHIN_S, abs=0.051)


def test_a_childs_messages_are_passed_on_and_other_lines_are_not(caplog):
    says = [json.dumps({"event": "progress", "done": 1}), "hello", json.dumps({"event": "finished"})]
    world = World(ScriptedChild(0, says=says))
    world.run()
    assert world.messages == [
        ("recorder", {"event": "progress", "done": 1}),
        ("recorder", {"event": "finished"}),
    ]
    assert "printed a line that is not a message: b'hello" in caplog.text


@pytest.mark.parametrize("code", [1, 4, 5])
def test_a_web_service_that_has_listened_is_started_again_at_its_port(code):
    says = [json.dumps({"event": "listening", "url": "http://127.0.0.1:4711/", "port": 4711})]
    # It ends after its line is read, however late its reader comes to it.
    first = ScriptedChild(code, after_s=0.01, says=says, announces=False)
    world = World(first, ScriptedChild(), plans=(WEB,), until_s=10.0)
    world.waits_for_a_message = True
    world.run(stay=True)
    assert world.started[1][1] == ["solimon", "serve", "--port", "4711"]
