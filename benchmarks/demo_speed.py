"""Cost of the demonstration by stage, fsync included, next to the obvious line.

    python benchmarks/demo_speed.py [--hours H] [--rounds R] [--cold] [--json]

The whole test is 350 h, 425 sets; a shorter one shows the same cost a set. Three runs alternate, so that a
busy machine disturbs them alike; each is a process of its own in a new folder:

- the command ``solimon demo --exit --no-web``, from its start to its end;
- the recorder alone;
- the recorder alone on the obvious line: one thread, each record computed when it is read, chunks
  compressed by HDF5. Every shot and every row is the same.

A test of less than 2,000 strikes (34 h) has no process of its own for the twin.

With ``--cold`` the command starts with empty caches: machine code and reduced plates are made again.
Processor time is that of all threads and processes (on Windows without the twin's) and is hardly disturbed
by other programs; wall time is.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from statistics import mean
from typing import Any

from h5py import h5s

from daq_service.archive import FolderSetReader, nexus
from daq_service.catalogue import open_catalogue
from daq_service.catalogue.rows import EventRow
from daq_service.processes.data_folder import prepare_data_folder
from daq_service.recording.recorder import STAGES
from daq_service.recording.session import record_test
from daq_service.rig.open_rig import open_rig
from daq_service.settings.file import load_settings
from daq_service.settings.tree import Settings
from hardware_drivers.instruments import Clock, Rig
from simulator.instruments import build_bench
from simulator.shot.model import ShotModel
from simulator.specimen import Transducer

COMMAND, RECORDER, OBVIOUS = "command", "recorder", "obvious line"
ONE_PROCESS = (RECORDER, OBVIOUS)
CACHES = {"NUMBA_CACHE_DIR": "machine-code", "XDG_CACHE_HOME": "reductions", "LOCALAPPDATA": "reductions"}
"""Where machine code and reduced plates are kept (`numerics.array_cache`), and a folder for a cold start."""


@contextmanager
def one_thread_rig(settings: Settings, clock: Clock, epoch_utc_ns: int) -> Iterator[Rig]:
    """Open the twin without a worker."""
    places = settings.positions
    bench = build_bench(
        settings.twin,
        clock=clock,
        epoch_utc_ns=epoch_utc_ns,
        transducers={
            name: Transducer(
                chain=places[name].chain,
                model=ShotModel(places[name].chain, places[name].plate, places[name].corrosion),
            )
            for name in settings.list_positions("solitary_wave")
        },
        probed_thickness_m={
            name: places[name].plate.thickness_m for name in settings.list_positions("pulse_echo")
        },
    )
    with Rig(
        kind="simulated",
        clock=clock,
        striker=bench.striker,
        digitizer=bench.digitizer,
        pulse_echo=bench.pulse_echo,
    ) as rig:
        yield rig


@contextmanager
def compression_by_hdf5() -> Iterator[None]:
    """Make HDF5 filter the chunks itself."""

    def written_by_hdf5(dataset: Any, array: Any, chunk: Any) -> None:
        del chunk
        dataset.write(h5s.ALL, h5s.ALL, array, mtype=dataset.get_type())

    ours = nexus.write_chunks
    nexus.write_chunks = written_by_hdf5
    try:
        yield
    finally:
        nexus.write_chunks = ours


def run_recorder(hours: float, kind: str) -> dict[str, Any]:
    """Record in this process; wall and processor time with the cost by stage."""
    settings = load_settings(None)
    schedule = settings.schedule.model_copy(update={"end_h": hours})
    settings = settings.model_copy(update={"schedule": schedule})
    with tempfile.TemporaryDirectory() as folder:
        prepare_data_folder(Path(folder))
        wall, processor = time.perf_counter(), sum(os.times()[:4])
        rig = one_thread_rig if kind == OBVIOUS else open_rig
        finished = record_test(
            settings, Path(folder), rig, stop=threading.Event(), report=lambda *_, **__: None
        )
        wall_s, processor_s = time.perf_counter() - wall, sum(os.times()[:4]) - processor
        assert finished
        with open_catalogue(Path(folder), writer=False) as catalogue:
            events = catalogue.rows(EventRow, topics={"service"})
            shots = catalogue.counts()["shots"]
        stored = FolderSetReader(Path(folder)).n_bytes()
    cost = next(row.payload["cost"] for row in reversed(events) if "cost" in row.payload)
    return {"wall_s": wall_s, "processor_s": processor_s, "shots": shots, "stored_bytes": stored, **cost}


def run_in_a_process(kind: str, hours: float) -> dict[str, Any]:
    """Run once in a new process, so that none inherits another's memory."""
    completed = subprocess.run(
        [sys.executable, __file__, "--hours", str(hours), "--one", kind],
        capture_output=True,
        text=True,
        check=True,
    )
    result: dict[str, Any] = json.loads(completed.stdout)
    return result


