"""The checksum of a row is the same before and after storage and differs for any other value."""

import sqlite3
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from support.invented_rows import feature_row, set_row
from support.new_experiment import new_catalogue

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.corruption import find_catalogue_corruption
from daq_service.catalogue.errors import CatalogueDamagedError
from daq_service.catalogue.rows import CommandRow, EventRow, ExperimentRow, FeatureRow, SetRow, ThicknessRow
from daq_service.catalogue.stored_rows import compute_row_crc32
from daq_service.catalogue.writer import SetCommit
from hardware_drivers.measurement import SetKey

SET = set_row(3, due_h=2, n_planned=4)
FEATURE = feature_row(
    3, due_h=2.0, n_valid=np.int64(4), tof_pp_s=-0.0, tof_ac_s=np.float64(3e-4), amplitude_ratio=float("nan")
)
EVENT = EventRow(
    utc_ns=1, topic="sets", kind="set_done", payload={"mean": np.array([1.0, np.nan]), "n": (1, 2)}
)


@pytest.fixture
def folder(tmp_path):
    with new_catalogue(tmp_path) as catalogue:
        catalogue.commit_set(SetCommit(sets=[SET], features=[FEATURE], events=[EVENT]))
        catalogue.finish_command(catalogue.add_command("Ada", "pause", {"note": "x"}), "done", "paused")
    return tmp_path


def change(folder, statement):
    with closing(sqlite3.connect(folder / FILE_NAME)) as database:
        assert database.execute(statement).rowcount == 1
        database.commit()


def test_a_value_converted_by_sql_is_no_corruption(folder):
    assert list(find_catalogue_corruption(folder)) == []
    with open_catalogue(folder) as catalogue:
        (feature,) = catalogue.rows(FeatureRow)
        assert (feature.tof_pp_s, feature.n_valid, feature.amplitude_ratio) == (0.0, 4, None)
        assert catalogue.rows(SetRow)[0].due_h == 2.0
        assert catalogue.read_events_after(0)[-1].payload == {"mean": [1.0, None], "n": [1, 2]}


@pytest.mark.parametrize(
    ("kind", "statement", "row_id"),
    [
        (SetRow, "UPDATE sets SET n_taken = 1", 1),
        (SetRow, "UPDATE sets SET id = 7", 7),
        (SetRow, "UPDATE sets SET reason = ''", 1),
        (SetRow, "UPDATE sets SET n_taken = 'four'", 1),
        (FeatureRow, "UPDATE features SET tof_ac_s = tof_ac_s * 1.0000000000000002", 1),
        (EventRow, "UPDATE events SET payload = replace(payload, 'null', '0.0')", 1),
        (EventRow, "UPDATE events SET payload = substr(payload, 2)", 1),
        (CommandRow, "UPDATE commands SET author = CAST(x'ff41' AS TEXT)", 1),
        (CommandRow, "UPDATE commands SET row_crc32 = NULL", 1),
        (ExperimentRow, "UPDATE experiment SET epoch_utc_ns = epoch_utc_ns + 1", 1),
    ],
)
def test_a_changed_value_is_reported_and_never_read(folder, kind, statement, row_id):
    change(folder, statement)
    (damage,) = find_catalogue_corruption(folder)
    assert (damage.table, damage.row_id) == (statement.split()[1], row_id)
    with pytest.raises(CatalogueDamagedError, match="solimon rebuild"), open_catalogue(folder) as catalogue:
        catalogue.rows(kind)
    with pytest.raises(CatalogueDamagedError, match=rf"row {row_id} .*solimon rebuild"):
        open_catalogue(folder, writer=True)


def test_one_corrupt_row_hides_no_other(folder):
    with open_catalogue(folder, writer=True) as catalogue:
        for number in range(4):
            catalogue.add_service_event(utc_ns=number, kind="told", payload={})
    change(folder, "UPDATE events SET payload = '}' WHERE id = 2")
    change(folder, "UPDATE events SET utc_ns = 8 WHERE id = 4")
    assert [damage.row_id for damage in find_catalogue_corruption(folder)] == [2, 4]


def test_columns_are_compared_too(folder):
    change(folder, "UPDATE features SET quality = 'bad'")
    with (
        open_catalogue(folder) as catalogue,
        pytest.raises(CatalogueDamagedError, match="row 1 of table features"),
    ):
        catalogue.columns(FeatureRow, ["tof_ac_s"])


def test_a_new_empty_column_changes_no_checksum():
    assert compute_row_crc32(replace(SET, id=1)) == compute_row_crc32(
        replace(SET, id=1, reason=None, file_sha256=None)
    )
    assert compute_row_crc32(replace(SET, id=1)) != compute_row_crc32(replace(SET, id=2))


def test_changed_rows_get_their_checksum_again(folder):
    with open_catalogue(folder, writer=True) as catalogue:
        catalogue.restore_rows([replace(SET, id=1, file="sets/a.h5"), replace(SET, id=9, position="C")])
        catalogue.store_digest(SetKey(3), "sets/a.h5", "ab" * 32)
        assert catalogue.list_sets_without_digest() == {}
        catalogue.commit_set(SetCommit(sets=[replace(SET, position="D")]))
        rows = catalogue.rows(SetRow)
    assert [(row.id, row.file_sha256) for row in rows] == [(1, "ab" * 32), (9, None), (10, None)]
    assert list(find_catalogue_corruption(folder)) == []


def test_a_row_with_a_missing_reference_is_reported(folder):
    row = ThicknessRow(
        set_index=3, position="A", sequence=5, due_h=2.0, extractor_version="1", quality="bad", id=1
    )
    columns = "id, set_index, position, sequence, due_h, extractor_version, quality, row_crc32"
    values = f"1, 3, 'A', 5, 2.0, '1', 'bad', {compute_row_crc32(row)}"
    change(folder, f"INSERT INTO thickness ({columns}) VALUES ({values})")
    assert [damage.description for damage in find_catalogue_corruption(folder)] == [
        "row 1 of table thickness lacks its row of shots"
    ]
