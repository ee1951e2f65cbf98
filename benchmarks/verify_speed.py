"""`solimon verify` in MB per CPU second, next to other readings of the same files, in one run.

    python benchmarks/verify_speed.py [--folder F] [--hours H] [--rounds R] [--json]

Without a folder, so many hours of the demo are recorded first. Rounds alternate; CPU seconds of this process,
the least of the rounds counts; files come from the page cache. Beside verify stand the SHA-256 of every file,
which names a touched file but no shot and compares no row, and every array and attribute read with h5py,
which finds what HDF5's own checksums find. "Files" is verify without catalogue and journal: with the SHA-256
of each file known, and without, where each file is made again and compared.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import h5py

from daq_service.archive.verification import check_set_file
from daq_service.cli.maintenance.verify import verify_folder


def cpu_s(work: Callable[[], object]) -> float:
    """Return CPU seconds of this process."""
    start = time.process_time()
    work()
    return time.process_time() - start


def read_with_h5py(paths: list[Path]) -> None:
    """Read every array and attribute."""

    def read(_name: str, item: h5py.Group | h5py.Dataset) -> None:
        dict(item.attrs)
        if isinstance(item, h5py.Dataset):
            item[()]

    for path in paths:
        with h5py.File(path, "r") as file:
            file.visititems(read)


def measure(folder: Path, rounds: int) -> dict[str, float]:
    """Return the minimum CPU seconds of each way."""
    paths = sorted((folder / "sets").glob("*.h5"))
    known = {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}
    ways: dict[str, Callable[[], object]] = {
        "verify": lambda: verify_folder(folder),
        "files_with_sha256": lambda: [check_set_file(path, sha256=known[path]) for path in paths],
        "files_without": lambda: [check_set_file(path) for path in paths],
        "h5py_reads_all": lambda: read_with_h5py(paths),
        "sha256_of_all": lambda: [hashlib.sha256(path.read_bytes()).hexdigest() for path in paths],
    }
    assert verify_folder(folder).damage == [], "a damaged folder is no measure"
    found = [{name: cpu_s(work) for name, work in ways.items()} for _ in range(rounds)]
    return {name: min(one[name] for one in found) for name in ways}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--hours", type=float, default=10.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = arguments.folder
        if folder is None:
            folder = Path(place) / "data"
            command = [
                "demo",
                "--exit",
                "--no-web",
                "--hours",
                str(arguments.hours),
                "--data-dir",
                str(folder),
            ]
            subprocess.run(
                [sys.executable, "-m", "daq_service.cli", *command], check=True, capture_output=True
            )
        seconds = measure(folder, arguments.rounds)
        megabytes = sum(path.stat().st_size for path in (folder / "sets").glob("*.h5")) / 1e6
    rates = {name: megabytes / s for name, s in seconds.items()}
    ratios = {name: seconds["verify"] / seconds[name] for name in ("h5py_reads_all", "sha256_of_all")}
    if arguments.json:
        print(json.dumps({"megabytes": megabytes, "mb_per_cpu_s": rates, "verify_over": ratios}))
        return
    print(f"{megabytes:.1f} MB of sets")
    for name, rate in rates.items():
        print(f"{name:<18} {rate:8.1f} MB per CPU second")
    for name, ratio in ratios.items():
        print(f"verify costs {ratio:.2f} times {name}")


if __name__ == "__main__":
    main()
