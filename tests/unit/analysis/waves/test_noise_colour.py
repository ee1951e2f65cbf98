"""Standard deviations of features where the noise is not white, against their scatter."""

import numpy as np
import pytest
from support.synthetic_records import FWHM_S, Scene, band_limited

from analysis.waves.features import extract_from_volts
from analysis.waves.noise_colour import find_noise_colour, strongest_block_noise_v
from analysis.waves.record_reduction import ExtractionSettings, VoltRecord, reduce_records

SCENE = Scene(noise_fraction=0.0)
NOISE = 0.01
MOST_LISTED = (
    "tof_mf_s",
    "tof_pp_s",
    "tof_ac_s",
    "amplitude_ratio",
    "isw_amplitude_v",
    "isw_fwhm_s",
    "psw_area_v_s",
)


def shots(rate_hz, ends_hz, n):
    scene = SCENE.with_(
        rate_hz=rate_hz,
        n_samples=round(SCENE.n_samples * rate_hz / SCENE.rate_hz),
        pretrigger_samples=round(SCENE.pretrigger_samples * rate_hz / SCENE.rate_hz),
    )
    clean = scene.volts()
    noisy = (clean + NOISE * scene.isw_v * band_limited(clean.size, rate_hz, ends_hz, k) for k in range(n))
    return [extract_from_volts(volts, rate_hz, scene.pretrigger_samples, with_sd=True) for volts in noisy]


@pytest.mark.parametrize(
    ("rate_hz", "ends_hz", "within"),
    # 150 records give a scatter within 6 %, and first order is good to 10; a band inside that of the block
    # means is found by few coefficients of each record, in some not at all.
    [(20e6, 5e6, 0.2), (20e6, 2e6, 0.2), (10e6, 100e3, 0.3)],
)
def test_noise_that_ends_in_band_is_estimated_from_its_slow_part(rate_hz, ends_hz, within):
    found = shots(rate_hz, ends_hz, 150)
    for name in MOST_LISTED:
        scatter = np.std([getattr(shot, name) for shot in found], ddof=1)
        assert np.median([shot.sd[name] for shot in found]) == pytest.approx(scatter, rel=within), name


def reduced(volts, scene, settings):
    return reduce_records([VoltRecord(volts, scene.rate_hz, scene.pretrigger_samples)], settings)[0]


def colour(volts, scene, isw_time_s):
    settings = ExtractionSettings()
    record = reduced(volts, scene, settings)
    return find_noise_colour(record, isw_time_s, settings.isw_fwhm_s), record


def test_white_noise_has_no_autocorrelation():
    scene = SCENE.with_(noise_fraction=NOISE)
    found = [colour(scene.volts(seed), scene, scene.isw_time_s)[0] for seed in range(40)]
    white2 = (NOISE * scene.isw_v) ** 2
    # 1,300 blocks of each of 40 records: 1 % of a standard deviation, 2 % of a variance.
    assert np.median([one.slow2 for one in found]) == pytest.approx(white2 / 10, rel=0.06)
    assert np.median([one.sample2 for one in found]) == pytest.approx(white2, rel=0.06)
    assert np.median([one.memory for one in found]) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("isw_time_s", [float("nan"), SCENE.isw_time_s - 65e-6])
def test_noise_colour_uses_the_whole_record_when_the_pretrigger_is_not_quiet(isw_time_s):
    """As one with a short pre-trigger: nothing of the wave's flank counts as noise."""
    scene = SCENE.with_(noise_fraction=NOISE)
    found, record = colour(scene.volts(1), scene, isw_time_s)
    assert found.slow2 == found.flank2 == found.block2
    assert found.sample2 == record.noise_rms_v**2
    # Third differences of 1,300 blocks: 5 % of the SD.
    assert found.slow2 == pytest.approx((NOISE * scene.isw_v) ** 2 / 10, rel=0.3)


def test_the_foot_of_a_wave_is_no_noise():
    """A sech^2 pulse is at 5 % of its height where the quiet stretch ends: five times this noise."""
    scene = SCENE.with_(noise_fraction=0.0)
    time_s = scene.time_s()
    wave = 1.0 / np.cosh(np.clip(1.7627 * (time_s - scene.isw_time_s) / 64.7e-6, -50.0, 50.0)) ** 2
    volts = scene.isw_v * (wave + NOISE * np.random.default_rng(3).standard_normal(time_s.size))
    found, _ = colour(volts, scene, scene.isw_time_s)
    assert found.slow2 == pytest.approx((NOISE * scene.isw_v) ** 2 / 10, rel=0.3)


def test_a_record_without_noise_has_nearly_none():
    """What a cos^4 pulse has of its first microseconds before the quiet stretch ends: below 70 dB."""
    found, _ = colour(SCENE.volts(), SCENE, SCENE.isw_time_s)
    assert 0.0 < found.slow2 < (3e-4 * SCENE.isw_v) ** 2 / 10


def strongest(volts):
    record = reduced(volts, SCENE, ExtractionSettings())
    return record.block_noise_v, strongest_block_noise_v(record, SCENE.isw_time_s, FWHM_S)


@pytest.mark.parametrize(
    ("ends_hz", "within"),
    # Third differences of 1,300 means of 1 us, most of whose power lies at 300 to 500 kHz, and a median of
    # twelve coefficients: 30 % of a variance of 100 records' middle.
    [(5e6, 0.1), (1e6, 0.15), (500e3, 0.25), (100e3, 0.25)],
)
def test_the_strongest_noise_is_as_strong_as_white_noise_in_the_waves_band(ends_hz, within):
    clean = SCENE.volts()
    found = [
        strongest(clean + NOISE * SCENE.isw_v * band_limited(clean.size, SCENE.rate_hz, ends_hz, k))
        for k in range(100)
    ]
    expected = NOISE * SCENE.isw_v / np.sqrt(2.0 * ends_hz * 1e-6)
    assert np.median([slow for _, slow in found]) == pytest.approx(expected, rel=within)
    if ends_hz >= 500e3:
        assert np.median([fine for fine, _ in found]) == pytest.approx(expected, rel=within)


def test_a_knock_is_no_noise():
    """One of .2 of the wave that rings before it, at 8 kHz: means over 10 us would scatter by .1."""
    since_s = SCENE.time_s() + 60e-6
    ringing = np.where(since_s > 0.0, np.sin(2.0 * np.pi * 8e3 * since_s), 0.0)
    volts = SCENE.with_(noise_fraction=NOISE).volts(1) + 0.2 * SCENE.isw_v * ringing
    _, slow = strongest(volts)
    # Five times what white noise of 1 % gives a block mean; a tenth of what the knock would.
    assert slow < 5.0 * NOISE * SCENE.isw_v / np.sqrt(10.0)
