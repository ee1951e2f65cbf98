"""A shot compared with the waves of its transducer."""

import math
from dataclasses import replace

import numpy as np
import pytest

from analysis.waves.features import ShotFeatures
from analysis.waves.outline import Outline
from analysis.waves.template import (
    Template,
    compare_with_others,
    compare_with_template,
    flag_residual_reflections,
    learn_template,
)

OWN = Template(
    isw_fwhm_s=65e-6, isw_amplitude_v=2.0, amplitude_ratio=0.5, earliest_tof_s=310e-6, pull_fraction=0.02
)
SHOT = ShotFeatures(
    isw_fwhm_s=65e-6,
    isw_amplitude_v=2.0,
    isw_time_s=5e-5,
    tof_mf_s=335e-6,
    amplitude_ratio=0.5,
    pull_fraction=0.02,
    noise_rms_v=0.02,
)


def test_the_transducer_s_own_shot_stays_as_it_was():
    assert compare_with_template(SHOT, OWN) is not None
    assert compare_with_template(SHOT, OWN) == SHOT
    assert compare_with_template(SHOT, None) is SHOT


@pytest.mark.parametrize(
    ("changes", "flags"),
    [
        ({"isw_amplitude_v": 0.5}, ("missed",)),  # a quarter
        ({"isw_amplitude_v": 1.0}, ()),  # a PZT aged to half
        ({"isw_amplitude_v": 1.0, "isw_fwhm_s": 73e-6}, ()),  # a strike half as strong: 2^(1/6) = 1.12
        ({"isw_amplitude_v": 1.45, "isw_fwhm_s": 75e-6}, ("clipped",)),  # tanh to .9: .72 high, 1.16 wide
        ({"isw_amplitude_v": 1.8, "isw_fwhm_s": 75e-6}, ()),  # too high for that: worn or tilted
        ({"isw_fwhm_s": 35e-6}, ("missed",)),
        ({"isw_fwhm_s": 100e-6}, ("missed",)),
        ({"isw_fwhm_s": 56.5e-6}, ()),  # beads worn to twice their radius
        ({"tof_mf_s": 285e-6}, ("disturbed",)),  # 50 us lost between the waves
        ({"tof_mf_s": 640e-6}, ()),  # a wall 80 % thinner
        ({"amplitude_ratio": 0.75}, ("double",)),  # a second strike of a quarter on top
        ({"amplitude_ratio": 0.58}, ()),
        ({"pull_fraction": 0.06}, ("disturbed",)),
    ],
)
def test_a_wave_unlike_the_template_is_flagged(changes, flags):
    found = compare_with_template(replace(SHOT, **changes), OWN)
    assert found.flags == flags
    assert found.valid is not bool(flags)


def test_a_weak_strike_keeps_its_incident_wave_and_has_no_wall_features():
    found = compare_with_template(replace(SHOT, isw_amplitude_v=0.4), OWN)
    assert (found.isw_amplitude_v, found.isw_time_s, found.noise_rms_v) == (0.4, 5e-5, 0.02)
    assert math.isnan(found.tof_mf_s)


@pytest.mark.parametrize(("fwhm_s", "flag"), [(65e-6, "no_psw"), (72e-6, "no_psw"), (50e-6, "missed")])
def test_only_its_own_wave_without_a_reflection_is_a_sign_of_a_hole(fwhm_s, flag):
    silent = replace(
        SHOT, isw_fwhm_s=fwhm_s, tof_mf_s=math.nan, flags=("no_psw",), valid=False, quality="bad"
    )
    assert compare_with_template(silent, OWN).flags == (flag,)


