"""Which maximum is the ISW, which the PSW, on forces made up for the purpose."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.errors import NoSolitaryWaveError
from simulator.shot.model import ShotForce
from simulator.shot.pulse_summary import summarise_pulses

STEP_S = 0.5e-6
PRELOAD_N = 0.97


def force_of(*pulses, duration_s=1.4e-3, turn_s=320e-6):
    """Preload and cos^2 pulses of 100 us at (time, height above the preload)."""
    time_s = np.arange(round(duration_s / STEP_S) + 1) * STEP_S
    force_n = np.full(len(time_s), PRELOAD_N)
    for at_s, height_n in pulses:
        phase = np.pi * (time_s - at_s) / 100e-6
        force_n += height_n * np.where(np.abs(phase) < np.pi / 2, np.cos(phase) ** 2, 0.0)
    return ShotForce(
        time_s=time_s,
        force_n=force_n,
        preload_n=PRELOAD_N,
        energy_residual=0.0,
        step_s=STEP_S,
        reflection_time_s=turn_s,
    )


ISW, RIPPLE, PSW, SSW = (160.23e-6, 150.0), (289e-6, 7.0), (498.61e-6, 77.0), (672e-6, 12.0)


def test_peaks_are_interpolated_and_keep_the_preload():
    found = summarise_pulses(force_of(ISW, RIPPLE, PSW, SSW))
    # A parabola through samples 0.5 us apart misses the top of a 100-us cos^2 by its quartic term:
    # (pi dt / T)^4 / 3 of the height, and less than dt / 1000 in time.
    assert found.isw_time_us == pytest.approx(160.23, abs=5e-4)
    assert found.isw_peak_n == pytest.approx(150.97, rel=1e-7)
    assert found.psw_time_us == pytest.approx(498.61, abs=5e-4)
    assert found.psw_peak_n == pytest.approx(77.97, rel=1e-7)
    assert found.tof_us == found.psw_time_us - found.isw_time_us
    assert found.amplitude_ratio == found.psw_peak_n / found.isw_peak_n
    assert found.dynamic_amplitude_ratio == pytest.approx(77.0 / 150.0, rel=2e-7), "without the preload"


def test_ripple_before_the_wave_can_be_back_is_no_reflection():
    found = summarise_pulses(force_of(ISW, (380e-6, 100.0), PSW))  # 380 us < turn + (turn - ISW) / 2 = 400 us
    assert found.psw_time_us == pytest.approx(498.61, abs=5e-4)


def test_weak_ripple_ahead_of_the_psw_is_passed_over():
    assert summarise_pulses(force_of(ISW, (420e-6, 9.0), PSW)).psw_time_us == pytest.approx(498.61, abs=5e-4)


def test_psw_is_the_highest_maximum_of_its_pulse():
    found = summarise_pulses(force_of(ISW, (880e-6, 80.0), (940e-6, 90.0), (1290e-6, 85.0), turn_s=520e-6))
    assert found.psw_time_us == pytest.approx(940.0, abs=5e-1)  # the overlap shifts the crest a little
    assert found.psw_peak_n > 90.0


def test_a_stronger_pulse_apart_from_the_first_strong_one_is_not_the_psw():
    assert summarise_pulses(force_of(ISW, (498e-6, 60.0), (700e-6, 80.0))).psw_time_us == pytest.approx(
        498.0, abs=1e-2
    )


def test_first_of_two_strong_pulses_is_the_isw_even_if_the_reflection_is_stronger():
    found = summarise_pulses(force_of((100e-6, 90.0), (498e-6, 150.0)))
    assert found.isw_time_us == pytest.approx(100.0, abs=5e-4)
    assert found.amplitude_ratio > 1.0


def test_no_reflected_wave_gives_none():
    for force in (force_of(ISW, RIPPLE), force_of(ISW, (600e-6, 5.0)), force_of(ISW, PSW, turn_s=None)):
        found = summarise_pulses(force)
        assert found.isw_peak_n == pytest.approx(150.97, rel=1e-7)
        assert (found.psw_peak_n, found.psw_time_us, found.tof_us, found.amplitude_ratio) == (None,) * 4
        assert found.dynamic_amplitude_ratio is None


def test_a_record_without_isw_is_an_error():
    with pytest.raises(NoSolitaryWaveError, match="within 50 us"):
        summarise_pulses(force_of(duration_s=50e-6))
    with pytest.raises(NoSolitaryWaveError, match="lengthen the record"):
        summarise_pulses(force_of(ISW, duration_s=150e-6))  # still rising at the end


def by_arrays(force):
    """Samples of ISW and PSW, written with arrays of all maxima."""
    height = force.force_n - force.preload_n
    inner = height[1:-1]
    maxima = np.flatnonzero((inner > height[:-2]) & (inner >= height[2:])) + 1
    isw = maxima[height[maxima] >= 0.5 * height.max()][0]
    gate_s = force.reflection_time_s + 0.5 * (force.reflection_time_s - force.time_s[isw])
    late = maxima[force.time_s[maxima] > gate_s]
    if not late.size or height[late].max() < 0.05 * height[isw]:
        return isw, None
    first = late[height[late] >= 0.5 * height[late].max()][0]
    ends = np.flatnonzero(height[first:] < 0.2 * height[late].max())
    pulse = late[(late >= first) & (late < (first + ends[0] if ends.size else len(height)))]
    return isw, pulse[np.argmax(height[pulse])]


def test_one_pass_equals_the_search_in_all_maxima():
    random = np.random.default_rng(5)
    reflected = 0
    for _ in range(300):
        late = [(random.uniform(300e-6, 1380e-6), random.uniform(0.0, 140.0)) for _ in range(4)]
        force = force_of(ISW, *late, turn_s=random.uniform(200e-6, 900e-6))
        if random.random() < 0.5:  # plateaus
            force = replace(force, force_n=PRELOAD_N + np.round(force.force_n - PRELOAD_N))
        isw, psw = by_arrays(force)
        found = summarise_pulses(force)
        # A parabola stays within half a sample of its highest point.
        assert found.isw_time_us == pytest.approx(1e6 * force.time_s[isw], abs=0.501e6 * STEP_S)
        assert (found.psw_time_us is None) == (psw is None)
        if psw is not None:
            reflected += 1
            assert found.psw_time_us == pytest.approx(1e6 * force.time_s[psw], abs=0.501e6 * STEP_S)
    assert 100 < reflected < 300
