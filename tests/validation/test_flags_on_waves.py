"""Waves that are not a transducer's own, as `benchmarks/flags_on_waves.py` draws them: each is flagged.

The benchmark prints at least 95 % of 300; of 30 seeded records three may pass.
"""

import numpy as np
import pytest
from support.benchmark_modules import benchmark_module

from analysis.waves.template import Template, compare_with_template

N_RECORDS, SEED = 30, 1
FAULTS = [
    "hole",
    "weak",
    "saturated",
    "second_strike",
    "knock",
    "foreign_alone",
    "foreign_before",
    "foreign_on_the_psw",
    "foreign_anywhere",
    "lost_and_zero",
    "lost_and_held",
    "broken_off",
    "lost_and_bridged",
    "lost_and_closed_up",
]


@pytest.fixture(scope="module")
def benchmark():
    return benchmark_module("flags_on_waves")


@pytest.mark.parametrize("snr_db", [20.0, 40.0])
@pytest.mark.parametrize("name", FAULTS)
def test_each_foreign_wave_is_flagged(benchmark, name, snr_db):
    flagged, bad = benchmark.flag_rates(getattr(benchmark, name), "cos4", snr_db, N_RECORDS, SEED)
    assert flagged >= bad >= 0.9


@pytest.mark.parametrize("name", ["cut_at_95", "bent_to_90"])
def test_a_small_limit_is_flagged_from_30_db_on(benchmark, name):
    """At 20 dB what it takes from the top is 3 to 6 standard deviations of the noise: 65 to 85 %."""
    flagged, bad = benchmark.flag_rates(getattr(benchmark, name), "cos4", 30.0, N_RECORDS, SEED)
    assert flagged >= bad >= 0.9


@pytest.mark.parametrize("snr_db", [20.0, 40.0])
@pytest.mark.parametrize("shape", ["cos4", "sech2"])
def test_waves_of_the_transducer_are_not_flagged(benchmark, shape, snr_db):
    flagged, _ = benchmark.flag_rates(benchmark.Scene.clean, shape, snr_db, N_RECORDS, SEED)
    # Of 600 at 20 dB half a percent: more than two of 30 are once in a thousand seeds.
    assert flagged <= (0.07 if snr_db == 20.0 else 0.02)


@pytest.mark.parametrize(("noise_ends_hz", "snr_db"), [(1e6, 20.0), (500e3, 30.0), (200e3, 30.0)])
def test_waves_of_the_transducer_in_coloured_noise_are_not_flagged(benchmark, noise_ends_hz, snr_db):
    clean = benchmark.Scene.clean
    flagged, _ = benchmark.flag_rates(clean, "cos4", snr_db, N_RECORDS, SEED, noise_ends_hz=noise_ends_hz)
    # Up to 2 % of 300 are: more than three of 30 are once in 300 seeds.
    assert flagged <= 0.1


@pytest.mark.parametrize("name", ["second_strike", "knock", "foreign_before"])
def test_each_foreign_wave_in_coloured_noise_is_flagged(benchmark, name):
    """Limits that noise widens are no blind eye."""
    flagged, bad = benchmark.flag_rates(
        getattr(benchmark, name), "cos4", 30.0, N_RECORDS, SEED, noise_ends_hz=5e5
    )
    assert flagged >= bad >= 0.9


def test_a_foreign_pulse_alone_is_seldom_like_the_own_wave_of_a_hole(benchmark):
    """Only one that has the own wave's width, height and smoothness can be."""
    random = benchmark.np.random.default_rng(SEED)
    own = Template(isw_fwhm_s=benchmark.FWHM_S, isw_amplitude_v=1.0)
    holes = 0
    for _ in range(200):
        pulse = random.uniform(0.1, 1.2) * benchmark.SHAPES["gauss"](
            (benchmark.TIME_S - 45e-6) / random.uniform(30e-6, 150e-6)
        )
        volts = pulse + 0.01 * random.standard_normal(pulse.size)
        holes += "no_psw" in compare_with_template(benchmark._extract_features(volts), own).flags
    # 12 % of the width to both sides of 120 us, .35 of the height and more: one in ten.
    assert holes <= 30


@pytest.mark.parametrize("snr_db", [20.0, 40.0])
def test_a_soft_limit_is_detected_from_one_record_by_its_height_and_width(benchmark, snr_db):
    def bent_to_70(scene):
        """Limit softly, as tanh: the top falls to .7 of the wave."""
        return scene.noisy(0.85 * scene.height * np.tanh(scene.wave(scene.isw_s) / 0.85))

    flagged, _ = benchmark.flag_rates(bent_to_70, "cos4", snr_db, N_RECORDS, SEED, walls="alone")
    assert flagged >= 0.9
    clean, _ = benchmark.flag_rates(benchmark.Scene.clean, "cos4", snr_db, N_RECORDS, SEED, walls="alone")
    assert clean == 0.0
