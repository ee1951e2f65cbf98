"""Mean features of a set."""

import math

import numpy as np
import pytest
from support.synthetic_records import Scene

from analysis.errors import InvalidInputError
from analysis.waves.features import (
    ALL_FEATURE_NAMES,
    FEATURE_NAMES,
    ShotFeatures,
    average_features,
    extract_features,
)


def shot(value=1.0, flags=(), valid=True, **changes):
    numbers = dict.fromkeys(ALL_FEATURE_NAMES, value) | changes
    quality = "bad" if not valid else "suspect" if flags else "good"
    return ShotFeatures(**numbers, flags=flags, valid=valid, quality=quality)


def test_mean_and_standard_deviation_are_those_of_the_valid_shots():
    values = [1.0, 2.0, 4.0, 8.0, 3.0, 5.0, 7.0]
    outcome = average_features([shot(v) for v in values] + [shot(1e9, ("clipped",), False)])
    for name in ALL_FEATURE_NAMES:
        assert outcome.mean[name] == pytest.approx(np.mean(values))
        assert outcome.sd[name] == pytest.approx(np.std(values, ddof=1))
    assert (outcome.n_shots, outcome.n_valid) == (8, 7)
    assert outcome.vector().shape == (len(FEATURE_NAMES),)
    assert outcome.quality == "suspect"
    assert outcome.reason == "1 of 8 shots left out (clipped in 1)"


def test_a_rogue_value_is_left_out_of_its_mean_alone():
    values = [1.0, 1.1, 0.9, 1.05, 0.95, 1.02, 0.98, 1.0, 1.1]
    outcome = average_features([shot(v) for v in values] + [shot(1.0, tof_mf_s=9.0)])
    assert outcome.mean["tof_mf_s"] == pytest.approx(np.mean(values))
    assert outcome.sd["tof_mf_s"] == pytest.approx(np.std(values, ddof=1))
    assert outcome.mean["tof_pp_s"] == pytest.approx(np.mean([*values, 1.0]))
    assert (outcome.quality, outcome.n_valid) == ("good", 10)


def test_ten_good_shots_make_a_good_set_without_a_reason():
    outcome = average_features([shot()] * 10)
    assert (outcome.quality, outcome.reason) == ("good", "")


def test_six_valid_shots_of_ten_make_no_mean():
    silent = shot(math.nan, ("no_psw",), False)
    outcome = average_features([shot()] * 6 + [silent] * 4)
    assert outcome.quality == "bad"
    assert outcome.reason == "6 of 10 shots valid, 7 needed (no_psw in 4)"
    assert all(math.isnan(value) for value in outcome.mean.values())
    assert average_features([shot()] * 6 + [silent] * 4, minimum_valid=6).quality == "suspect"


def test_no_shot_is_a_bad_set():
    outcome = average_features([])
    assert (outcome.quality, outcome.n_valid) == ("bad", 0)
    assert outcome.reason == "0 of 0 shots valid, 7 needed"


def test_half_of_the_valid_shots_suspect_make_a_suspect_set():
    suspect = shot(flags=("baseline",))
    assert average_features([shot()] * 6 + [suspect] * 4).quality == "good"
    outcome = average_features([shot()] * 5 + [suspect] * 5)
    assert outcome.quality == "suspect"
    assert "5 of 10 valid shots suspect (baseline in 5)" in outcome.reason


def test_feature_some_shots_lack_is_the_mean_of_the_others():
    shots = [shot(ssw_amplitude_v=2.0)] * 3 + [shot(ssw_amplitude_v=math.nan)] * 6
    outcome = average_features([*shots, shot(ssw_amplitude_v=4.0)])
    assert outcome.mean["ssw_amplitude_v"] == pytest.approx(2.5)
    assert outcome.quality == "good"


def test_feature_no_shot_has_is_not_available():
    outcome = average_features([shot(ssw_amplitude_v=math.nan)] * 10)
    assert math.isnan(outcome.mean["ssw_amplitude_v"])
    assert math.isnan(outcome.sd["ssw_amplitude_v"])


def test_minimum_of_valid_shots_must_be_positive():
    with pytest.raises(InvalidInputError, match="minimum_valid is 0"):
        average_features([shot()], minimum_valid=0)


def test_mean_of_ten_real_extractions_is_quieter_than_one():
    scene = Scene(noise_fraction=0.01)
    shots = [extract_features(scene.waveform(seed)) for seed in range(10)]
    outcome = average_features(shots)
    assert outcome.mean["tof_mf_s"] == pytest.approx(scene.tof_s, abs=5 * 39e-9 / math.sqrt(10))
    # 39 ns a shot; ten of them know their SD to 24 %: four of these.
    assert outcome.sd["tof_mf_s"] == pytest.approx(39e-9, rel=0.95)
