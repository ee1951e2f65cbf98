"""Lowered tops and lost samples, compared with the other shots of a set."""

import numpy as np
import pytest
from support.synthetic_records import Scene, cos4

from analysis.waves.features import extract_from_volts
from analysis.waves.outline import FEWEST
from analysis.waves.template import compare_with_others, learn_template

SCENE = Scene(noise_fraction=0.03, offset_v=0.0)
LOST_S = 50e-6


def extracted(volts):
    return extract_from_volts(volts, SCENE.rate_hz, SCENE.pretrigger_samples)


def noise(seed):
    return SCENE.noise_fraction * SCENE.isw_v * np.random.default_rng(seed).standard_normal(SCENE.n_samples)


def clean(n, first=0, **changes):
    return [extracted(SCENE.with_(**changes).volts(first + seed)) for seed in range(n)]


def flags_of(shots):
    return [shot.flags for shot in compare_with_others(shots, learn_template(shots))]


def hard(volts, part):
    return np.minimum(volts, part * SCENE.isw_v)


def soft(volts, scale):
    """Limit like tanh; 2.5: the top falls to .95, 1.7: to .9."""
    return scale * SCENE.isw_v * np.tanh(volts / (scale * SCENE.isw_v))


def limited(how, amount, seed=99):
    """Add noise after the limit, so that no two samples at the top are equal."""
    return extracted(how(SCENE.with_(noise_fraction=0.0).volts(), amount) + noise(seed))


@pytest.mark.parametrize(("how", "amount"), [(hard, 0.95), (soft, 1.7)])
def test_a_top_lower_than_extrapolated_from_its_flanks_is_clipped(how, amount):
    odd = limited(how, amount)
    assert odd.flags == (), "by itself"
    assert flags_of([*clean(9), odd]) == [()] * 9 + [("clipped",)]


def test_a_strike_of_another_height_arrival_or_width_is_not_clipped():
    others = [
        *clean(1, 20, isw_v=4.3),
        *clean(1, 21, isw_time_s=57e-6),
        *clean(1, 22, width_s=184e-6),
    ]
    assert flags_of([*clean(8), *others]) == [()] * 11


def test_scatter_in_all_shots_is_not_a_soft_limit():
    """Re-seated contacts let the reflected wave's height scatter by 4 %, as tanh to .95 moves it once."""
    ratios = 0.5 * (1.0 + 0.04 * np.array([-1.6, -1.0, -0.7, -0.4, -0.1, 0.1, 0.4, 0.7, 1.0, 1.6]))
    assert flags_of([clean(1, k, amplitude_ratio=ratio)[0] for k, ratio in enumerate(ratios)]) == [()] * 10


def test_only_the_incident_wave_shows_a_limit_among_many_walls():
    tofs_s = np.linspace(330e-6, 420e-6, 10)
    walls = [clean(1, k, tof_s=tof_s, amplitude_ratio=0.4 + 0.02 * k)[0] for k, tof_s in enumerate(tofs_s)]
    assert flags_of([*walls, limited(hard, 0.95)]) == [()] * 10 + [("clipped",)]
    two = [*clean(14), *clean(6, 20, tof_s=420e-6, amplitude_ratio=0.6)]
    assert flags_of(two) == [()] * 20


def test_noise_bends_no_top():
    """At 20 dB a limit at .95 is 3.4 standard deviations of a point's noise: only 3 and more are detected."""
    assert flags_of(clean(40, 40, noise_fraction=0.1)) == [()] * 40


def closed_up(after_psw_s, seed=99):
    first = round((SCENE.isw_time_s + SCENE.tof_s + after_psw_s) * SCENE.rate_hz) + SCENE.pretrigger_samples
    lost = round(LOST_S * SCENE.rate_hz)
    volts = SCENE.with_(noise_fraction=0.0).volts()
    return extracted(np.append(np.delete(volts, slice(first, first + lost)), np.zeros(lost)) + noise(seed))


