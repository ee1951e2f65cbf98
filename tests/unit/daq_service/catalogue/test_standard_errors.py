"""The standard error of a set's feature is that of the mean of its valid, accepted shots."""

import math

import numpy as np
import pytest
from support.invented_rows import feature_row, set_row, shot_row
from support.new_experiment import new_catalogue

from daq_service.catalogue import SetCommit
from daq_service.catalogue.rows import FeatureRow
from daq_service.catalogue.standard_errors import find_standard_errors, read_standard_errors
from hardware_drivers.measurement import SetKey

SHOTS = [
    {"shot_index": 0, "amplitude_ratio": 2.0},
    {"shot_index": 1, "amplitude_ratio": 90.0, "attempt": 0, "outcome": "superseded"},
    {"shot_index": 1, "amplitude_ratio": 3.0, "attempt": 1},
    {"shot_index": 2, "amplitude_ratio": 7.0},
    {"shot_index": 3, "amplitude_ratio": 80.0, "valid": False},
    {"shot_index": 4, "amplitude_ratio": None},
]
"""A repeated shot, an invalid one, and one without this feature."""


@pytest.fixture
def catalogue(tmp_path):
    with new_catalogue(tmp_path) as writer:
        for index, mean in enumerate((4.0, None)):  # the second set has too few valid shots
            shots, features = [], []
            for number, shot in enumerate(SHOTS):
                own = {"sequence": 10 * index + number, "position": "B", "shot_index": shot["shot_index"]}
                valid = shot.get("valid", True)
                repeated = {name: shot[name] for name in ("attempt", "outcome") if name in shot}
                shots.append(shot_row(index, **own, valid=valid, **({"attempt": 0} | repeated)))
                features.append(
                    feature_row(index, **own, n_valid=int(valid), amplitude_ratio=shot["amplitude_ratio"])
                )
            features.append(feature_row(index, n_valid=4, amplitude_ratio=mean))
            writer.commit_set(SetCommit(sets=[set_row(index)], shots=shots, features=features))
        yield writer


def test_valid_accepted_shots_with_the_feature_count(catalogue):
    errors = read_standard_errors(catalogue, ["amplitude_ratio", "tof_pp_s"], position="B", last_h=0.0)
    expected = np.std([2.0, 3.0, 7.0], ddof=1) / math.sqrt(3)
    assert errors == {("B", SetKey(0)): {"amplitude_ratio": pytest.approx(expected), "tof_pp_s": None}}


def test_a_set_without_a_mean_has_no_standard_error(catalogue):
    assert read_standard_errors(catalogue, ["amplitude_ratio"])["B", SetKey(1)] == {"amplitude_ratio": None}


def test_rows_of_shots_have_none(catalogue):
    rows = catalogue.rows(FeatureRow, set_index=0)
    found = find_standard_errors(catalogue, rows)
    assert [errors is None for errors in found] == [row.shot_index is not None for row in rows]
    assert find_standard_errors(catalogue, catalogue.rows(FeatureRow, scope="shot")) == [None] * 12
