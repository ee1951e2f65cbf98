"""experiment.json identifies the test of a folder that lost its catalogue."""

from dataclasses import replace

import pytest

from daq_service.catalogue import check_owner
from daq_service.catalogue.errors import CatalogueDamagedError, OtherExperimentError
from daq_service.catalogue.experiment_file import (
    EXPERIMENT_FILE,
    ensure_experiment_file,
    read_experiment_file,
    write_experiment_file,
)
from daq_service.catalogue.rows import ExperimentRow
from daq_service.settings.file import load_settings


def row_of(settings, **changes):
    row = ExperimentRow(
        uuid="e1b9f7a6-6a0e-4f0e-9d0d-3c1d1f6f0a55",
        name=settings.name,
        configuration_hash=settings.configuration_hash(),
        configuration=settings.model_dump(mode="json"),
        created_utc_ns=5,
        epoch_utc_ns=10**18,
        clock="wall",
        solimon_version="0",
    )
    return replace(row, **changes)


@pytest.fixture(scope="module")
def row():
    return row_of(load_settings(None))


def test_the_file_reads_back_equal_in_any_layout(row, tmp_path):
    assert read_experiment_file(tmp_path) is None
    write_experiment_file(tmp_path, row)
    path = tmp_path / EXPERIMENT_FILE
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert read_experiment_file(tmp_path) == row


@pytest.mark.parametrize(
    "damaged", [lambda content: content.replace(b"1000000000", b"1000000001"), lambda content: content[:-40]]
)
def test_a_changed_value_is_rejected_and_the_catalogue_writes_the_file_again(row, tmp_path, damaged):
    write_experiment_file(tmp_path, row)
    path = tmp_path / EXPERIMENT_FILE
    path.write_bytes(damaged(path.read_bytes()))
    with pytest.raises(CatalogueDamagedError, match="solimon rebuild"):
        read_experiment_file(tmp_path)
    ensure_experiment_file(tmp_path, row)
    assert read_experiment_file(tmp_path) == row


def test_a_catalogue_of_another_hour_0_is_rejected_with_both_times(row, tmp_path):
    ensure_experiment_file(tmp_path, row)
    with pytest.raises(OtherExperimentError, match=r"2001-09-09T01:46:41.*2001-09-09T01:46:40"):
        ensure_experiment_file(tmp_path, replace(row, epoch_utc_ns=10**18 + 10**9))
    assert read_experiment_file(tmp_path) == row


def test_without_a_catalogue_the_file_identifies_the_test(row, tmp_path):
    write_experiment_file(tmp_path, row)
    check_owner(load_settings(None), tmp_path)
    lower = load_settings(None, overrides={"chain": {"drop_height_m": 3e-3}})
    with pytest.raises(OtherExperimentError, match=r"drop_height_m started with 0.005, is 0.003 now"):
        check_owner(lower, tmp_path)