@pytest.mark.parametrize(
    ("arrives_s", "scatter_s", "flag"),
    [(70e-6, 2e-6, "no_psw"), (90e-6, 2e-6, "missed"), (10e-6, 2e-6, "missed"), (90e-6, 8e-6, "no_psw")],
)
def test_a_similar_pulse_that_did_not_trigger_indicates_no_hole(arrives_s, scatter_s, flag):
    silent = replace(SHOT, isw_time_s=arrives_s, flags=("no_psw",), valid=False, quality="bad")
    own = replace(OWN, isw_time_s=5e-5, isw_time_sd_s=scatter_s)
    assert compare_with_template(silent, own).flags == (flag,)
    assert compare_with_template(replace(SHOT, isw_time_s=arrives_s), own).flags == (), (
        "its reflection came with it"
    )


def test_a_reflection_merged_once_is_a_second_strike_and_in_most_shots_the_wall():
    merged = replace(SHOT, flags=("psw_merged",), quality="suspect")
    assert compare_with_template(merged, OWN).flags == ("double", "psw_merged")
    assert compare_with_template(merged, learn_template([merged] * 6 + [SHOT] * 4)).flags == ("psw_merged",)
    # A patch thinned by 80 % splits the wave by itself.
    assert compare_with_template(replace(merged, tof_mf_s=640e-6), OWN).flags == ("psw_merged",)


def test_it_is_learnt_from_valid_shots_if_there_are_three():
    weak = replace(SHOT, isw_amplitude_v=0.1, valid=False)
    assert learn_template([SHOT, SHOT, weak]) is None
    own = learn_template([SHOT, replace(SHOT, isw_amplitude_v=2.2), SHOT, weak])
    assert (own.isw_amplitude_v, own.isw_fwhm_s, own.merged) == (pytest.approx(2.1), 65e-6, False)
    assert (own.isw_time_s, own.isw_time_sd_s) == (5e-5, 0.0)
    assert own.earliest_tof_s == pytest.approx(0.9 * 335e-6)


def test_weak_strikes_are_flagged_where_every_second_one_is_weak():
    shots = [SHOT, replace(SHOT, isw_amplitude_v=0.4)] * 5
    own = learn_template(shots)
    assert [compare_with_template(shot, own).flags for shot in shots] == [(), ("missed",)] * 5


def test_a_pull_counts_only_above_the_noise_of_the_shot():
    pulled = replace(SHOT, pull_fraction=0.08)
    for sd, flags in ((0.01, ("disturbed",)), (0.03, ())):
        assert (
            compare_with_template(replace(pulled, outline=Outline(points=np.zeros(57), sd=sd)), OWN).flags
            == flags
        )


@pytest.mark.parametrize(
    ("ratio", "changes", "flags"),
    [
        (0.12, {}, ("no_psw",)),  # .24 of the baseline's
        (0.13, {}, ()),
        (0.12, {"flags": ("psw_merged",), "quality": "suspect"}, ("no_psw",)),
        (0.12, {"flags": ("disturbed",), "valid": False, "quality": "bad"}, ("missed", "disturbed")),
        (0.12, {"compared": True}, ()),  # as it was stored
        (math.nan, {"flags": ("missed",), "valid": False, "quality": "bad"}, ("missed",)),
    ],
)
def test_a_reflection_weaker_than_any_wall_s_is_none(ratio, changes, flags):
    shot = replace(SHOT, amplitude_ratio=ratio, **changes)
    assert flag_residual_reflections([shot], None) == [shot]
    (found,) = flag_residual_reflections([shot], 0.5)
    assert found.flags == flags
    if found != shot:
        assert (found.valid, found.isw_time_s, found.noise_rms_v) == (False, 5e-5, 0.02)
        assert math.isnan(found.tof_mf_s)
        assert math.isnan(found.amplitude_ratio)


def test_a_residue_shows_in_a_file_of_the_transducer_s_own_waves():
    shots = [SHOT] * 6 + [replace(SHOT, amplitude_ratio=0.11)]
    assert [shot.flags for shot in compare_with_others(shots, learn_template(shots))] == [()] * 6 + [
        ("no_psw",)
    ]
