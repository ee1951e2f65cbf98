"""Levels of a volume that fills and is freed, the reserve, and the forecast of the free space."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import pytest
from support.filled_folder import FilledFolder
from support.machine import clock_in_seconds

from daq_service.archive import SetReference
from daq_service.archive.waterfall.tile_files import write_tiles_of_file
from daq_service.archive.waterfall.tiles import estimate_tile_bytes, list_tile_cells, sum_tile_bytes
from daq_service.background.disk_watch import DiskWatch
from daq_service.cli.run import report_full_disk
from daq_service.processes import disk_policy
from daq_service.processes.disk_policy import RESERVE_FILE, disk_space, forecast_disk
from daq_service.settings.tree import Settings, StorageSettings

GB = 10**9


def level(free_gb, total_gb=100.0, before="ample", **settings):
    usage = lambda folder: (round(free_gb * GB), round(total_gb * GB))  # noqa: E731
    return disk_space(None, StorageSettings(**settings), before=before, usage=usage).level


@pytest.mark.parametrize(
    ("free_gb", "expected"),
    [(20.0, "ample"), (19.9, "warn"), (10.0, "warn"), (9.9, "alarm"), (5.0, "alarm"), (4.9, "stop")],
)
def test_a_level_starts_at_its_fraction_of_the_volume(free_gb, expected):
    assert level(free_gb) == expected


@pytest.mark.parametrize(
    ("before", "stays_gb", "leaves_gb", "for_level"),
    [("stop", 5.4, 5.6, "alarm"), ("alarm", 10.9, 11.1, "warn"), ("warn", 21.9, 22.1, "ample")],
)
def test_a_level_ends_a_tenth_above_its_limit(before, stays_gb, leaves_gb, for_level):
    assert level(stays_gb, before=before) == before
    assert level(leaves_gb, before=before) == for_level
    assert level(50.0, before=before) == "ample"


def test_a_large_volume_has_the_limits_of_a_smaller_one():
    assert [level(free, 10_000.0) for free in (201, 199, 49)] == ["ample", "warn", "stop"]
    assert level(199, 10_000.0, volume_gb=100.0) == "ample"


def test_limits_that_contradict_each_other_are_refused():
    with pytest.raises(ValueError, match=r"stop_free_fraction is 0\.2, alarm_free_fraction 0\.1"):
        StorageSettings(stop_free_fraction=0.2)


class Volume:
    """Volume with given free bytes and a manual clock."""

    def __init__(self):
        self.free, self.now_s = 50 * GB, 0.0

    def __call__(self, folder):
        return self.free, 100 * GB


def test_the_reserve_is_released_when_the_disk_is_full_and_restored(tmp_path):
    volume, reserve = Volume(), tmp_path / RESERVE_FILE
    disk = DiskWatch(
        tmp_path, StorageSettings(reserve_mb=2), usage=volume, machine=clock_in_seconds(lambda: volume.now_s)
    )

    def look(free, later_s=10.0):
        volume.free, volume.now_s = free, volume.now_s + later_s
        return disk.check()

    assert look(50 * GB) is None, "nothing has changed"
    assert reserve.stat().st_size == 2_000_000
    assert look(0, later_s=5.0) is None, "it is looked at every ten seconds"
    assert look(4 * GB).level == "stop"
    assert reserve.exists()
    assert "4.00 GB (4.0%) of the volume are free" in disk.refusal
    assert look(400_000) is None
    assert not reserve.exists()
    assert look(4 * GB) is None
    assert not reserve.exists(), "whoever fills the disk would take it"
    assert look(6 * GB).level == "alarm"
    assert reserve.exists()
    assert disk.refusal == ""


def test_an_unreadable_disk_state_changes_no_level(tmp_path):
    def gone(folder):
        raise FileNotFoundError(folder)

    disk = DiskWatch(tmp_path, StorageSettings(), usage=gone)
    assert disk.check() is None
    assert (disk.space.level, disk.refusal) == ("ample", "")


def test_the_forecast_uses_the_newest_file_and_has_the_time_of_the_full_disk(tmp_path):
    settings = Settings()
    filled = FilledFolder(tmp_path, settings)
    try:
        usage = lambda folder: (50 * GB, 100 * GB)  # noqa: E731
        forecast = partial(forecast_disk, tmp_path, settings.storage, settings.schedule, filled.catalogue)
        assert forecast(usage).needed_bytes is None
        for index in range(5):
            filled.add_set(index)
        found = forecast(usage)
        assert found.full_at_h is None
        a_set = found.needed_bytes / 420
        (newest,) = (tmp_path / "sets").glob("set_000004_*.h5")
        catalogue = (tmp_path / "catalogue.sqlite").stat().st_size
        assert a_set == pytest.approx(newest.stat().st_size + catalogue / 5, abs=1.0)
        (tmp_path / "small.h5").write_bytes(b"one transducer")
        filled.add_confirmation("B", 4, file="small.h5")
        assert forecast(usage) == replace(found, needed_bytes=pytest.approx(found.needed_bytes, rel=0.01)), (
            "by a planned set; its rows are in the catalogue"
        )
        # Room for ten more sets and a half above the five percent: set 15 is the first without.
        tight = lambda folder: (5 * GB + round(10.5 * a_set), 100 * GB)  # noqa: E731
        assert forecast(tight).full_at_h == filled.due[15].due_h
        for path in (tmp_path / "sets").iterdir():
            write_tiles_of_file(tmp_path, "this test", SetReference(f"sets/{path.name}"), {})
        cells = list_tile_cells(tmp_path)
        assert sum(estimate_tile_bytes(n, 5) for n in cells) == sum_tile_bytes(tmp_path) > 0
        more = forecast(usage).needed_bytes - found.needed_bytes
        assert more == pytest.approx(sum(estimate_tile_bytes(n, 425) for n in cells) * 420 / 425, abs=1.0)
    finally:
        filled.close()


def test_a_full_volume_is_reported_immediately(tmp_path, monkeypatch):
    """No alarm can be stored there, so `run` and `demo` report it immediately."""
    messages = []
    for free, expected in ((60, []), (4, ["WAITING: 4.00 GB (4.0%) of the volume are free"])):
        volume = SimpleNamespace(total=100 * GB, free=free * GB)
        monkeypatch.setattr(disk_policy.shutil, "disk_usage", lambda _, volume=volume: volume)
        report_full_disk(tmp_path, Settings().storage, messages.append)
        assert [line.partition(", and")[0] for line in messages] == expected
    assert messages[0].endswith("free disk space; the test then continues")
