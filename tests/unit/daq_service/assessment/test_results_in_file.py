"""The results in a file are a copy: differences from rows of the same extractor are reported."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest

from daq_service.assessment.results_in_file import build_result_tables, find_differences, read_newest_results
from daq_service.catalogue import SetCommit
from daq_service.catalogue.rows import FeatureRow, ShotRow, ThicknessRow
from hardware_drivers.measurement import SetKey

COMMON = {"set_index": 7, "due_h": 4.0, "extractor_version": "1.1", "quality": "good"}
SHOT = ShotRow(
    sequence=41, set_index=7, position="B", shot_index=0, attempt=0, utc_ns=1, mono_ns=1, boot_id="b",
    crc32=1, valid=True, flags=["noisy", "no_psw"],
)  # fmt: skip
FEATURE = FeatureRow(position="B", shot_index=0, sequence=41, n_valid=1, tof_pp_s=3.3e-4, **COMMON)
MEAN = FeatureRow(position="B", shot_index=None, sequence=None, n_valid=1, tof_pp_s=3.3e-4, **COMMON)
WALL = ThicknessRow(position="A", sequence=40, thickness_m=6.3e-3, **COMMON)
ECHO = replace(SHOT, sequence=40, position="A", flags=[])


def results(*rows, shots=(SHOT, ECHO)):
    features = [row for row in rows if isinstance(row, FeatureRow)]
    return build_result_tables(features, [row for row in rows if isinstance(row, ThicknessRow)], shots)


def test_each_kind_of_row_has_its_table_with_flags_of_its_shot():
    found = results(FEATURE, MEAN, WALL)
    assert (found["features"]["shot_id"], found["features"]["tof_pp_s"]) == ([41], [3.3e-4])
    assert (found["features"]["flags"], found["features"]["valid"]) == (["noisy no_psw"], [1])
    assert (found["set_features"]["position"], found["set_features"]["n_valid"]) == (["B"], [1])
    assert "shot_id" not in found["set_features"]
    assert (found["thickness"]["thickness_m"], found["thickness"]["shot_id"]) == ([6.3e-3], [40])
    assert math.isnan(found["features"]["tof_mf_s"][0])


def test_a_result_whose_record_is_lost_is_left_out():
    assert results(FEATURE, WALL, shots=[]) == {}


def test_a_copy_equals_its_rows_also_without_a_value():
    assert list(find_differences(results(FEATURE, MEAN, WALL), results(FEATURE, MEAN, WALL))) == []


def test_a_changed_value_a_missing_row_and_an_extra_row_are_reported():
    copy = results(FEATURE, MEAN)
    differences = list(find_differences(copy, results(replace(FEATURE, tof_pp_s=None), WALL)))
    assert differences == [
        "features, shot_id 41: tof_pp_s is nan, in the file 0.00033",
        "set_features, position B: there is no row",
        "thickness, position A: not in the file",
    ]


def test_another_version_of_the_extractor_is_not_compared():
    other = replace(FEATURE, tof_pp_s=1.0, extractor_version="2")
    assert list(find_differences(results(FEATURE), results(other))) == []


def test_the_results_of_the_newest_set_are_those_of_its_commit_without_reading_the_catalogue():
    newest = SetCommit(shots=[SHOT, ECHO], features=[FEATURE, MEAN], thickness=[WALL])
    newest.sets.append(SimpleNamespace(set_key=SetKey(7)))
    catalogue = SimpleNamespace(newest=newest)  # has no rows to read
    assert (
        list(find_differences(read_newest_results(catalogue, SetKey(7)), results(FEATURE, MEAN, WALL))) == []
    )
    with pytest.raises(AttributeError):
        read_newest_results(catalogue, SetKey(8))
