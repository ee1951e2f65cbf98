"""Invariance of features to gain, offset, delay and change of units."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.synthetic_records import Scene

from analysis.statistics.baseline import fit_baseline
from analysis.statistics.distance import contributions
from analysis.waves.features import ALL_FEATURE_NAMES, extract_from_volts
from analysis.waves.quality_gate import INVALIDATING_FLAGS

SCENES = st.builds(
    Scene,
    isw_v=st.floats(0.1, 8.0),
    isw_time_s=st.floats(20e-6, 90e-6),
    tof_s=st.floats(290e-6, 450e-6),
    amplitude_ratio=st.floats(0.3, 0.9),
    ssw_fraction=st.floats(0.0, 0.15),
    noise_fraction=st.floats(0.0, 0.02),
    offset_v=st.floats(-1.0, 1.0),
)
IN_VOLTS = ("psw_area_v_s", "isw_amplitude_v", "psw_amplitude_v", "ssw_amplitude_v", "noise_rms_v")


def shot_of(volts, scene, pretrigger_samples=None):
    return extract_from_volts(volts, scene.rate_hz, pretrigger_samples or scene.pretrigger_samples)


def same(left, right, names, rel=1e-6):
    for name in names:
        a, b = getattr(left, name), getattr(right, name)
        assert a == pytest.approx(b, rel=rel, nan_ok=True), name


@given(scene=SCENES, gain=st.floats(0.01, 100.0), offset_v=st.floats(-5.0, 5.0))
@settings(deadline=None, max_examples=30)
def test_gain_scales_volts_and_nothing_else(scene, gain, offset_v):
    plain = shot_of(scene.volts(1), scene)
    scaled = shot_of(gain * scene.volts(1) + offset_v, scene)
    assert scaled.flags == plain.flags
    same(scaled, plain, [n for n in ALL_FEATURE_NAMES if n not in (*IN_VOLTS, "noise_rms_v")])
    for name in IN_VOLTS:
        expected = gain * getattr(plain, name)
        # The offset costs digits: 5 V beside a noise of 1e-3 V x .01 leaves 1e-10 of it.
        tolerance = {"rel": 1e-6, "abs": 1e-12} if name == "noise_rms_v" else {"rel": 1e-6}
        assert getattr(scaled, name) == pytest.approx(expected, nan_ok=True, **tolerance), name


@given(scene=SCENES, blocks=st.integers(-15, 15))
@settings(deadline=None, max_examples=30)
def test_trigger_time_moves_the_times_and_nothing_else(scene, blocks):
    volts = scene.volts(2)
    plain = shot_of(volts, scene)
    # Only the name of the trigger sample changes; where it bounds the quiet stretch the level may move
    # by a part of the noise, so noise-free records are compared to 1e-6 and noisy ones to their noise.
    moved = shot_of(volts, scene, scene.pretrigger_samples + 10 * blocks)
    rel = 1e-6 if scene.noise_fraction == 0.0 else 0.5 * scene.noise_fraction + 1e-6
    same(moved, plain, ["tof_pp_s", "tof_mf_s", "tof_ac_s", "amplitude_ratio", "psw_isw_area_ratio"], rel)
    assert moved.isw_time_s == pytest.approx(plain.isw_time_s - blocks * 1e-6, abs=rel * 1e-4)


@given(scene=SCENES, samples=st.integers(0, 400))
@settings(deadline=None, max_examples=30)
def test_a_later_wave_has_the_same_features(scene, samples):
    clean = scene.with_(noise_fraction=0.0, isw_time_s=30e-6)
    plain = shot_of(clean.volts(), clean)
    later = clean.with_(isw_time_s=30e-6 + samples / clean.rate_hz)
    shifted = shot_of(later.volts(), later)
    # Against the blocks of 1 us the pulse stands differently: 7 ns in the quartic's peak, 4e-5 in the ratio.
    for name in ("tof_pp_s", "tof_mf_s", "tof_ac_s"):
        assert getattr(shifted, name) == pytest.approx(getattr(plain, name), abs=20e-9)
    assert shifted.amplitude_ratio == pytest.approx(plain.amplitude_ratio, abs=2e-4)
    assert shifted.psw_area_v_s == pytest.approx(plain.psw_area_v_s, rel=1e-3)
    assert shifted.isw_time_s - plain.isw_time_s == pytest.approx(samples / clean.rate_hz, abs=20e-9)


@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(1e-3, 1e3), kind=st.sampled_from(["white", "walk"]))
@settings(deadline=None, max_examples=30)
def test_any_record_is_answered_consistently(seed, scale, kind):
    values = scale * np.random.default_rng(seed).standard_normal(13_000)
    shot = extract_from_volts(np.cumsum(values) if kind == "walk" else values, 1e7, 1000)
    assert shot.valid == INVALIDATING_FLAGS.isdisjoint(shot.flags)
    assert shot.quality == ("bad" if not shot.valid else "suspect" if shot.flags else "good")
    if shot.valid:
        # A valid shot can be averaged; the autocorrelation alone may lack a maximum near the time of flight.
        assert all(math.isfinite(getattr(shot, n)) for n in ("tof_pp_s", "amplitude_ratio", "psw_area_v_s"))


VECTORS = st.integers(0, 2**32 - 1).map(np.random.default_rng)


@given(random=VECTORS)
@settings(deadline=None, max_examples=30)
def test_contributions_do_not_depend_on_units(random):
    x, units = random.standard_normal((30, 5)), 10.0 ** random.uniform(-6, 6, 5)
    plain = fit_baseline(x, range(30), name="plain")
    scaled = fit_baseline(x * units, range(30), name="scaled")
    new = random.standard_normal(5)
    assert contributions(new * units, scaled) == pytest.approx(contributions(new, plain), rel=1e-9, abs=1e-12)
