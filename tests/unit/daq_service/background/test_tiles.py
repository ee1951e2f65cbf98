"""Tiles are written in the background: an error is logged and costs neither set nor test."""

import logging
import shutil
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from support.archived_sets import SET_INDEX, make_set, other_set
from support.damaging import flip
from support.machine import clock_in_seconds
from support.small_experiment import AtOnce
from support.stored_files import read_set, set_files
from support.table_rows import lose_catalogue, table_rows

from daq_service.archive import FolderArchive
from daq_service.archive.waterfall.cells import compute_planes, extract_anchors
from daq_service.archive.waterfall.tile_files import build_tiles
from daq_service.archive.waterfall.tiles import TILES_FOLDER
from daq_service.assessment.results_in_file import read_set_results
from daq_service.background.finalize_sets import SetFinalizer
from daq_service.background.tiles import EVERY_S, SETS_A_TURN, TileMaker, add_record_to_tiles
from daq_service.background.verification import QUIET_S
from daq_service.catalogue import open_catalogue
from daq_service.catalogue.owner import build_experiment_identity
from daq_service.recording.reassessment.rebuild import rebuild_folder_catalogue
from hardware_drivers.measurement import SetKey

N_SETS = 6
RESULTS = {"features": {"shot_id": [41], "isw_time_s": [2.5e-6]}}


class Line:
    """Folder with some sets, and the task that adds them to tiles, on its own clock."""

    def __init__(self, folder):
        self.folder, self.now_s, self.room, self.read = folder, 0.0, True, []
        self.archive = FolderArchive(folder)
        self.records = {index: other_set(make_set(), index) for index in range(SET_INDEX, SET_INDEX + N_SETS)}
        self.files = {
            SetKey(index): self.archive.store_set(record).file for index, record in self.records.items()
        }
        self.finalizer = SetFinalizer(
            folder, self.archive, start=AtOnce, results=lambda set_index: RESULTS, also=self.tile
        )
        self.tiling = TileMaker(
            folder,
            "ab/1",
            self.finalizer,
            lambda: self.files,
            lambda set_index: self.read.append(set_index) or RESULTS,
            has_room=lambda: self.room,
            machine=clock_in_seconds(lambda: self.now_s),
        )

    def tile(self, set_index, results):
        return (
            partial(add_record_to_tiles, self.folder, "ab/1", extract_anchors(results)) if self.room else None
        )

    def file(self, *, room=True):
        """Write the files of all sets; without free space they get no tiles."""
        self.room = room
        for set_key in self.files:
            self.finalizer.after_set(set_key)
            self.finalizer.run_for(0.0)
        self.room = True
        assert len(list((self.folder / "sets").iterdir())) == N_SETS

    def tiles(self, position="B", alignment="trigger"):
        return build_tiles(self.folder, "ab/1", self.records[SET_INDEX], position, alignment)

    def kept(self):
        return [key for key in self.files if self.tiles().has_set(key.set_index)]

    def work(self, free_s=0.0):
        """Run the task once and collect its result."""
        self.tiling.run_for(free_s)
        self.tiling.run_for(0.0)


@pytest.fixture
def line(tmp_path):
    line = Line(tmp_path)
    yield line
    line.finalizer.close()
    line.archive.close()


def test_a_set_with_a_file_gets_tiles_without_free_time(line):
    """The coarser rows of incomplete blocks follow in free time; until then readers join finer ones."""
    line.file()
    assert all(line.tiles().row(1, index) for index in line.records)
    assert [line.tiles().row(4, 2).n_sets, line.tiles().row(16, 0)] == [4, None]
    assert line.kept() == []
    line.work(free_s=QUIET_S + 1)
    assert line.kept() == list(line.files)
    for position, alignment in (("A", "trigger"), ("B", "first"), ("C", "trigger")):
        tiles = line.tiles(position, alignment)
        record = line.records[SET_INDEX]
        expected = compute_planes(record, position, alignment, extract_anchors(RESULTS), tiles.frame)
        np.testing.assert_array_equal(tiles.row(1, SET_INDEX).planes, expected)


