"""Seconds from ``solimon demo`` to its first line, the dashboard's address and the first row, cold and warm.

    python benchmarks/first_minute.py [--rounds R] [--json]

Each round starts ``solimon demo`` twice, as a user does, and stops it by Ctrl-C at the first row. Cold:
machine code and reduced plates are made again, in an empty cache folder. Warm: they are read from it.
Processor time is that of all processes (none on Windows) and is hardly disturbed by other programs; wall
time needs two idle cores.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median

CACHES = {"NUMBA_CACHE_DIR": "machine-code", "XDG_CACHE_HOME": "reductions", "LOCALAPPDATA": "reductions"}
"""Where machine code and reduced plates are kept (`numerics.array_cache`), and a folder for each."""
MOMENTS = {"first_line": rb"\S", "address": rb"http://\S+/", "first_row": rb"\d+ of \d+ sets"}
"""The text that marks each moment."""


def run_demo(caches: Path) -> dict[str, float]:
    """Run the demo until its first row; return the wall seconds of each moment and the processor seconds."""
    with tempfile.TemporaryDirectory() as folder:
        before, started = os.times(), time.perf_counter()
        command = [sys.executable, "-P", "-m", "daq_service.cli", "demo", "--port", "0", "--no-browser"]
        found: dict[str, float] = {}
        with subprocess.Popen(
            [*command, "--data-dir", str(Path(folder) / "data")],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=os.environ
            | {"PYTHONUNBUFFERED": "1"}
            | {name: str(caches / at) for name, at in CACHES.items()},
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        ) as demo:
            assert demo.stdout is not None
            written = b""
            while len(found) < len(MOMENTS):
                line = demo.stdout.readline()
                if not line:
                    raise RuntimeError(f"the demo ended early: {written.decode(errors='replace')}")
                written += line
                for moment, pattern in MOMENTS.items():
                    if moment not in found and re.search(pattern, line):
                        found[moment] = time.perf_counter() - started
            demo.send_signal(getattr(signal, "CTRL_BREAK_EVENT", signal.SIGINT))
            demo.communicate()
        after = os.times()
    return found | {"processor": sum(after[2:4]) - sum(before[2:4])}


def measure(rounds: int) -> dict[str, dict[str, float]]:
    """Run cold and warm alternately; return the median of each number over the rounds."""
    runs: dict[str, list[dict[str, float]]] = {"cold": [], "warm": []}
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as caches:
            for several in runs.values():
                several.append(run_demo(Path(caches)))
    return {
        kind: {name: median(run[name] for run in several) for name in several[0]}
        for kind, several in runs.items()
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Print seconds, one column per kind of start."""
    parser = argparse.ArgumentParser(description="Seconds of the demonstration to its first row.")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    found = measure(options.rounds)
    if options.json:
        print(json.dumps(found))
        return
    print(f"{'seconds':14s}" + "".join(f"{kind:>8s}" for kind in found))
    for name in (*MOMENTS, "processor"):
        print(f"{name:14s}" + "".join(f"{run[name]:8.2f}" for run in found.values()))


if __name__ == "__main__":
    main()
