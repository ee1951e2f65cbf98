"""The features of a shot are the same to the last bit with any other shots."""

import numpy as np
import pytest
from support.synthetic_records import cos4

from analysis.errors import RecordError
from analysis.waves.features import RECORDS_AT_ONCE, extract_all, extract_features
from hardware_drivers.measurement import Calibration, Waveform

CALIBRATION = Calibration(coefficients_v=np.array([1.2e-3, 1.6e-4]), resolution_bits=16, range_v=5.0)


def record(tof_s=350e-6, psw_v=1.2, samples=13_000, pretrigger=1000, seed=1, rate_hz=10e6):
    time_s = (np.arange(samples) - pretrigger) / rate_hz
    volts = 2.5 * cos4(time_s, 50e-6) + psw_v * cos4(time_s, 50e-6 + tof_s)
    volts += 0.02 * np.random.default_rng(seed).standard_normal(samples)
    return Waveform(
        counts=np.rint(volts / 1.6e-4).astype(np.int16),
        sample_rate_hz=rate_hz,
        pretrigger_samples=pretrigger,
        calibration=CALIBRATION,
    )


def test_shots_of_all_kinds_have_their_own_features_in_company():
    # Another gate of the autocorrelation, another length, no reflected wave, another trigger, another rate.
    shots = [
        record(seed=1),
        record(seed=2, tof_s=352e-6),
        record(seed=3, tof_s=700e-6),
        record(seed=4, samples=16_384),
        record(seed=5, psw_v=0.0),
        record(seed=6, pretrigger=1500),
        record(seed=7, rate_hz=9e6),
    ]
    together = extract_all(shots)
    assert [repr(one) for one in together] == [repr(extract_features(shot)) for shot in shots]
    assert ["no_psw" in one.flags for one in together] == [False] * 4 + [True, False, False]
    assert len({one.tof_ac_s for one in together[:4]}) == 4


def test_more_shots_than_are_taken_at_once_keep_their_order():
    shots = [record(seed=k, tof_s=350e-6 + 1e-6 * (k % 3)) for k in range(RECORDS_AT_ONCE + 2)]
    together = extract_all([*shots, shots[0]])
    for k in (0, RECORDS_AT_ONCE - 1, RECORDS_AT_ONCE, RECORDS_AT_ONCE + 1):
        assert repr(together[k]) == repr(extract_features(shots[k]))
    assert repr(together[-1]) == repr(together[0])


def test_no_shots_have_no_features():
    assert extract_all([]) == []


def test_a_record_that_is_too_short_is_named():
    with pytest.raises(RecordError, match="record longer"):
        extract_all([record(), record(samples=3000)])
