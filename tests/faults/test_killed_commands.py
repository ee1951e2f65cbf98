"""Recorder and web service killed while orders come: each is done once, or refused with its reason."""

import itertools
import json
import os
import random
import subprocess
import sys
import threading
from collections import Counter
from contextlib import ExitStack

import httpx2
import pytest
from support.killed_commands import EVENT_OF, alarm_orders, command, note, person, restart, wrong_with
from support.refusing_files import needs_a_preload, with_support
from support.small_experiment import SMALL
from support.traced_files import build, fast_folder, read_trace, states, tracing, write_state
from support.waiting import WAIT_S, ended, until

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.rows import CommandRow
from daq_service.commands.registry import KINDS


def test_each_kind_that_only_stores_is_checked():
    assert {kind for kind, order in KINDS.items() if order.rows_only} == EVENT_OF.keys()


@pytest.fixture(scope="module")
def fast():
    """Return a folder in memory if there is one: hundreds of states are written and synced."""
    with fast_folder() as folder:
        yield folder


@pytest.fixture(scope="module")
def calls(fast):
    """Return every disk call while each kind of command is given and executed, with marks of the answers."""
    folder, trace = fast / "data", fast / "trace"
    folder.mkdir()
    environment = with_support(tracing(build(fast), fast / "none", fast / "none"))
    command = [sys.executable, "-m", "support.killed_commands", folder, trace]
    subprocess.run(command, env=environment, check=True)
    assert wrong_with(folder, range(1, len(EVENT_OF) + 1)) == []
    return read_trace(trace, folder)


@needs_a_preload
@pytest.mark.parametrize(
    ("models", "every"),
    [
        # What is durable changes with each sync: some six times an order, of which each kind shows others.
        pytest.param(("nothing",), 4, id="some syncs"),
        # Pages lost within lines written to the history at once are corruption: `verify` reports it.
        pytest.param(("kill", "nothing", "torn"), 1, id="each call", marks=pytest.mark.slow),
    ],
)
def test_a_crash_after_a_call_leaves_each_command_executed_once_or_rejected(
    calls, fast, models, every, capsys
):
    count, became = 0, Counter()
    promised = (found for found in states(calls, models=models) if found[2])
    for name, state, answered in itertools.islice(promised, 0, None, every):
        folder = fast / f"state {count}"
        write_state(state, folder)
        restart(folder)
        assert wrong_with(folder, answered) == [], name
        with open_catalogue(folder) as catalogue:
            became.update(row.state for row in catalogue.rows(CommandRow))
        count += 1
    assert count > len(EVENT_OF), "more than one state an order"
    assert min(became["done"], became["expired"]) > 0, became
    if every == 1:
        with capsys.disabled():
            print(f"\n{len(calls)} calls, {count} states: {dict(became)}")


# Real processes ---------------------------------------------------------------------------------------

KILLS = 30
KINDS_OF_KILL = (("recorder",), ("web",), ("recorder", "web"))
OF_A_BASELINE = {"strike", "renew_baseline", "approve_baseline"}
"""These wait for sets of their own, a round of orders does not: a crash behind each call tells of them."""
LONGEST_LIFE_S = 0.5
"""Some orders; some kills come before the first one."""


class Processes:
    """Recorder and web service of one folder, each restarted when it is gone."""

    def __init__(self, config, folder):
        self.folder, self.url, self.kills = folder, "", Counter[str]()
        self._common = [config, "--data-dir", folder]
        self._running: dict[str, subprocess.Popen[str]] = {}

    def start(self):
        """Start missing processes; wait until the service listens."""
        words = {
            "recorder": ["record", *self._common, "--linger"],
            "web": ["serve", *self._common, "--port", "0"],
        }
        for name, arguments in words.items():
            if name in self._running and self._running[name].poll() is None:
                continue
            cause = ["--restart-reason", "was killed"] if self.kills[name] else []
            output = subprocess.PIPE if name == "web" else subprocess.DEVNULL
            program = [sys.executable, "-m", "daq_service.cli", *arguments, *cause]
            # Their logs report faults; what Python says of locks that a kill left is not ours.
            process = subprocess.Popen(program, stdout=output, stderr=subprocess.DEVNULL, text=True)
            self._running[name] = process
            if process.stdout is not None:
                with process.stdout:
                    first_line = process.stdout.readline()
                assert first_line.startswith("dashboard: "), first_line
                self.url = first_line.split()[1]

    def kill(self, *names):
        for name in names:
            self._running[name].kill()
            self.kills[name] += 1
        for name in names:
            ended(self._running[name], "the kill")

    def stop(self):
        """Let the recorder answer open commands and end."""
        for process in reversed(self._running.values()):
            process.terminate()
            ended(process, "the end")


