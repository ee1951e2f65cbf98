"""The twin's worker process: the same records, no orphan, and no loss where it dies."""

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
from functools import partial

import numpy as np
import pytest

from daq_service.clock import parse_utc
from daq_service.rig.open_rig import open_rig
from daq_service.rig.twin import _forward_messages, build_transducers, compute_records, start_twin_executor
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import ShotKey
from simulator.clock import SimulatedClock
from simulator.instruments import RECORDS_AHEAD, build_bench

TIMEOUT_S = 120.0


def settings_with(**clock):
    """Return settings of transducers on infinite plates, which need no reduction."""
    plain = Settings().model_dump()
    for place in plain["positions"].values():
        place["plate"]["model"] = "infinite_kirchhoff"
        place["corrosion"]["depth_fraction"] = 0.0
    plain["twin"] |= {"thinning": {}, "nuisance": "plant"}
    plain["clock"] |= clock
    return Settings.model_validate(plain)


SETTINGS = settings_with()
EPOCH_NS = parse_utc(SETTINGS.clock.epoch)


def key(shot_index):
    return ShotKey(position="D", set_index=0, shot_index=shot_index)


def shoot(instruments, shot):
    instruments.digitizer.arm(shot)
    instruments.striker.strike(shot)
    return instruments.digitizer.read(TIMEOUT_S)


def next_shots(shot, utc_ns):
    return ((key(index), utc_ns) for index in range(shot.shot_index + 1, 1_000))


def bench(executor=None):
    return build_bench(
        SETTINGS.twin,
        clock=SimulatedClock(EPOCH_NS),
        epoch_utc_ns=EPOCH_NS,
        transducers=build_transducers(SETTINGS),
        probed_thickness_m={},
        strikes_after=next_shots,
        executor=executor,
        compute=partial(compute_records, SETTINGS.model_dump_json()),
    )


def assert_same(first, second):
    np.testing.assert_array_equal(first.waveform.counts, second.waveform.counts)
    assert first.waveform.sample_rate_hz == second.waveform.sample_rate_hz
    assert dict(first.truth) == pytest.approx(dict(second.truth), rel=0.0, abs=0.0, nan_ok=True)


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signal")
def test_records_are_the_same_and_a_killed_worker_costs_none(caplog):
    plain = bench()
    executor = start_twin_executor(SETTINGS)
    try:
        worker = executor.submit(os.getpid).result(TIMEOUT_S)
        assert worker != os.getpid()
        ahead = bench(executor)
        for index in range(3):
            assert_same(shoot(ahead, key(index)), shoot(plain, key(index)))
        os.kill(worker, signal.SIGKILL)
        # More than can have been computed before the kill.
        for index in range(3, 10 + RECORDS_AHEAD):
            assert_same(shoot(ahead, key(index)), shoot(plain, key(index)))
    finally:
        executor.shutdown(cancel_futures=True)
    assert "not computed ahead any more" in caplog.text


def test_a_compiling_worker_is_reported_and_a_dead_one_ends_its_compilation():
    heard = []
    hear, sender = multiprocessing.get_context("spawn").Pipe(duplex=False)
    for word in (True, False, True):
        sender.send(word)
    sender.close()  # as the system does for a worker that is killed
    with hear:
        _forward_messages(hear, heard.append)
    assert heard == [True, False, True, False]


ORPHAN = """
import os, sys
from daq_service.settings.tree import Settings
from daq_service.rig.twin import start_twin_executor

if __name__ == "__main__":
    executor = start_twin_executor(Settings.model_validate_json(sys.argv[1]))
    print(executor.submit(os.getpid).result(), flush=True)
    sys.stdin.read()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="the worker inherits the pipe on POSIX only")
def test_the_worker_of_a_killed_recorder_leaves(tmp_path):
    script = tmp_path / "recorder.py"
    script.write_text(ORPHAN, encoding="utf-8")
    with subprocess.Popen(
        [sys.executable, str(script), SETTINGS.model_dump_json()],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as recorder:
        assert recorder.stdout is not None
        assert int(recorder.stdout.readline()) != recorder.pid
        recorder.kill()
        # The worker holds the other end of this pipe, too: it ends when both are gone.
        rest, _ = recorder.communicate(timeout=TIMEOUT_S)
    assert rest == ""


@pytest.mark.parametrize(
    ("clock", "own_process"), [({"pace_h_per_s": None}, True), ({"pace_h_per_s": 5.0}, False)]
)
def test_a_long_unattended_test_has_a_twin_process_and_leaves_nothing(clock, own_process):
    settings = settings_with(**clock)
    with open_rig(settings, SimulatedClock(EPOCH_NS), EPOCH_NS) as rig:
        for index in range(2):
            rig.digitizer.arm(key(index))
            rig.striker.strike(key(index))
            rig.digitizer.read(TIMEOUT_S)
        assert bool(multiprocessing.active_children()) == own_process
        threads = {thread.name for thread in threading.enumerate()}
        assert any(name.startswith("twin") for name in threads) != own_process
    assert multiprocessing.active_children() == []
    assert not any(thread.name.startswith("twin") for thread in threading.enumerate())
