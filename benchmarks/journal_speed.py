"""The journal beside a raw write and fdatasync of the same counts, in one run.

    python benchmarks/journal_speed.py [--folder F] [--rounds R] [--json]

A record of a shot is 13,600 samples of int16. Both write into files that are allocated beforehand. Rounds
alternate; the ratio is raw seconds over journal seconds: 1 means that frames, facts and checksums are free.
Then 10,000 frames are left behind as by a crash, and read again as a start reads them.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

from daq_service.archive.journal import writer
from daq_service.archive.journal.writer import Journal
from hardware_drivers.measurement import Calibration, Shot, ShotKey, Stamp, Waveform

SAMPLES = 13_600
GROUPS = (1, 31, 256)
"""Shots a sync: one as in real time, a set of the paper's test, several sets."""
FRAMES = 10_000
SETTINGS = {"board_serial": "01E16086", "trigger_level_v": 0.25, "driver_version": "24.8.0"}


def shots(count: int, first: int) -> list[Shot]:
    """Make records with counts of their own, so that no checksum is remembered."""
    noise = np.random.default_rng(first).integers(-3000, 3000, SAMPLES + count).astype(np.int16)
    calibration = Calibration(coefficients_v=np.array([0.0, 3e-4]), resolution_bits=16, range_v=10.0)
    return [
        Shot(
            sequence=first + number,
            key=ShotKey(position="B", set_index=(first + number) // 31, shot_index=number % 10),
            stamp=Stamp(utc_ns=number, mono_ns=number, boot_id="5d1f"),
            waveform=Waveform(
                counts=noise[number : number + SAMPLES],
                sample_rate_hz=1e7,
                pretrigger_samples=1000,
                calibration=calibration,
            ),
            truth={"depth_fraction": 0.1, "drop_height_m": 5e-3},
            settings=SETTINGS,
        )
        for number in range(count)
    ]


def raw_s(folder: Path, group: list[Shot]) -> float:
    """Seconds of a plain write and fdatasync."""
    path = folder / "raw"
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT, 0o644)
    try:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(descriptor, 0, writer.SEGMENT_BYTES)
        os.fsync(descriptor)
        start = time.perf_counter()
        for shot in group:
            os.write(descriptor, shot.waveform.counts.data)
        writer.synchronise(descriptor)
        return time.perf_counter() - start
    finally:
        os.close(descriptor)
        path.unlink()


def journal_s(journal: Journal, group: list[Shot]) -> float:
    """Seconds of the same through the journal, from record to acknowledgement."""
    start = time.perf_counter()
    for shot in group:
        journal.append(shot)
    assert len(journal.sync()) == len(group)
    return time.perf_counter() - start


def main() -> None:
    """Print microseconds a shot, ratios, and the seconds of a start."""
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("--folder", type=Path, help="On the disk that is meant; default: a temporary one.")
    arguments.add_argument("--rounds", type=int, default=30)
    arguments.add_argument("--json", action="store_true")
    options = arguments.parse_args()
    told: dict[str, float] = {}
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        folder = Path(name)
        (folder / "journal").mkdir()
        first = 0
        for size in GROUPS:
            raw, ours = [], []
            with closing(Journal(folder)) as journal:
                journal_s(journal, shots(1, first))  # opens the segment
                first += 1
                for _ in range(options.rounds):
                    group = shots(size, first)
                    first += size
                    raw.append(raw_s(folder, group))
                    ours.append(journal_s(journal, [replace(shot) for shot in group]))
            told[f"raw_us_{size}"] = 1e6 * median(raw) / size
            told[f"journal_us_{size}"] = 1e6 * median(ours) / size
            told[f"ratio_{size}"] = median(raw) / median(ours)
        for path in (folder / "journal").iterdir():
            path.unlink()
        with closing(Journal(folder)) as journal:
            for start in range(0, FRAMES, 250):
                journal_s(journal, shots(250, first + start))
        start_s = time.perf_counter()
        left = Journal(folder).left
        told["restart_s"] = time.perf_counter() - start_s
        assert sum(len(item.shots) for item in left.values()) == FRAMES
    if options.json:
        print(json.dumps(told))
        return
    for size in GROUPS:
        print(
            f"{size:4d} shots a sync: raw {told[f'raw_us_{size}']:7.0f} us a shot, journal "
            f"{told[f'journal_us_{size}']:7.0f} us, ratio {told[f'ratio_{size}']:.2f}"
        )
    print(f"{FRAMES} frames left by a crash are read in {told['restart_s']:.2f} s")


if __name__ == "__main__":
    main()
