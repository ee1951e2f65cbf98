"""How often each fault is flagged in seeded populations at 40 dB, and how often a clean record is."""

import numpy as np
import pytest
from support.synthetic_records import Scene, cos4, waveform_of

from analysis.waves.features import extract_features

N_RECORDS = 100


def scene(random, **changes):
    drawn = Scene(
        noise_fraction=0.01, amplitude_ratio=random.uniform(0.35, 0.6), tof_s=random.uniform(320e-6, 420e-6)
    )
    return drawn.with_(**changes)


def missed(random, seed):
    return 0.05 * random.standard_normal(13_000)


def clipped(random, seed):
    return scene(random, isw_v=random.uniform(10.2, 15.0)).volts(seed)


def no_psw(random, seed):
    return scene(random, amplitude_ratio=0.0, ssw_fraction=0.0).volts(seed)


def inverted(random, seed):
    return -scene(random).volts(seed)


def double(random, seed):
    """A second strike of half to all of the first one's height, 60 to 700 us later."""
    drawn = scene(random)
    t, later_s = drawn.time_s(), drawn.isw_time_s + random.uniform(60e-6, 700e-6)
    second = cos4(t, later_s) + drawn.amplitude_ratio * cos4(t, later_s + drawn.tof_s)
    return drawn.volts(seed) + random.uniform(0.5, 1.0) * drawn.isw_v * second


def psw_merged(random, seed):
    """Another wave of 60 to 100 % of the PSW, 60 to 110 us after it."""
    drawn = scene(random)
    later_s = drawn.isw_time_s + drawn.tof_s + random.uniform(60e-6, 110e-6)
    height = random.uniform(0.6, 1.0) * drawn.amplitude_ratio * drawn.isw_v
    return drawn.volts(seed) + height * cos4(drawn.time_s(), later_s)


def baseline(random, seed):
    """Hum of 50 Hz with 20 % of the ISW: at its crest it hardly moves within 1.3 ms."""
    drawn = scene(random)
    phase = random.uniform(0.0, 2.0 * np.pi)
    return drawn.volts(seed) + 0.2 * drawn.isw_v * np.sin(2 * np.pi * 50.0 * drawn.time_s() + phase)


def noisy(random, seed):
    return scene(random, noise_fraction=0.2).volts(seed)


@pytest.mark.parametrize(
    ("fault", "least"),
    # Seeded, so a rate is one number; the floors are what an operator may rely on.
    [
        (missed, 1.0),
        (clipped, 1.0),
        (no_psw, 1.0),
        (inverted, 1.0),
        (noisy, 1.0),
        (double, 0.96),
        (psw_merged, 0.98),
        (baseline, 0.65),
    ],
)
def test_fault_is_flagged(fault, least):
    random = np.random.default_rng(5)
    found = [
        fault.__name__ in extract_features(waveform_of(fault(random, k))).flags for k in range(N_RECORDS)
    ]
    assert np.mean(found) >= least


@pytest.mark.parametrize("snr_db", [20, 30, 40])
def test_clean_record_is_not_flagged(snr_db):
    random = np.random.default_rng(6)
    drawn = [scene(random, noise_fraction=10 ** (-snr_db / 20)) for _ in range(N_RECORDS)]
    flagged = [extract_features(one.waveform(k)).flags != () for k, one in enumerate(drawn)]
    assert not any(flagged)
