"""Shots compared with the others of their set, and of files of one or many walls."""

import math

import numpy as np
import pytest
from support.synthetic_records import Scene, cos4

from analysis.waves import outline
from analysis.waves.features import extract_from_volts
from analysis.waves.outline import FEWEST
from analysis.waves.record_reduction import TOP_SMOOTHING_S
from analysis.waves.template import compare_with_others, learn_template

SCENE = Scene(noise_fraction=0.03)
DISTURBED = ("disturbed",)


def extracted(volts, scene=SCENE):
    return extract_from_volts(volts, scene.rate_hz, scene.pretrigger_samples)


def clean(n, first=0, **changes):
    scene = SCENE.with_(**changes)
    return [extracted(scene.volts(first + seed), scene) for seed in range(n)]


def flags_of(shots):
    return [shot.flags for shot in compare_with_others(shots, learn_template(shots))]


def foreign(after_isw_s, height, width_s, seed=99):
    pulse = cos4(SCENE.time_s(), SCENE.isw_time_s + after_isw_s, width_s)
    return extracted(SCENE.volts(seed) + height * SCENE.isw_v * pulse)


def cut(after_isw_s, lost_s=50e-6, seed=99):
    """Remove samples from there on, so that later ones move forward."""
    first = round((SCENE.isw_time_s + after_isw_s) * SCENE.rate_hz) + SCENE.pretrigger_samples
    lost = round(lost_s * SCENE.rate_hz)
    volts = SCENE.volts(seed)
    noise = SCENE.noise_fraction * SCENE.isw_v * np.random.default_rng(7).standard_normal(lost)
    return extracted(np.append(np.delete(volts, slice(first, first + lost)), noise + SCENE.offset_v))


def test_shots_of_one_wall_are_alike():
    assert flags_of(clean(10)) == [()] * 10


# Around the incident wave, under the reflected one, behind it: alone none of these is like a fault.
@pytest.mark.parametrize(
    ("after_isw_s", "height", "width_s"),
    [(70e-6, 0.2, 90e-6), (330e-6, 0.12, 200e-6), (560e-6, 0.15, 240e-6)],
)
def test_a_wave_that_no_other_shot_has_is_foreign(after_isw_s, height, width_s):
    odd = foreign(after_isw_s, height, width_s)
    assert odd.flags == (), "by itself"
    assert flags_of([*clean(9), odd]) == [()] * 9 + [DISTURBED]


def test_two_foreign_pulses_alike_are_still_foreign():
    odd = [foreign(330e-6, 0.12, 200e-6, seed) for seed in (98, 99)]
    assert flags_of([*clean(8), *odd]) == [()] * 8 + [DISTURBED] * 2


def test_lost_samples_between_the_waves_show_as_an_earlier_reflection():
    late = {"tof_s": 620e-6}  # 50 us are less than a tenth, as walls differ
    odd = SCENE.with_(tof_s=575e-6).volts(99)
    assert flags_of([*clean(9, **late), extracted(odd)]) == [()] * 9 + [DISTURBED]
    assert cut(170e-6).flags == (), "by itself"
    assert flags_of([*clean(9), cut(170e-6)])[-1] == DISTURBED


def test_a_reflection_that_is_later_is_the_wall():
    assert flags_of([*clean(9), *clean(1, first=50, tof_s=360e-6)]) == [()] * 10


@pytest.mark.parametrize("latest_s", [390e-6, 480e-6])
def test_walls_of_many_times_of_flight_in_one_file_are_not_flagged(latest_s):
    tofs_s = np.linspace(330e-6, latest_s, 30)
    shots = [shot for k, tof_s in enumerate(tofs_s) for shot in clean(1, first=k, tof_s=tof_s)]
    assert flags_of(shots) == [()] * 30


def test_the_only_shot_of_a_wall_in_a_file_is_not_flagged():
    walls = [*clean(9), *clean(8, first=20, tof_s=420e-6)]
    deeper = clean(1, first=40, tof_s=600e-6, amplitude_ratio=0.65)
    assert flags_of([*walls, *deeper]) == [()] * 18
    assert flags_of([*walls, foreign(330e-6, 0.12, 200e-6)]) == [()] * 17 + [DISTURBED]


def test_a_third_or_more_of_earlier_reflections_are_another_wall():
    walls = [*clean(6, tof_s=520e-6), *clean(4, first=20, tof_s=480e-6)]
    assert flags_of(walls) == [()] * 10


def test_too_few_shots_define_no_usual_wave():
    odd = foreign(330e-6, 0.12, 200e-6)
    assert flags_of([*clean(FEWEST - 2), odd])[-1] == ()
    assert flags_of([*clean(FEWEST - 1), odd])[-1] == DISTURBED


def test_a_part_that_a_record_does_not_hold_is_not_compared():
    short = {"n_samples": 7_500}
    assert np.isnan(clean(1, **short)[0].outline.points).any()
    odd = SCENE.with_(**short)
    bump = 0.12 * odd.isw_v * cos4(odd.time_s(), odd.isw_time_s + odd.tof_s, 200e-6)
    assert flags_of([*clean(9, **short), extracted(odd.volts(99) + bump)]) == [()] * 9 + [DISTURBED]


@pytest.mark.parametrize("pretrigger_samples", [235, 250, 265])
def test_a_wave_at_the_beginning_of_its_record_has_no_outline_before(pretrigger_samples):
    shot = clean(1, pretrigger_samples=pretrigger_samples)[0]
    begins_inside = SCENE.isw_time_s + pretrigger_samples / SCENE.rate_hz > 76e-6
    assert np.isfinite(shot.outline.points).all() == begins_inside


def test_flags_that_already_count_the_others_are_kept():
    shots = compare_with_others([*clean(9), foreign(330e-6, 0.12, 200e-6)], None)
    assert compare_with_others(shots, None) == shots


def test_a_long_file_is_compared_with_a_part_of_it(monkeypatch):
    monkeypatch.setattr("analysis.waves.outline.MOST_OTHERS", 8)
    odd = foreign(330e-6, 0.12, 200e-6)
    assert flags_of([*clean(10), odd, *clean(10, first=20)]) == [()] * 10 + [DISTURBED] + [()] * 10


@pytest.mark.parametrize("growth", [1.0, 0.8])
def test_whitened_outlines_have_independent_noise_of_the_same_sd(growth):
    n = 20 * outline.N_POINTS
    spectrum = np.fft.rfft(np.random.default_rng(1).standard_normal((2_000, n)))
    cycles = np.arange(n // 2 + 1) / outline.N_POINTS
    spectrum[:, 0] = 0.0
    spectrum[:, 1:] *= cycles[1:] ** (-0.5 * (1.0 + math.log2(growth)))
    spectrum *= np.sinc(cycles * TOP_SMOOTHING_S / outline.STEP_S)
    noise = np.fft.irfft(spectrum)[:, :: n // outline.N_POINTS]
    noise /= noise.std()
    white = outline._whiten(noise, growth)
    for begin, length in zip(outline.BEGINS, outline.LENGTHS, strict=True):
        part = slice(begin, begin + length)
        before, after = (np.corrcoef(one[:, part].T) - np.eye(length) for one in (noise, white))
        assert np.abs(after).max() < 0.3 * np.abs(before).max()
        assert white[:, part].std() == pytest.approx(1.0, rel=0.15)