class Client(threading.Thread):
    """Client that sends consecutive commands and checks their results while the service restarts."""

    def __init__(self, processes):
        super().__init__()
        self.stop, self.answered, self.faults = threading.Event(), set[int](), list[str]()
        self.given = 0
        self._processes = processes

    def run(self):
        steps = itertools.cycle(range(11))
        step = next(steps)
        while not self.stop.is_set():
            try:
                self._give(*self._order(step))
                step = next(steps)
            except httpx2.TransportError:
                self.stop.wait(0.05)  # nothing listens there now

    def _order(self, step):
        """Send the next command of a round in which each is possible after those before it."""
        if 3 <= step < 8:
            return alarm_orders(self._newest("alarms?position=C&kind=transducer_disabled&active=true"))[
                step - 3
            ]
        return {
            0: note,
            1: lambda: command(
                "withdraw_annotation", annotation_id=self._newest("annotations?withdrawn=false")
            ),
            2: lambda: command("disable", position="C"),
            8: lambda: command("enable", position="C", note=person(self.given)),
            9: lambda: command("pause", note="hands in the rig"),
            10: lambda: command("resume"),
        }[step]()

    def _newest(self, listing):
        items = self._ask("GET", listing).json().get("items")
        return items[-1]["id"] if items else 1

    def _give(self, path, body):
        body = {**body, "author": person(self.given)}
        self.given += 1
        answer = self._ask("POST", path, json=body)
        if answer.status_code == 202:
            self.answered.add(answer.json()["id"])
            self._follow(answer.json()["id"])
        elif answer.status_code not in (404, 409, 503):
            self.faults.append(answer.text)

    def _follow(self, order_id):
        while not self.stop.wait(0.01):
            answer = self._ask("GET", f"commands/{order_id}")
            if answer.status_code != 200 or answer.json()["state"] not in ("pending", "started"):
                return

    def _ask(self, method, path, **body):
        url = f"{self._processes.url}api/v1/{path}"
        return httpx2.request(method, url, timeout=WAIT_S, verify=False, **body)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGKILL")
def test_processes_killed_while_commands_arrive_execute_each_at_most_once(tmp_path, capsys):
    moments, config, pause = random.Random(1), tmp_path / "test.json", threading.Event()
    schedule = {**SMALL["schedule"], "phases": [{"until_h": 2000.0, "interval_h": 0.5}]}
    settings = {**SMALL, "schedule": schedule, "clock": {"pace_h_per_s": 2.0}}
    config.write_text(json.dumps(settings), encoding="utf-8")
    (tmp_path / "data").mkdir()  # a service refuses a folder that is not there
    processes = Processes(config, tmp_path / "data")
    client = Client(processes)
    with ExitStack() as stack:
        stack.callback(processes.stop)
        processes.start()
        until((tmp_path / "data" / "catalogue.sqlite").exists, "the catalogue")
        client.start()
        stack.callback(client.join)
        stack.callback(client.stop.set)
        for number in range(KILLS):
            before = len(client.answered)
            until(lambda before=before: len(client.answered) > before + 2, "three more orders")
            pause.wait(moments.uniform(0.0, LONGEST_LIFE_S))
            processes.kill(*KINDS_OF_KILL[number % len(KINDS_OF_KILL)])
            processes.start()
    assert client.faults == []
    assert wrong_with(tmp_path / "data", client.answered) == []
    with open_catalogue(tmp_path / "data") as catalogue:
        orders = catalogue.rows(CommandRow)
    assert {row.kind for row in orders if row.state == "done"} == EVENT_OF.keys() - OF_A_BASELINE
    with capsys.disabled():
        became = dict(Counter(row.state for row in orders))
        print(f"\n{dict(processes.kills)} killed, {len(client.answered)} orders answered: {became}")