def run_command(hours: float, *, cold: bool) -> dict[str, Any]:
    """Run ``solimon demo`` like a user, from an empty folder, and if `cold` with empty caches."""
    with tempfile.TemporaryDirectory() as folder:
        caches = {name: str(Path(folder) / place) for name, place in CACHES.items()} if cold else {}
        started, before = time.perf_counter(), os.times()
        command = [sys.executable, "-m", "daq_service.cli", "demo", "--exit", "--no-web", "--json"]
        completed = subprocess.run(
            [*command, "--hours", str(hours), "--data-dir", str(Path(folder) / "data")],
            capture_output=True,
            text=True,
            check=True,
            env=os.environ | caches,
        )
        wall_s, after = time.perf_counter() - started, os.times()
    result = json.loads(completed.stdout)
    # Zero on Windows, which does not add up children.
    processor_s = sum(after[2:4]) - sum(before[2:4])
    return {"wall_s": wall_s, "processor_s": processor_s, "shots": result["shots"], **result["cost"]}


def measure(hours: float, rounds: int, *, cold: bool) -> dict[str, dict[str, float]]:
    """Alternate the three runs; return the mean of each number over the rounds."""
    runs: dict[str, list[dict[str, Any]]] = {kind: [] for kind in (COMMAND, *ONE_PROCESS)}
    for _ in range(rounds):
        runs[COMMAND].append(run_command(hours, cold=cold))
        for kind in ONE_PROCESS:
            runs[kind].append(run_in_a_process(kind, hours))
    return {
        kind: {name: mean(run[name] for run in several) for name in several[0]}
        for kind, several in runs.items()
    }


def show(found: dict[str, dict[str, float]]) -> None:
    """Print one column per run."""
    print(f"{'':24s}" + "".join(f"{kind:>14s}" for kind in found))
    for name in ("sets", "shots"):
        print(f"{name:24s}" + "".join(f"{run[name]:14.0f}" for run in found.values()))
    for name in ("wall_s", "processor_s", *STAGES):
        print(f"{name:24s}" + "".join(f"{run[name]:14.3f}" for run in found.values()))
    for kind, run in found.items():
        fsync_s = run["fsync_s"] + run["directory_fsync_s"]
        print(
            f"{kind}: {1e3 * run['wall_s'] / run['sets']:.1f} ms a set, of it fsync of file and folder "
            f"{1e3 * fsync_s / run['sets']:.2f} ms ({fsync_s / run['wall_s']:.1%})"
        )
    ours, obvious = found[RECORDER], found[OBVIOUS]
    print(
        f"obvious line over recorder: wall {obvious['wall_s'] / ours['wall_s']:.2f}, processor "
        f"{obvious['processor_s'] / ours['processor_s']:.2f}, bytes stored "
        f"{obvious['stored_bytes'] / ours['stored_bytes']:.3f}"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Cost of the demonstration by stage.")
    parser.add_argument("--hours", type=float, default=350.0)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--cold", action="store_true", help="empty caches for the command")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--one", choices=ONE_PROCESS, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.one:
        with compression_by_hdf5() if options.one == OBVIOUS else nullcontext():
            print(json.dumps(run_recorder(options.hours, options.one)))
    else:
        found = measure(options.hours, options.rounds, cold=options.cold)
        if options.json:
            print(json.dumps(found))
        else:
            show(found)


if __name__ == "__main__":
    main()
