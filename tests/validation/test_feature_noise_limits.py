"""Scatter of the features at 40 dB against the Cramer-Rao bound, and bias against the noise-free record."""

import math

import numpy as np
import pytest
from support.synthetic_records import Scene, cos4

from analysis.waves.features import ALL_FEATURE_NAMES, extract_from_volts

N_RECORDS = 400
SCENE = Scene(noise_fraction=0.01)


def spread_error(n):
    """Relative standard error of a standard deviation from n normal values."""
    return 1.0 / math.sqrt(2.0 * (n - 1))


def bound_s(scene):
    """Cramer-Rao bound of the time of flight: pulse shape known; delay, amplitude and offset free.

    The derivative of a symmetric pulse is orthogonal to pulse and offset, so they cost nothing.
    """
    slope = np.gradient(cos4(scene.time_s(), scene.isw_time_s, scene.width_s), 1.0 / scene.rate_hz)
    energy = float(slope @ slope)
    return scene.noise_fraction / math.sqrt(energy) * math.sqrt(1.0 + 1.0 / scene.amplitude_ratio**2)


def extracted(scene, n):
    shots = [
        extract_from_volts(scene.volts(seed), scene.rate_hz, scene.pretrigger_samples, with_sd=True)
        for seed in range(n)
    ]
    assert all(shot.flags == () for shot in shots)
    return shots


@pytest.fixture(scope="module")
def shots():
    return extracted(SCENE, N_RECORDS)


@pytest.fixture(scope="module")
def table(shots):
    return {name: np.array([getattr(shot, name) for shot in shots]) for name in ALL_FEATURE_NAMES}


def test_matched_filter_reaches_the_bound(table):
    bound = bound_s(SCENE)
    assert 36e-9 < bound < 39e-9
    spread = np.std(table["tof_mf_s"], ddof=1)
    # An estimator this near the bound may fall below it by the SD's own error only.
    assert bound * (1 - 4 * spread_error(N_RECORDS)) < spread < 39e-9 * (1 + 4 * spread_error(N_RECORDS))


@pytest.mark.parametrize("snr_db", [20, 40])
def test_each_feature_reports_its_own_standard_deviation(shots, snr_db):
    found = shots if snr_db == 40 else extracted(SCENE.with_(noise_fraction=0.1), 200)
    for name in ALL_FEATURE_NAMES:
        deviations = [shot.sd[name] for shot in found if name in shot.sd]
        if (snr_db, name) == (20, "ssw_time_s"):
            assert not deviations  # a wave of .8 of the noise's rms has no time of first order
            continue
        scatter = np.std([getattr(shot, name) for shot in found], ddof=1)
        assert len(deviations) >= 0.95 * len(found)  # noise may give a small SSW two tops
        # First order, pulses taken as cos^4: 25 %, of which 200 records' own error of an SD is 5.
        assert 0.8 < np.median(deviations) / scatter < 1.25, name


def test_autocorrelation_is_as_quiet_and_peaks_by_quartic_less(table):
    room = 4 * spread_error(N_RECORDS)
    # Reference study: .04 us and .09-.11 us.
    assert np.std(table["tof_ac_s"], ddof=1) < 0.04e-6 * (1 + room)
    assert 0.09e-6 * (1 - room) < np.std(table["tof_pp_s"], ddof=1) < 0.11e-6 * (1 + room)


def test_noise_biases_no_feature(table):
    clean = SCENE.with_(noise_fraction=0.0)
    truth = extract_from_volts(clean.volts(), clean.rate_hz, clean.pretrigger_samples)
    for name, values in table.items():
        if name == "noise_rms_v":
            continue
        error = np.std(values, ddof=1) / math.sqrt(N_RECORDS)
        # The quartic's window is chosen on the noisy record: up to 10 ns and 1e-4 of height, as for
        # clean ones; 60 ns where a small SSW or a flank is read off it.
        bias = {"s": 10e-9, "v": 1e-4 * SCENE.isw_v}.get(name.rsplit("_", 1)[-1], 2e-4)
        if name in ("isw_fwhm_s", "ssw_time_s"):
            bias = 60e-9
        assert abs(values.mean() - getattr(truth, name)) < 4 * error + bias, name


@pytest.mark.parametrize(("snr_db", "factor"), [(30, 10**0.5), (50, 10**-0.5)])
def test_scatter_follows_the_noise(table, snr_db, factor):
    scene = SCENE.with_(noise_fraction=10 ** (-snr_db / 20))
    picks = [
        extract_from_volts(scene.volts(seed), scene.rate_hz, scene.pretrigger_samples).tof_mf_s
        for seed in range(200)
    ]
    expected = factor * np.std(table["tof_mf_s"], ddof=1)
    assert np.std(picks, ddof=1) == pytest.approx(
        expected, rel=4 * (spread_error(200) + spread_error(N_RECORDS))
    )


def test_resolution_of_twelve_bits_is_enough():
    step_v = 20.0 / 4096
    picks = []
    for seed in range(200):
        volts = np.round(SCENE.volts(seed) / step_v) * step_v
        picks.append(extract_from_volts(volts, SCENE.rate_hz, SCENE.pretrigger_samples).tof_mf_s)
    # Noise of 10 codes hides the steps: the same SD within its own error.
    assert np.std(picks, ddof=1) == pytest.approx(bound_s(SCENE), rel=4 * spread_error(200) + 0.05)
