"""A catalogue on a read-only volume."""

import os
from types import SimpleNamespace

import pytest
from support.new_experiment import new_catalogue

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.connection import FILE_NAME, _can_open_immutable


@pytest.mark.skipif(not hasattr(os, "statvfs"), reason="Windows tells no such thing")
def test_a_catalogue_on_a_read_only_volume_is_read_without_a_second_file(tmp_path, monkeypatch):
    new_catalogue(tmp_path).close()
    volume = os.statvfs(tmp_path)
    read_only = SimpleNamespace(f_flag=volume.f_flag | os.ST_RDONLY)
    monkeypatch.setattr(os, "statvfs", lambda path: read_only)
    with open_catalogue(tmp_path) as catalogue:
        assert catalogue.read_experiment().name == "test"
        assert [path.name for path in tmp_path.iterdir()] == [FILE_NAME]
    # A process that has it open elsewhere writes a log, which must be read, too.
    (tmp_path / f"{FILE_NAME}-wal").touch()
    assert not _can_open_immutable(tmp_path / FILE_NAME)
