"""Waterfall of a complete test from its tiles, next to vectorised numpy over its HDF5 files, in one run.

    python benchmarks/waterfall.py [--sets N] [--shots N] [--samples N] [--rows N] [--columns N] [--rounds R]

A folder is filled with N sets of noisy pulses at one position through the archive's own code, with tiles; a
lone sample is planted. Then the same picture, least and greatest of every cell, is drawn in two ways: from
tiles, and from every file with h5py and `reshape(...).min(axis=...)`. Rounds alternate, the least counts;
files come from the page cache. Both must give the same picture, the planted sample included, or this fails.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from daq_service.archive import FolderArchive, PositionRecord, SetRecord, SetReference
from daq_service.archive.finalize_set import finalize_set
from daq_service.archive.waterfall.image import Picture, Wanted, WaterfallReader
from daq_service.archive.waterfall.tile_files import build_tiles, write_tiles_of_file
from daq_service.archive.waterfall.tiles import Tiles, sum_tile_bytes
from hardware_drivers.measurement import Calibration, SetKey, Shot, ShotKey, Stamp, Waveform
from hardware_drivers.nanoseconds import NS_PER_H

POSITION, EXPERIMENT = "B", "benchmark"
CALIBRATION = Calibration(coefficients_v=np.array([0.0, 10.0 / 32768]), resolution_bits=16, range_v=10.0)
PLANTED = -30_000


def pulses_of_set(index: int, *, n_shots: int, n_samples: int, planted: bool) -> SetRecord:
    """Return pulses with noise, shot by shot."""
    rng = np.random.default_rng(index)
    time_s = np.arange(n_samples) / 10e6
    shots = []
    for k in range(n_shots):
        volts = 5.0 * np.exp(-(((time_s - 1.5e-4) / 3e-5) ** 2)) + 0.01 * rng.standard_normal(n_samples)
        counts = (volts / 10.0 * 32768).astype(np.int16)
        if planted and k == n_shots - 1:
            counts[n_samples // 2] = PLANTED
        waveform = Waveform(counts=counts, sample_rate_hz=10e6, pretrigger_samples=0, calibration=CALIBRATION)
        key = ShotKey(position=POSITION, set_index=index, shot_index=k)
        stamp = Stamp(utc_ns=index * NS_PER_H, mono_ns=k, boot_id="benchmark")
        shots.append(Shot(sequence=index * n_shots + k, key=key, stamp=stamp, waveform=waveform))
    return SetRecord(
        set_index=index,
        due_utc_ns=index * NS_PER_H,
        due_h=float(index),
        started_utc_ns=index * NS_PER_H,
        ended_utc_ns=index * NS_PER_H + 1,
        rig_kind="benchmark",
        positions=[PositionRecord(position=POSITION, method="solitary_wave", n_planned=n_shots)],
        shots=shots,
    )


class _Index:
    """Index in which every set is stored; only their number is used."""

    def __init__(self, files: dict[int, SetReference]) -> None:
        self._files = files

    def count_stored_sets(self, first: int, last: int) -> int:
        return max(0, min(last, len(self._files) - 1) - first + 1)

    def file(self, set_index: int) -> SetReference | None:
        return self._files.get(set_index)

    def read_anchors(self, set_index: int) -> dict[int, float]:
        return {}


def with_numpy(
    folder: Path, files: dict[int, SetReference], width: int, row_sets: int
) -> NDArray[np.float32]:
    """Return minimum and maximum of each cell from the files, shape (2, rows, columns)."""
    planes = []
    for reference in files.values():
        with h5py.File(folder / reference) as file:
            group = file[f"entry/{POSITION}_waveforms"]
            counts = group["waveform"][()]
            scale = group["waveform_scaling_factor"][()]
        n_columns = -(-counts.shape[1] // width)
        # The last cell is filled with its own last sample.
        cells = np.pad(counts, ((0, 0), (0, n_columns * width - counts.shape[1])), mode="edge")
        cells = cells.reshape(len(counts), n_columns, width)
        planes.append(np.stack([cells.min(axis=(0, 2)), cells.max(axis=(0, 2))]) * scale)
    whole = np.stack(planes, axis=1).astype(np.float32)
    starts = np.arange(0, whole.shape[1], row_sets)
    return np.stack(
        [np.minimum.reduceat(whole[0], starts, axis=0), np.maximum.reduceat(whole[1], starts, axis=0)]
    )


def from_tiles(tiles: Tiles, folder_reader: WaterfallReader, index: _Index, wanted: Wanted) -> Picture:
    """Draw it as the service does."""
    picture = folder_reader.compute_figure(tiles, index, wanted)
    if picture.pending:
        raise SystemExit("the tiles lack a set")
    return picture


def main() -> None:
    """Fill, draw, compare, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    for name, default in (
        ("sets", 425),
        ("shots", 10),
        ("samples", 13_600),
        ("rows", 512),
        ("columns", 1024),
    ):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "sets").mkdir()
        archive, files, kept_s = FolderArchive(folder), {}, 0.0
        for index in range(given.sets):
            record = pulses_of_set(
                index, n_shots=given.shots, n_samples=given.samples, planted=index == given.sets // 2
            )
            files[index] = archive.store_set(record).file
            finalize_set(folder, SetKey(index))
            archive.settle(SetKey(index))
            start = time.perf_counter()
            write_tiles_of_file(folder, EXPERIMENT, files[index], {})
            kept_s += time.perf_counter() - start
        tiles = build_tiles(folder, EXPERIMENT, archive.read_set(files[0]), POSITION, "trigger")
        assert tiles is not None
        wanted = Wanted(first=0, last=given.sets - 1, rows=given.rows, columns=given.columns)
        tiles_s, numpy_s = [], []
        for _ in range(given.rounds):
            start = time.perf_counter()
            picture = from_tiles(tiles, WaterfallReader(archive), _Index(files), wanted)
            tiles_s.append(time.perf_counter() - start)
            start = time.perf_counter()
            expected = with_numpy(folder, files, picture.frame.width, picture.row_sets)
            numpy_s.append(time.perf_counter() - start)
            drawn = np.stack([row.planes for row in picture.rows], axis=1)
            if not np.array_equal(drawn, expected):
                raise SystemExit("tiles and files give different pictures")
            if drawn.min() != np.float32(PLANTED * 10.0 / 32768):
                raise SystemExit("the planted sample is lost")
        found = {
            "sets": given.sets,
            "shots": given.sets * given.shots,
            "rows": len(picture.rows),
            "columns": picture.frame.n_cells,
            "tiles_s": min(tiles_s),
            "numpy_over_files_s": min(numpy_s),
            "ratio": min(numpy_s) / min(tiles_s),
            "keep_a_set_s": kept_s / given.sets,
            "tiles_mb": sum_tile_bytes(folder) / 1e6,
            "files_mb": sum((folder / file).stat().st_size for file in files.values()) / 1e6,
        }
    if given.json:
        print(json.dumps(found))
        return
    print(f"{found['sets']} sets, {found['shots']} shots: {found['rows']} x {found['columns']} cells")
    print(f"from tiles        {found['tiles_s']:8.3f} s")
    print(f"numpy over files  {found['numpy_over_files_s']:8.3f} s   ratio {found['ratio']:.0f}")
    print(f"tiles take {found['tiles_mb']:.0f} MB beside {found['files_mb']:.0f} MB of files;", end=" ")
    print(f"adding a set, both alignments: {1e3 * found['keep_a_set_s']:.0f} ms")


if __name__ == "__main__":
    sys.exit(main())
