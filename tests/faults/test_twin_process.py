"""The twin's worker process: the same records, no orphan, and no loss where it dies."""

import multiprocessing
import os
import re
import signal
import subprocess
import sys
import threading
from functools import partial

import numpy as np
import pytest

from daq_service.clock import parse_utc
from daq_service.rig.open_rig import open_rig
from daq_service.rig.twin import (
    PREPARING,
    build_transducers,
    compute_records,
    prepare_twin,
    start_twin_executor,
)
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
    executor = start_twin_executor()
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


def test_progress_is_reported_until_the_twin_is_prepared(monkeypatch):
    reports, is_reported = [], threading.Event()

    def report(what, begins):
        reports.append((what, begins))
        is_reported.set()

    def build_after_a_report(settings):  # with loops in the cache all may be ready before the first report
        assert is_reported.wait(60.0)
        return build_transducers(settings)

    monkeypatch.setattr("daq_service.rig.twin.build_transducers", build_after_a_report)
    transducers = prepare_twin(SETTINGS, None, report)
    assert list(transducers) == list(build_transducers(SETTINGS))
    assert re.fullmatch(rf"{PREPARING}: part [123] of 3, \d+ s", reports[0][0])
    assert reports[-1] == (PREPARING, False)
    assert all(begins for _, begins in reports[:-1])


COLD = """
import sys
from daq_service.settings.tree import Settings
from daq_service.rig.twin import prepare_twin
from simulator.compile_loops import compile_other_loops
from simulator.shot import kernel

if __name__ == "__main__":
    prepare_twin(Settings.model_validate_json(sys.argv[1]), None, lambda what, begins: None)
    compile_other_loops("linear")
    for width in (kernel.WIDEST, kernel.NARROWEST):
        stats = kernel.compile_time_loop(width, True).stats
        print(width, sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
"""


@pytest.mark.slow
def test_two_processes_share_the_compilations_of_a_first_start(tmp_path):
    script = tmp_path / "cold.py"
    script.write_text(COLD, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(script), SETTINGS.model_dump_json()],
        env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "code")},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines() == ["8 0 1", "2 1 0"], "the loop of few strikes is loaded"


ORPHAN = """
import os, sys
from daq_service.rig.twin import start_twin_executor

if __name__ == "__main__":
    executor = start_twin_executor()
    print(executor.submit(os.getpid).result(), flush=True)
    sys.stdin.read()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="the worker inherits the pipe on POSIX only")
def test_the_worker_of_a_killed_recorder_leaves(tmp_path):
    script = tmp_path / "recorder.py"
    script.write_text(ORPHAN, encoding="utf-8")
    with subprocess.Popen(
        [sys.executable, str(script)],
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
