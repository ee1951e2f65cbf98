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


def inverted(random, seed):
    return -scene(random).volts(seed)


def psw_merged(random, seed):
    """Another wave of 60 to 100 % of the PSW, 60 to 110 us after it."""
    drawn = scene(random)
    later_s = drawn.isw_time_s + drawn.tof_s + random.uniform(60e-6, 110e-6)
    height = random.uniform(0.6, 1.0) * drawn.amplitude_ratio * drawn.isw_v
    return drawn.volts(seed) + height * cos4(drawn.time_s(), later_s)


def noisy(random, seed):
    return scene(random, noise_fraction=0.2).volts(seed)


@pytest.mark.parametrize(
    ("fault", "least"),
    # Seeded, so a rate is one number; the floors are what an operator may rely on.
    [
        (missed, 1.0),
        (inverted, 1.0),
        (noisy, 1.0),
        (psw_merged, 0.98),
    ],
)
def test_fault_is_flagged(fault, least):
    random = np.random.default_rng(5)
    found = [
        fault.__name__ in extract_features(waveform_of(fault(random, k))).flags for k in range(N_RECORDS)
    ]
    assert np.mean(found) >= least
