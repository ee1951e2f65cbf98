"""Waterfall figures from tiles equal those from the records, even if tiles are missing, torn or foreign."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.archived_sets import make_set, make_shot, other_set
from support.damaging import flip
from support.memory_archive import MemoryArchive

from daq_service.archive import PositionRecord
from daq_service.archive.waterfall.cells import build_frame, compute_record_planes, extract_anchors
from daq_service.archive.waterfall.image import SETS_AT_ONCE, Wanted, WaterfallReader
from daq_service.archive.waterfall.tile_files import build_tiles, write_tiles_of_set
from daq_service.archive.waterfall.tiles import TILES_FOLDER, WIDTHS, sum_tile_bytes

N_SETS = 70
MISSED = {5, 6, 7, 40}
SPIKED = 37
EXPERIMENT = "ab/1"


def noise_set(index: int, n_samples: int = 300):
    """Return two records of noise at B whose first pulses differ by a fraction of a sample."""
    shots = [make_shot("B", k, 10_000 + 2 * index + k, n_samples=n_samples) for k in range(2)]
    record = replace(
        make_set(),
        shots=shots,
        echoes=(),
        missed=(),
        outcomes={},
        positions=[PositionRecord(position="B", method="solitary_wave", n_planned=2)],
    )
    record = other_set(replace(record, due_h=float(index)), index)
    anchors = {shot.sequence: 1e-6 + 0.13e-7 * (index % 17) + 3e-7 * k for k, shot in enumerate(record.shots)}
    if index != SPIKED:
        return record, anchors
    counts = record.shots[1].waveform.counts.copy()
    counts[222] = 31_000
    spiked = replace(record.shots[1], waveform=replace(record.shots[1].waveform, counts=counts))
    return replace(record, shots=[record.shots[0], spiked]), anchors


class Stored:
    """Sets in memory as the index and source of a figure; counts the reads."""

    def __init__(self, n_sets: int = N_SETS, n_samples: int = 300) -> None:
        self.archive = MemoryArchive()
        taken = {index: noise_set(index, n_samples) for index in range(n_sets) if index not in MISSED}
        self.files = {index: self.archive.store_set(record).file for index, (record, _) in taken.items()}
        self.records = {index: record for index, (record, _) in taken.items()}
        self._anchors = {index: anchors for index, (_, anchors) in taken.items()}
        self.n_read = 0

    def count_stored_sets(self, first, last):
        return sum(first <= index <= last for index in self.files)

    def file(self, set_index):
        return self.files.get(set_index)

    def read_anchors(self, set_index):
        return self._anchors[set_index]

    def read_set(self, reference, *, skip_damaged=False):
        self.n_read += 1
        return self.archive.read_set(reference, skip_damaged=skip_damaged)

    def keep(self, folder, indices=None, experiment=EXPERIMENT):
        for index in self.files if indices is None else indices:
            write_tiles_of_set(folder, experiment, self.records[index], self._anchors[index])

    def expected(self, tiles, frame, first, last, row_sets=1):
        """Return the rows computed from the records with the cells of the frame."""
        rows = {}
        for index in range(first // row_sets * row_sets, (last // row_sets + 1) * row_sets):
            for shot in self.records[index].shots if index in self.files else ():
                anchor = 0.0 if tiles.alignment == "trigger" else self._anchors[index][shot.sequence]
                # In cells of one sample, whose extremes are taken afterwards.
                finest = tiles.frame.part(None, None, 1)
                row = compute_record_planes([(shot.waveform, anchor)], finest)
                rows.setdefault(index // row_sets, []).append(coarsest(row, finest, frame))
        return [
            np.stack([np.fmin.reduce([r[0] for r in its]), np.fmax.reduce([r[1] for r in its])])
            for _, its in sorted(rows.items())
        ]


def coarsest(row, finest, frame):
    planes = np.full((2, frame.n_cells), np.nan, dtype=np.float32)
    at = (np.arange(finest.n_cells) + finest.first) // frame.width - frame.first
    inside = (at >= 0) & (at < frame.n_cells)
    np.fmin.at(planes[0], at[inside], row[0, inside])
    np.fmax.at(planes[1], at[inside], row[1, inside])
    return planes


@pytest.fixture(scope="module")
def stored():
    return Stored()


@pytest.fixture(scope="module")
def kept(stored, tmp_path_factory):
    """Return a folder with the tiles of all sets."""
    folder = tmp_path_factory.mktemp("kept")
    stored.keep(folder)
    return folder


@pytest.fixture
def copied(kept, tmp_path):
    shutil.copytree(kept, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.fixture
def tiles(tmp_path, stored):
    def tiles_at(alignment):
        return build_tiles(tmp_path, EXPERIMENT, stored.records[0], "B", alignment)

    return tiles_at


def draw(stored, tiles, wanted, reader=None):
    """Request the figure until everything was read."""
    reader = reader or WaterfallReader(stored)
    for _ in range(N_SETS):
        picture = reader.compute_figure(tiles, stored, wanted)
        if picture.pending == 0:
            return picture
    raise AssertionError("a picture that never gets ready")


ALL = Wanted(first=0, last=N_SETS - 1, rows=100, columns=1000)
WANTED = {
    "all": ALL,
    "few rows": replace(ALL, rows=9),
    "one row": replace(ALL, rows=1),
    "few columns": replace(ALL, columns=37),
    "a corner": Wanted(first=33, last=60, rows=7, columns=11, from_s=2e-6, to_s=9e-6),
    "one set": Wanted(first=37, last=37, rows=1, columns=1000),
    "missed sets": Wanted(first=4, last=8, rows=10, columns=10),
}


@pytest.mark.parametrize("wanted", WANTED.values(), ids=WANTED)
@pytest.mark.parametrize("alignment", ["trigger", "first"])
def test_tiles_give_the_same_figure_as_the_records(copied, stored, tiles, alignment, wanted):
    its = tiles(alignment)
    picture = draw(stored, its, wanted)
    expected = stored.expected(its, picture.frame, wanted.first, wanted.last, picture.row_sets)
    assert len(picture.rows) == len(expected) <= wanted.rows
    assert picture.frame.n_cells <= wanted.columns
    for row, planes in zip(picture.rows, expected, strict=True):
        np.testing.assert_array_equal(row.planes, planes)


def test_few_sets_show_samples_finer_than_the_tiles(tmp_path):
    its = Stored(n_sets=2, n_samples=1300)
    its.keep(tmp_path)
    tiles = build_tiles(tmp_path, EXPERIMENT, its.records[0], "B", "trigger")
    assert tiles.frame.width == 2
    wanted = Wanted(first=0, last=1, rows=10, columns=50, from_s=1e-6, to_s=4e-6)
    picture = draw(its, tiles, wanted)
    assert (picture.frame.width, picture.frame.n_cells, its.n_read) == (1, 30, 2)
    volts = [shot.waveform.volts()[110:140].astype(np.float32) for shot in its.records[0].shots]
    np.testing.assert_array_equal(picture.rows[0].planes, [np.min(volts, axis=0), np.max(volts, axis=0)])


def test_a_figure_from_complete_tiles_reads_no_record(copied, stored, tiles):
    before = stored.n_read
    for rows in (1, 4, 30, 100):
        draw(stored, tiles("trigger"), replace(ALL, rows=rows))
    assert stored.n_read == before


def corrupt_tile(path):
    """Flip a bit of a sample of the third row if it exists; in a NaN the flip would have no effect."""
    n_cells = build_frame(make_shot("B", 0, 1).waveform, "first").n_cells
    flip(path, 512 + 2 * (64 + 8 * n_cells) + 64 + 4 * (n_cells // 2) + 2, 0x40)


FAULTS = {
    "deleted": lambda path: path.unlink(),
    "a flipped bit": corrupt_tile,
    "torn": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "empty": lambda path: path.write_bytes(b""),
    "zeros": lambda path: path.write_bytes(bytes(path.stat().st_size)),
    "something else": lambda path: path.write_bytes(b"{}" * 5000),
    "a folder": lambda path: (path.unlink(), path.mkdir()),
}


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS)
@pytest.mark.parametrize("level", [0, 1, 2])
def test_a_corrupt_tile_is_not_shown_and_is_made_again(copied, stored, tiles, level, fault):
    wanted = replace(ALL, rows=100 // 4**level)
    sound = draw(stored, tiles("first"), wanted)
    path = copied / TILES_FOLDER / "B" / "first" / f"{4**level:04d}-000000.tile"
    fault(path)
    found = draw(stored, tiles("first"), wanted)
    for row, its in zip(found.rows, sound.rows, strict=True):
        np.testing.assert_array_equal(row.planes, its.planes)
    if path.is_dir():
        with pytest.raises(OSError, match=r"directory|denied"):
            stored.keep(copied)
        return
    stored.keep(copied)
    before = stored.n_read
    draw(stored, tiles("first"), wanted)
    assert stored.n_read == before, "the tiles are whole again"


def test_tiles_of_another_experiment_are_ignored_and_replaced(tmp_path, stored, tiles):
    foreign = Stored()
    foreign.records = {index: other_set(foreign.records[0], index) for index in foreign.files}
    foreign.keep(tmp_path, experiment="cd/1", indices=[0])
    assert tiles("trigger").row(1, 0) is None
    stored.keep(tmp_path, indices=[0])
    row = tiles("trigger").row(1, 0)
    expected = stored.expected(tiles("trigger"), tiles("trigger").frame, 0, 0)
    np.testing.assert_array_equal(row.planes, expected[0])


def test_a_row_that_lacks_a_set_is_skipped(tmp_path, stored, tiles):
    """The disk rejected the tile of one set: rows above it lack a set, so its records are read."""
    stored.keep(tmp_path, indices=[index for index in stored.files if index != SPIKED])
    before = stored.n_read
    picture = draw(stored, tiles("trigger"), replace(ALL, rows=3))
    spike = stored.records[SPIKED].shots[1].waveform.volts()[222]
    assert max(picture.peaks) == np.float32(spike)
    assert stored.n_read == before + 1
    stored.keep(tmp_path)
    picture = draw(stored, tiles("trigger"), replace(ALL, rows=3))
    assert (max(picture.peaks), stored.n_read) == (np.float32(spike), before + 1)


def test_existing_folders_are_not_created_again(copied, stored, monkeypatch):
    """A disk that rejects new folders costs no tile in the existing ones."""
    tile = copied / TILES_FOLDER / "B" / "first" / "0001-000000.tile"
    whole = tile.read_bytes()
    tile.unlink()

    def refused(path, *args, **kwargs):
        raise PermissionError(13, "refused", str(path))

    monkeypatch.setattr(Path, "mkdir", refused)
    stored.keep(copied)
    assert tile.read_bytes() == whole


def test_the_tiles_do_not_depend_on_the_order_of_the_sets(kept, tmp_path, stored):
    stored.keep(tmp_path, indices=sorted(stored.files, key=lambda index: (index * 37) % N_SETS))
    paths = list(kept.rglob("*.tile"))
    assert len(paths) == 2 * (len(WIDTHS) + 1), "two at the finest level, each alignment"
    for path in paths:
        assert (tmp_path / path.relative_to(kept)).read_bytes() == path.read_bytes()
    assert sum_tile_bytes(tmp_path) == sum_tile_bytes(kept) > 0


def test_without_tiles_a_figure_is_made_from_records_in_bounded_steps(stored, tiles):
    reader, before = WaterfallReader(stored), stored.n_read
    first = reader.compute_figure(tiles("trigger"), stored, ALL)
    assert stored.n_read == before + SETS_AT_ONCE
    assert (len(first.rows), first.pending) == (SETS_AT_ONCE, len(stored.files) - SETS_AT_ONCE)
    whole = draw(stored, tiles("trigger"), ALL, reader)
    assert [row.first_set for row in whole.rows] == list(stored.files)
    assert stored.n_read == before + len(stored.files), "what was read once is remembered"


def test_missing_records_are_named(stored, tiles):
    its = Stored()
    its.files[3] = its.files[3].replace("set_", "gone_")
    picture = WaterfallReader(its).compute_figure(tiles("trigger"), its, replace(ALL, first=2, last=4))
    assert ([row.first_set for row in picture.rows], picture.unreadable) == ([2, 4], [3])


def test_a_set_without_a_pulse_has_an_empty_row_and_does_not_spoil_those_above(tmp_path, stored, tiles):
    stored.keep(tmp_path, indices=[0, 1, 2])
    write_tiles_of_set(tmp_path, EXPERIMENT, stored.records[3], extract_anchors({}))
    aligned = tiles("first")
    assert np.isnan(aligned.row(1, 3).planes).all()
    assert aligned.row(4, 0).n_sets == 4
    assert np.isfinite(aligned.row(4, 0).planes).any()


def test_the_mean_over_the_baseline_is_that_of_its_extremes(tmp_path, stored, tiles):
    stored.keep(tmp_path, indices=[0, 1])
    reader, its = WaterfallReader(stored), tiles("first")
    mean, n_sets, n_pending = reader.mean(its, stored, [0, 1, 2])
    rows = stored.expected(its, its.frame, 0, 2)
    cell = 200 - its.frame.first  # well inside every record
    by_hand = np.mean([row[:, cell].astype(np.float64) for row in rows], axis=0)
    np.testing.assert_array_equal(mean[:, cell], by_hand.astype(np.float32))
    assert (n_sets, n_pending) == (3, 0)
    wanted = replace(ALL, last=2, columns=40)
    less = reader.compute_figure(its, stored, wanted, mean)
    by_hand = [coarsest(row - mean, its.frame, less.frame) for row in rows]
    for row, planes in zip(less.rows, by_hand, strict=True):
        np.testing.assert_array_equal(row.planes, planes)


def test_frames_of_both_kinds_are_of_one_width():
    waveform = make_shot("B", 0, 1).waveform
    assert build_frame(waveform, "trigger").width == build_frame(waveform, "first").width == 1
