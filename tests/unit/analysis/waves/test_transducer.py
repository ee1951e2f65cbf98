"""What the extractor is told of a chain: the paper's as ever, others in proportion."""

import re
from dataclasses import replace

import numpy as np
import pytest
from support.synthetic_records import Scene, cos4, waveform_of

from analysis.errors import InvalidInputError, RecordError
from analysis.waves.features import extract_features, extract_from_volts
from analysis.waves.record_reduction import USUAL_FWHM_S, ExtractionSettings
from analysis.waves.transducer import PAPER, find_obstacles, settings_of_chain

HALF = replace(PAPER, radius_m=PAPER.radius_m / 2, mass_kg=PAPER.mass_kg / 8, damping_n_s_per_m=4.5 / 4)


def test_the_papers_chain_has_the_defaults():
    assert settings_of_chain(PAPER) == ExtractionSettings()
    assert ExtractionSettings().stretch == 1.0


def test_spheres_of_half_the_size_have_half_of_every_time():
    settings, usual = settings_of_chain(HALF), ExtractionSettings()
    assert settings.isw_fwhm_s == pytest.approx(0.5 * USUAL_FWHM_S)
    assert settings.psw_latest_s == pytest.approx(0.5 * usual.psw_latest_s)
    assert settings.block_s == pytest.approx(0.5 * usual.block_s)
    assert settings.no_psw_below_fraction == usual.no_psw_below_fraction


@pytest.mark.parametrize(
    ("changes", "stretch"),
    [
        ({"drop_height_m": 20e-3}, 0.871),  # of the twin: 56.1 us after 64.6
        ({"sensor_is_disk": False}, 1.14),
        ({"youngs_modulus_pa": 620e9, "poisson_ratio": 0.22, "mass_kg": 53.9e-3}, 0.836),
    ],
)
def test_the_width_is_that_of_the_twin(changes, stretch):
    assert settings_of_chain(replace(PAPER, **changes)).stretch == pytest.approx(stretch, rel=0.02)


@pytest.mark.parametrize(("below", "tof_s"), [(2, 182e-6), (6, 460e-6), (8, 601e-6), (12, 880e-6)])
def test_windows_hold_the_reflection_of_the_twins_rigid_wall(below, tof_s):
    settings = settings_of_chain(replace(PAPER, spheres_below=below))
    assert 0.5 * tof_s < settings.psw_earliest_s < 0.8 * tof_s
    assert settings.psw_latest_s > 1.5 * tof_s


def test_a_pressed_chain_may_let_go_of_its_precompression():
    # The twin's wave is 152 N high.
    assert settings_of_chain(replace(PAPER, precompression_n=15.2)).deepest_pull_fraction == pytest.approx(
        0.15, abs=0.002
    )


@pytest.mark.parametrize(("precompression_n", "twin_s"), [(20.0, 545e-6), (50.0, 375e-6)])
def test_a_pressed_chain_that_closes_again_is_no_second_strike(precompression_n, twin_s):
    pressed = settings_of_chain(replace(PAPER, precompression_n=precompression_n))
    assert 0.7 * twin_s < pressed.second_strike_latest_s < twin_s
    scene = Scene(noise_fraction=0.01)
    third_s = scene.isw_time_s + scene.tof_s + twin_s
    late = scene.volts(3) + 0.3 * scene.isw_v * cos4(scene.time_s(), third_s)
    assert "double" in extract_features(waveform_of(late)).flags
    assert extract_features(waveform_of(late), pressed).flags == ()


def test_given_values_have_priority_over_the_chain():
    settings = settings_of_chain(HALF, isw_fwhm_s=40e-6, psw_latest_s=600e-6)
    assert (settings.isw_fwhm_s, settings.psw_latest_s) == (40e-6, 600e-6)
    assert settings.psw_earliest_s == pytest.approx(200e-6 * 40e-6 / USUAL_FWHM_S)
    with pytest.raises(InvalidInputError, match="psw_earliest_s"):
        settings_of_chain(HALF, psw_earliest_s=1e-3)


def test_times_come_back_in_the_records_own_time():
    """The same samples, twice as fast: the same shot with half of every time."""
    volts = Scene(noise_fraction=0.01).volts(3)
    slow = extract_from_volts(volts, 1e7, 1000, with_sd=True)
    fast = extract_from_volts(
        volts, 2e7, 1000, with_sd=True, settings=ExtractionSettings.for_width(0.5 * USUAL_FWHM_S)
    )
    assert slow.flags == fast.flags == ()
    for name, value in slow.values().items():
        factor = 0.5 if name.endswith("_s") else 1.0
        assert fast.values()[name] == pytest.approx(factor * value, rel=1e-9), name
        if name in slow.sd:
            assert fast.sd[name] == pytest.approx(factor * slow.sd[name], rel=1e-9), name
    assert fast.outline.stretch == 0.5
    assert np.array_equal(fast.outline.points, slow.outline.points)


def test_a_record_that_is_too_coarse_is_refused_in_its_own_time():
    settings = settings_of_chain(replace(PAPER, radius_m=1e-4, mass_kg=3.3e-8, damping_n_s_per_m=0.0))
    with pytest.raises(RecordError, match=r"an ISW of 0\.7 us .* sample at 2\.36e\+07 Hz or more"):
        extract_features(waveform_of(Scene().volts()), settings)


@pytest.mark.parametrize(
    ("changes", "numbers", "message"),
    [
        ({}, {}, None),
        ({}, {"inelasticity": 0.71}, r"inelasticity is 0\.71, above 0\.7"),
        ({}, {"amplitude_ratio": 0.19}, r"amplitude ratio is 0\.19, below 0\.2"),
        ({"spheres_below": 1}, {}, r"after 1\.6 of its widths, below 2\.5"),
        ({"precompression_n": 330.0}, {}, r"precompression is 2\.2 times .* above 2: .* press less"),
        ({}, {"after_trigger_s": 400e-6}, "lasts 400 us after its trigger, below 509 us"),
    ],
)
def test_an_impossible_design_is_refused_with_the_number(changes, numbers, message):
    chain = replace(PAPER, **changes)
    found = find_obstacles(
        chain, ExtractionSettings(), **{"inelasticity": 0.26, "amplitude_ratio": 0.5, **numbers}
    )
    assert len(found) == (message is not None)
    assert message is None or re.search(message, found[0])