def test_in_idle_time_older_sets_get_tiles_newest_first(line):
    line.file(room=False)
    line.work(free_s=QUIET_S)
    assert line.kept() == [], "a set is due soon"
    line.work(free_s=QUIET_S + 1)
    assert line.kept() == list(line.files)[-SETS_A_TURN:]
    line.work(free_s=QUIET_S + 1)
    assert len(line.kept()) == SETS_A_TURN, "not so soon again"
    line.now_s += EVERY_S
    line.work(free_s=QUIET_S + 1)
    assert line.kept() == list(line.files)


def test_no_tile_is_made_while_set_files_are_pending(line):
    line.finalizer.after_set(SetKey(SET_INDEX))
    assert line.finalizer.waits
    line.read.clear()
    line.work(free_s=QUIET_S + 1)
    assert line.read == []


def test_a_corrupt_tile_is_made_again_in_the_next_round(line):
    line.file()
    (path,) = (line.folder / TILES_FOLDER / "B" / "trigger").glob("0001-*.tile")
    flip(path, -9)
    newest = list(line.records)[-1]
    assert line.tiles().row(1, newest) is None
    for _ in range(2):
        line.work(free_s=QUIET_S + 1)
        line.now_s += EVERY_S
    assert line.tiles().row(1, newest) is not None
    assert line.kept() == list(line.files)


def test_a_folder_that_cannot_hold_tiles_is_logged_once_and_stops_no_set(line, caplog):
    (line.folder / TILES_FOLDER).write_bytes(b"no folder")
    with caplog.at_level(logging.WARNING):
        line.file()
        for _ in line.files:
            line.work(free_s=QUIET_S + 1)
            line.now_s += EVERY_S
    warnings = [record.message for record in caplog.records if "tiles of the waterfall" in record.message]
    assert len(warnings) == 2, "once by the making of files, once by the rounds"
    assert line.finalizer.trouble == ""


def test_a_full_volume_gets_no_tiles(line):
    line.file(room=False)
    line.room = False
    line.work(free_s=QUIET_S + 1)
    assert not (line.folder / TILES_FOLDER).exists()


def test_an_unscheduled_set_gets_no_tiles(line):
    record = other_set(make_set(), SET_INDEX, 1)
    assert add_record_to_tiles(line.folder, "ab/1", {}, record) == ""
    assert not (line.folder / TILES_FOLDER).exists()


@pytest.fixture
def copy_of_older_version(life, tmp_path):
    """Return a copy of a folder of an earlier version, without tiles."""
    folder = tmp_path / "copy"
    shutil.copytree(life.folder, folder)
    shutil.rmtree(folder / TILES_FOLDER, ignore_errors=True)
    return replace(life, folder=folder)


def test_rebuild_makes_the_tiles_of_an_older_folder(copy_of_older_version):
    before = table_rows(copy_of_older_version.folder)
    lose_catalogue(copy_of_older_version.folder)
    assert (
        rebuild_folder_catalogue(
            copy_of_older_version.folder, features_of=copy_of_older_version.features_of
        ).warnings
        == []
    )
    assert table_rows(copy_of_older_version.folder) == before
    with open_catalogue(copy_of_older_version.folder) as catalogue:
        name = build_experiment_identity(catalogue.read_experiment())
        for path in set_files(copy_of_older_version.folder).values():
            record = read_set(path)
            anchors = extract_anchors(read_set_results(catalogue, record.set_key))
            for place in {taken.key.position for taken in record.records}:
                tiles = build_tiles(copy_of_older_version.folder, name, record, place, "first")
                expected = compute_planes(record, place, "first", anchors, tiles.frame)
                np.testing.assert_array_equal(tiles.row(1, record.set_index).planes, expected)


def test_rebuild_continues_if_old_tiles_cannot_be_removed(copy_of_older_version):
    (copy_of_older_version.folder / TILES_FOLDER).write_bytes(b"no folder")
    lose_catalogue(copy_of_older_version.folder)
    (warning,) = rebuild_folder_catalogue(
        copy_of_older_version.folder, features_of=copy_of_older_version.features_of
    ).warnings
    assert "not in the waterfall's tiles: the old tiles stay" in warning