# From the lower half of the reflected wave's flank to the end of its window: what follows came too early.
@pytest.mark.parametrize("after_psw_s", [45e-6, 60e-6, 75e-6, 90e-6])
def test_samples_lost_behind_the_reflected_wave_show_by_what_follows(after_psw_s):
    odd = closed_up(after_psw_s)
    assert flags_of([*clean(9), odd]) == [()] * 9 + [("disturbed",)]


def test_noise_is_no_cut():
    """At 16 dB the noise behind the reflected wave is as large as what a cut leaves there."""
    assert not any("disturbed" in flags for flags in flags_of(clean(40, 40, noise_fraction=0.15)))


def test_waves_after_the_reflected_wave_may_scatter():
    delays_s = 170e-6 + 1e-6 * np.array([-9, -7, -5, -3, -1, 1, 3, 5, 7, 9])
    assert flags_of([clean(1, k, ssw_delay_s=delay_s)[0] for k, delay_s in enumerate(delays_s)]) == [()] * 10


def test_waves_after_the_reflected_wave_may_scatter_widely():
    """Height by half and arrival by 20 us: no shot of such a set is odd because it looks like a cut."""
    parts = np.array([-1.6, -1.0, -0.7, -0.4, -0.1, 0.1, 0.4, 0.7, 1.0, 1.6])
    random = np.random.default_rng(0)
    heights = SCENE.ssw_fraction * np.exp(0.5 * random.permutation(parts))
    delays_s = SCENE.ssw_delay_s + 20e-6 * random.permutation(parts)
    shots = [
        clean(1, k, ssw_fraction=height, ssw_delay_s=delay_s)[0]
        for k, (height, delay_s) in enumerate(zip(heights, delays_s, strict=True))
    ]
    assert flags_of(shots) == [()] * 10


# A lower wave, and one that comes 20 us earlier: a cut of 40 us explains a part of it.
@pytest.mark.parametrize("change", [{"ssw_fraction": 0.04}, {"ssw_delay_s": 150e-6}])
def test_another_wave_after_the_reflected_one_is_not_a_cut(change):
    assert flags_of([*clean(9), *clean(1, 30, **change)]) == [()] * 10


@pytest.mark.parametrize("odd", [limited(hard, 0.95), closed_up(60e-6)], ids=["limited", "closed up"])
def test_too_few_shots_have_no_middle(odd):
    assert flags_of([*clean(FEWEST - 2), odd])[-1] == ()
    assert flags_of([*clean(FEWEST - 1), odd])[-1] != ()


def bridged(after_isw_s, how):
    volts = SCENE.volts(99)
    first = round((SCENE.isw_time_s + after_isw_s) * SCENE.rate_hz) + SCENE.pretrigger_samples
    last = first + round(LOST_S * SCENE.rate_hz)
    volts[first:last] = how(volts[first - 1], volts[last], last - first)
    return volts


CODE_V = 20.0 / 4096  # noise of 30 codes


@pytest.mark.parametrize("counted", [False, True])
@pytest.mark.parametrize("after_isw_s", [-20e-6, 150e-6, 320e-6, 600e-6])
def test_a_line_drawn_through_lost_samples_is_disturbed(after_isw_s, counted):
    volts = bridged(after_isw_s, np.linspace)
    if counted:
        volts = np.round(volts / CODE_V) * CODE_V
    assert "disturbed" in extracted(volts).flags


def test_lines_are_not_sought_where_noise_is_less_than_a_code():
    quiet = SCENE.with_(noise_fraction=1e-4)
    volts = np.round(quiet.volts(1) / CODE_V) * CODE_V
    assert extracted(volts).flags == ()


def test_a_straight_flank_of_a_drawn_wave_is_a_wave():
    """A slow one, noise as at 60 dB: more than a code of volts."""
    slow = SCENE.with_(noise_fraction=1e-3)
    time_s = slow.time_s()
    volts = slow.volts(2) + 0.02 * slow.isw_v * cos4(time_s, 900e-6, 400e-6)
    assert extracted(volts).flags == ()
