"""Journal next to a raw write and fdatasync of the same counts, in one run.

    python benchmarks/journal_speed.py [--folder F] [--rounds R] [--json]

A record of a shot is 13,600 samples of int16. Both write into files that are allocated at once, 16 MiB at a
time, and pay for it. Who is first in a round alternates; the ratio is the median over rounds of raw seconds
over journal seconds (a disk has slow moments): 1 means that frames, facts and checksums are free.
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
from daq_service.shared_file import sync_folder
from hardware_drivers.measurement import Calibration, Shot, ShotKey, Stamp, Waveform

SAMPLES = 13_600
GROUPS = (1, 31, 256)
"""Shots a sync: one as in real time, a set of the paper's test, several sets."""
FRAMES = 10_000
SETTINGS: dict[str, float | str] = {
    "board_serial": "01E16086",
    "trigger_level_v": 0.25,
    "driver_version": "24.8.0",
}


def shots(count: int, first: int) -> list[Shot]:
    """Return records with counts of their own, so that no checksum is cached."""
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


class RawSegments:
    """Plain writes with fdatasync into files allocated like the journal's, and as large."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._descriptor, self._room, self._number = folder, -1, 0, 0

    def write_s(self, group: list[Shot]) -> float:
        """Return seconds until the counts of a group are durable; a full file is replaced by a new one."""
        start = time.perf_counter()
        n_bytes = sum(shot.waveform.counts.nbytes for shot in group)
        if self._room < n_bytes:
            self.close()
            self._number += 1
            self._descriptor = os.open(self._folder / f"raw.{self._number}", os.O_WRONLY | os.O_CREAT, 0o644)
            self._room = max(writer.SEGMENT_BYTES, n_bytes)
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(self._descriptor, 0, self._room)
            sync_folder(self._folder)
        for shot in group:
            os.write(self._descriptor, shot.waveform.counts.data)
        writer.synchronise(self._descriptor)
        self._room -= n_bytes
        return time.perf_counter() - start

    def close(self) -> None:
        """Close the present file."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def journal_s(journal: Journal, group: list[Shot]) -> float:
    """Return seconds of the same through the journal, from record to acknowledgement."""
    start = time.perf_counter()
    for shot in group:
        journal.append(shot)
    assert len(journal.sync()) == len(group)
    return time.perf_counter() - start


def main() -> None:
    """Print microseconds per shot, ratios, and the seconds of a start."""
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("--folder", type=Path, help="On the disk that is meant; default: a temporary one.")
    arguments.add_argument("--rounds", type=int, default=30)
    arguments.add_argument("--json", action="store_true")
    options = arguments.parse_args()
    results: dict[str, float] = {}
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        folder = Path(name)
        (folder / "journal").mkdir()
        plain = folder / "plain"
        plain.mkdir()
        first = 0
        for size in GROUPS:
            raw, ours = [], []
            with closing(Journal(folder)) as journal, closing(RawSegments(plain)) as segments:
                first_ones = shots(1, first)  # open the segments
                journal_s(journal, first_ones)
                segments.write_s(first_ones)
                first += 1
                for number in range(options.rounds):
                    group = shots(size, first)
                    first += size
                    if number % 2:
                        raw.append(segments.write_s(group))
                    ours.append(journal_s(journal, [replace(shot) for shot in group]))
                    if not number % 2:
                        raw.append(segments.write_s(group))
            results[f"raw_us_{size}"] = 1e6 * median(raw) / size
            results[f"journal_us_{size}"] = 1e6 * median(ours) / size
            results[f"ratio_{size}"] = median(left / right for left, right in zip(raw, ours, strict=True))
        for path in (folder / "journal").iterdir():
            path.unlink()
        with closing(Journal(folder)) as journal:
            for start in range(0, FRAMES, 250):
                journal_s(journal, shots(250, first + start))
        start_s = time.perf_counter()
        left = Journal(folder).left
        results["restart_s"] = time.perf_counter() - start_s
        assert sum(len(item.shots) for item in left.values()) == FRAMES
    if options.json:
        print(json.dumps(results))
        return
    for size in GROUPS:
        print(
            f"{size:4d} shots a sync: raw {results[f'raw_us_{size}']:7.0f} us a shot, journal "
            f"{results[f'journal_us_{size}']:7.0f} us, ratio {results[f'ratio_{size}']:.2f}"
        )
    print(f"{FRAMES} frames left by a crash are read in {results['restart_s']:.2f} s")


if __name__ == "__main__":
    main()
