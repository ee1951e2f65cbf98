"""Stretches of equal samples: lost where noise would have moved them, natural where it is below a code."""

import numpy as np
import pytest
from support.synthetic_records import Scene, cos4

from analysis.waves.features import extract_from_volts

N_SAMPLES = 13_600


def record(random, bits=16, snr_db=40.0, range_v=2.0):
    """Sound record of a wave of 1 V, and of a converter whose range ends at twice that."""
    scene = Scene(
        isw_v=1.0,
        n_samples=N_SAMPLES,
        isw_time_s=random.uniform(35e-6, 55e-6),
        tof_s=random.uniform(320e-6, 420e-6),
        amplitude_ratio=random.uniform(0.35, 0.6),
        offset_v=random.uniform(-0.02, 0.02),
    )
    volts = scene.volts() + 10.0 ** (-snr_db / 20.0) * random.standard_normal(N_SAMPLES)
    code_v = range_v / 2 ** (bits - 1)
    return np.rint(volts / code_v) * code_v


def flags_of(volts):
    return extract_from_volts(volts, 10e6, 1000).flags


STRETCHES = [
    (3_000, N_SAMPLES),
    (5_000, N_SAMPLES),
    (1_200, N_SAMPLES),  # before the wave
    (300, N_SAMPLES),
    (0, 900),
    (0, 3_000),
    (0, N_SAMPLES - 300),
    (4_000, 6_000),
    (1_450, 1_900),  # from the incident wave's top on
    (9_000, 9_200),
]


@pytest.mark.parametrize("held", [False, True], ids=["zero", "held"])
@pytest.mark.parametrize(("first", "last"), STRETCHES)
@pytest.mark.parametrize(("bits", "snr_db"), [(16, 80.0), (16, 40.0), (12, 60.0), (8, 30.0)])
def test_a_stretch_of_equal_samples_is_lost_wherever_it_begins(bits, snr_db, first, last, held):
    volts = record(np.random.default_rng(1), bits, snr_db)
    volts[first:last] = volts[first] if held else 0.0
    assert flags_of(volts) == ("lost_samples",)


@pytest.mark.parametrize("bits", [8, 12])
def test_noise_of_a_fraction_of_a_code_shows_long_losses(bits):
    """At 8 bits and 40 dB, 12 bits and 64 dB it is .64 of a code: a stretch of 15 us says nothing there."""
    random = np.random.default_rng(2)
    for first in (3_000, 5_000, 9_000):
        volts = record(random, bits, 40.0 if bits == 8 else 64.0)
        volts[first:] = 0.0
        assert flags_of(volts) == ("lost_samples",)


def test_several_lost_blocks_are_lost_samples():
    volts = record(np.random.default_rng(3))
    for first in range(2_000, N_SAMPLES, 2_000):
        volts[first : first + 1_000] = 0.0
    assert flags_of(volts) == ("lost_samples",)


@pytest.mark.parametrize("snr_db", [20, 30, 40, 50, 60, 70, 80])
@pytest.mark.parametrize("bits", [8, 12, 16])
def test_no_clean_record_is_flagged(bits, snr_db):
    random = np.random.default_rng([bits, snr_db])
    assert [flags_of(record(random, bits, snr_db)) for _ in range(15)] == [()] * 15


@pytest.mark.parametrize("snr_db", [40.0, 60.0])
def test_a_sound_wave_of_few_codes_is_not_clipped(snr_db):
    """Of a quarter of the range, at 8 bits: it stays on its last code for .22 of its width."""
    random = np.random.default_rng(8)
    assert [flags_of(record(random, 8, snr_db, range_v=4.0)) for _ in range(12)] == [()] * 12


def test_spikes_are_no_noise_that_a_quiet_stretch_would_show():
    """At 8 bits and 80 dB a quiet level is one code for milliseconds."""
    volts = record(np.random.default_rng(4), 8, 80.0)
    for first in range(1_800, 4_000, 200):
        volts[first : first + 10 : 2] += 0.2
    assert "lost_samples" not in flags_of(volts)


def test_a_quiet_record_between_two_codes_is_whole():
    """Its quiet level changes between them all the time, what follows the waves is one code."""
    volts = record(np.random.default_rng(5), 8, 80.0)
    code_v, random = 2.0 / 128, np.random.default_rng(6)
    volts[:1000] = code_v * random.integers(0, 2, 1000)
    assert "lost_samples" not in flags_of(volts)


def test_a_drawn_wave_without_noise_has_no_lost_samples():
    assert flags_of(cos4((np.arange(N_SAMPLES) - 1000) / 10e6, 50e-6)) == ("no_psw",)


@pytest.mark.parametrize("end", [0.5, 0.7, 0.9])
def test_a_plateau_stays_clipped(end):
    """An amplifier's, with its noise before it."""
    volts = np.minimum(record(np.random.default_rng(7), 16, 60.0), end)
    assert {"clipped", "lost_samples"} & {*flags_of(volts)} == {"clipped"}
    volts[4_000:] = 0.0
    assert flags_of(volts) == ("lost_samples", "clipped")
