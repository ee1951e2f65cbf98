"""The line from strike to alarm, in one process."""

import math
from dataclasses import replace
from typing import Any

import pytest
from support.small_experiment import rows_of, run
from support.small_experiment import small_settings as half_a_day
from support.stored_files import read_set, set_files

from analysis.waves.features import extract_from_average
from daq_service.archive.waterfall.tiles import WIDTHS, sum_tile_bytes
from daq_service.catalogue.connection import FILE_NAME
from daq_service.cli.forecast import CATALOGUE_BYTES_A_RECORD, predict_set_file_bytes, predict_tile_bytes
from daq_service.cli.offline.twin_line import simulate_assessed_sets

SETS = 19
SHORT: dict[str, Any] = {
    "schedule": {"phases": [{"until_h": 9.5, "interval_h": 0.5}]},
    "baseline": {"hours": 7.5},
}


def small_settings(**tables):
    """Return settings of the shortest test with an assessed baseline; ``tables`` override them."""
    return half_a_day(**{name: {**SHORT.get(name, {}), **tables.get(name, {})} for name in {*SHORT, *tables}})


def pair_settings(**tables):
    """Return settings with a probe and one transducer: half the time, for repeated runs."""
    settings = small_settings(**tables)
    return settings.model_copy(update={"positions": {name: settings.positions[name] for name in "AB"}})


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished")
    assert run(small_settings(), folder)
    return folder


def test_the_forecast_is_the_folder_s_size(finished):
    settings = small_settings()
    files = sum(path.stat().st_size for path in (finished / "sets").iterdir())
    # 5 %: temperature, drop height and thinning wall make pulses, so also their bytes, differ by shot.
    assert SETS * predict_set_file_bytes(settings) == pytest.approx(files, rel=0.05)
    # Rows of incomplete blocks follow while no set is due; a pretrigger may take a cell more.
    rows, complete = sum(math.ceil(SETS / width) for width in WIDTHS), sum(SETS // width for width in WIDTHS)
    assert predict_tile_bytes(settings, SETS) * complete / rows == pytest.approx(
        sum_tile_bytes(finished), rel=0.01
    )
    # Empty tables, 0.3 MB, and the newest states of the assessors, 0.4 MB, do not grow with the test.
    catalogue = (finished / FILE_NAME).stat().st_size
    assert pytest.approx(catalogue, abs=0.8e6) == CATALOGUE_BYTES_A_RECORD * SETS * 10


def test_assessment_without_recorder_and_storage_gives_the_same_result(finished):
    rows, assessed = rows_of(finished), list(simulate_assessed_sets(small_settings(), "B"))
    of_sets = [found.position_result.features[-1] for found in assessed]
    stored = [row for row in rows["set_features"] if row.position == "B"]
    names = {"id": None, "sequence": None}
    assert [replace(row, **names) for row in of_sets] == [replace(row, **names) for row in stored]
    assessments = {row.set_index: row for found in assessed for row in found.position_result.assessments}
    stored_rows = [row for row in rows["assessments"] if row.position == "B"]
    assert len(stored_rows) == SETS
    for row in stored_rows:
        ours = assessments[row.set_index]
        assert (ours.distance_squared, ours.outlier) == (row.distance_squared, row.outlier)
        assert (ours.limit_f_predictive, ours.outlier_mean_3sd) == (
            row.limit_f_predictive,
            row.outlier_mean_3sd,
        )


def test_features_may_come_from_the_averaged_record_as_in_the_paper(finished, tmp_path):
    assert run(small_settings(features={"of_set": "averaged_waveform"}, schedule={"end_h": 2.0}), tmp_path)
    ours = rows_of(tmp_path)
    usual = [row for row in rows_of(finished)["set_features"] if row.set_index < 4]
    assert ours["shot_features"] == [row for row in rows_of(finished)["shot_features"] if row.set_index < 4]
    for averaged, mean in zip(ours["set_features"], usual, strict=True):
        record = read_set(set_files(tmp_path)[averaged.set_index])
        waveforms = [shot.waveform for shot in record.shots if shot.key.position == averaged.position]
        assert averaged.tof_pp_s == extract_from_average(waveforms).tof_pp_s
        # Other quantities, but of the same wave: shots of a set scatter by about one per cent.
        assert averaged.tof_pp_s != mean.tof_pp_s
        assert averaged.tof_pp_s == pytest.approx(mean.tof_pp_s, rel=0.01)
        assert averaged.noise_rms_v < 0.8 * mean.noise_rms_v, "three records are averaged"


def test_disturbances_of_a_shot_are_stored_with_it_and_forecast(tmp_path):
    settings = pair_settings(twin={"nuisance": "plant"}, schedule={"end_h": 1.0})
    assert run(settings, tmp_path)
    sizes = [path.stat().st_size for path in (tmp_path / "sets").iterdir()]
    # As without nuisance.
    assert predict_set_file_bytes(settings) * len(sizes) == pytest.approx(sum(sizes), rel=0.05)
    (struck,) = (found for found in simulate_assessed_sets(settings, "B") if found.due.set_index == 1)
    stored = [shot for shot in read_set(set_files(tmp_path)[1]).shots if shot.key.position == "B"]
    assert [dict(shot.truth) for shot in stored] == [dict(shot.truth) for shot in struck.shots]
    assert sum(name.startswith("nuisance_") for name in stored[0].truth) == 12 + 2 * 9
