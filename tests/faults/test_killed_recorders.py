"""Supervisors and recorders killed at any moment, in turn, on one folder: as if nothing had happened."""

import os
import random
import re
import signal
import threading
from dataclasses import replace
from multiprocessing import Pipe

import pytest
from support.daqmx_models import in_a_process
from support.small_experiment import SMALL, rows_of, run, small_settings
from support.waiting import ended, until

from daq_service.archive import FolderSetReader
from daq_service.archive.journal.reader import read_journal
from daq_service.cli.maintenance.verify import verify_folder
from daq_service.cli.run import plan_children
from daq_service.processes.child import stop_on_signals
from daq_service.processes.data_folder import LOCK_FILE, is_held, prepare_data_folder, read_lock_owner
from daq_service.processes.supervisor import Supervisor

LONGEST_LIFE_S = 0.5
"""Some sets, on this machine or a busy one; some kills come before the first one."""
PACE_H_PER_S = 2.0


def schedule_for(kills):
    """Return a schedule of two sets for each kill."""
    return {**SMALL["schedule"], "phases": [{"until_h": 1.0 * kills, "interval_h": 0.5}]}


def supervise(config, folder, acknowledged):
    """Run the supervisor of ``solimon run`` in a child; send each acknowledged shot, None at the end."""
    prepare_data_folder(folder)
    (plan,) = plan_children(config, folder, port=None, web=False, linger=False)
    plan = replace(plan, arguments=[*plan.arguments, "--log-json"])

    def on_message(child, message):
        if message["event"] in ("shot_acknowledged", "finished"):
            acknowledged.send(message.get("shot_id"))

    with stop_on_signals() as stop:
        code = Supervisor([plan], folder, on_message=on_message, restart_delays_s=(0.0,)).run(
            stop, stay=False
        )
    raise SystemExit(code)


def another_owner(folder, before):
    """Return the process id of the recorder on a folder; None if there is no other than ``before``."""
    owner = re.match(r"process (\d+)", read_lock_owner(folder, LOCK_FILE)) if is_held(folder) else None
    return int(owner[1]) if owner and int(owner[1]) != before else None


@pytest.mark.timeout(3600)  # 4 kills: each process at any moment, and soon after a shot
@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGKILL")
@pytest.mark.parametrize("kills", [4, pytest.param(200, marks=pytest.mark.slow)])
def test_kills_at_any_moment_lose_no_acknowledged_shot_and_change_no_row(tmp_path, kills):
    moments, folder, config = random.Random(kills), tmp_path / "data", tmp_path / "test.json"
    paced = small_settings(schedule=schedule_for(kills), clock={"pace_h_per_s": PACE_H_PER_S})
    # Every key: one that is missing in a file of JSON has the value of the version that wrote such files.
    config.write_text(paced.model_dump_json(), encoding="utf-8")
    acknowledged, killed = [], {"supervisor": 0, "recorder": 0}
    pause = threading.Event()
    here, there = Pipe(duplex=False)

    def hear():
        while here.poll():
            acknowledged.append(here.recv())
        return len(acknowledged)

    with here, there:
        supervisor, last = in_a_process(supervise, config, folder, there), None
        for number in range(kills):
            recorder = until(
                lambda before=last, watched=supervisor: (
                    watched.exitcode is not None or another_owner(folder, before)
                ),
                "another recorder",
            )
            if number % 4 > 1:
                # However busy the machine is, half of the kills come after shots.
                heard = hear()
                until(
                    lambda n=heard, watched=supervisor: watched.exitcode is not None or hear() > n,
                    "another shot",
                )
            pause.wait(moments.uniform(0.0, LONGEST_LIFE_S))
            hear()
            if supervisor.exitcode is not None or None in acknowledged:
                break  # it was done before
            if number % 2:
                supervisor.kill()
                ended(supervisor, "the kill")
                supervisor.close()
                killed["supervisor"] += 1
                # At once: the recorder that was left alone is still leaving.
                supervisor = in_a_process(supervise, config, folder, there)
            else:
                os.kill(recorder, signal.SIGKILL)
                killed["recorder"] += 1
            last = recorder
        while supervisor.is_alive():
            hear()
            supervisor.join(0.05)
        hear()
        assert supervisor.exitcode == 0
        supervisor.close()
    assert min(killed.values()) >= kills / 4, "the test was over before it was disturbed"
    assert run(small_settings(schedule=schedule_for(kills)), tmp_path / "undisturbed")
    found = rows_of(folder)
    assert found == rows_of(tmp_path / "undisturbed")
    assert {row.sequence for row in found["shots"]} >= set(acknowledged) - {None}
    reader = FolderSetReader(folder)
    assert set(reader.sets()) == {row.set_key for row in found["sets"]}
    assert read_journal(folder) == {}
    assert verify_folder(folder).damage == []
