"""The supervisor and real processes: pipes, signals, exit codes, the heartbeat's file."""

import json
import os
import signal
import subprocess
import sys
import threading

import pytest

from daq_service.processes.child import notify_supervisor
from daq_service.processes.supervisor import ChildPlan, Supervisor

PRELUDE = """
import json, os, sys, time
def tell(event, **values):
    print(json.dumps({"event": event, **values}), flush=True)
def wait_for_pipe():
    while os.read(0, 1):
        pass
def starts(path):
    with open(path, "a") as file:
        file.write("x")
    return os.path.getsize(path)
"""


def supervise(folder, script, *, watched=True, stop=None, on_message=None, stay=False, **times):
    """Run one child whose program is ``script``; return exit code and messages without heartbeats."""
    program = folder / "child.py"
    program.write_text(f"{PRELUDE}{script}\ntell('ends', code=0)\n", encoding="utf-8")
    messages = []

    def keep(name, message):
        if message["event"] not in ("beat", "restarts"):
            messages.append(message)
        if on_message is not None:
            on_message(name, message)

    supervisor = Supervisor(
        [ChildPlan(name="child", arguments=[str(folder / "starts"), "{cause}"], watched=watched)],
        folder,
        on_message=keep,
        give_up=True,
        program=[sys.executable, str(program)],
        restart_delays_s=(0.0, 0.0, 0.0),
        **times,
    )
    code = supervisor.run(stop or threading.Event(), stay=stay)
    return code, messages


def test_a_child_leaves_when_its_pipe_closes(tmp_path):
    stop = threading.Event()
    script = """
tell("ready")
wait_for_pipe()
starts(sys.argv[1])
"""
    code, _ = supervise(tmp_path, script, stop=stop, on_message=lambda name, message: stop.set())
    assert code == 0
    assert (tmp_path / "starts").read_text() == "x", "it sees the end of its pipe and is not killed"


def test_a_child_that_does_not_leave_is_killed(tmp_path):
    stop = threading.Event()
    script = """
tell("ready", process=os.getpid())
while True:
    time.sleep(60)
"""
    code, messages = supervise(
        tmp_path, script, stop=stop, on_message=lambda name, message: stop.set(), leave_within_s=0.1
    )
    assert code == 0
    if os.name != "nt":
        with pytest.raises(ProcessLookupError):
            os.kill(messages[0]["process"], signal.SIGTERM)


def test_messages_are_one_json_line(capfd):
    notify_supervisor("listening", url="http://127.0.0.1:1/")
    assert json.loads(capfd.readouterr().out) == {"event": "listening", "url": "http://127.0.0.1:1/"}


@pytest.mark.skipif(os.name == "nt", reason="Windows has no pipes that refuse instead of waiting")
def test_a_stopped_supervisor_does_not_block_its_child():
    """Stopped by a debugger, say: the pipe is full after some hundred lines."""
    script = """
from daq_service.processes.child import notify_supervisor
for _ in range(3000):
    notify_supervisor("beat", doing="waiting for set 17")
"""
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as child:
        assert child.wait(60.0) == 0
        assert child.stdout is not None
        lines = child.stdout.read().splitlines()
    assert 100 < len(lines) < 3000
    assert {json.loads(line)["doing"] for line in lines} == {"waiting for set 17"}
