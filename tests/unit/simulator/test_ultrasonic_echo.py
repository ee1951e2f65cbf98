"""Pulse-echo records: arrival, multiples, attenuation."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.scenario import EchoParameters
from simulator.transduction import counts_of
from simulator.ultrasonic_echo import echo_calibration, echo_volts, travel_time_s

ECHO = EchoParameters()
PRISTINE_M = 6.35e-3


def lag_s(record, reference):
    """Delay of one record against another: maximum of their correlation, refined by a parabola."""
    r = np.correlate(record, reference, mode="full")
    k = int(np.argmax(r))
    shift = 0.5 * (r[k - 1] - r[k + 1]) / (r[k - 1] - 2.0 * r[k] + r[k + 1])
    return (k - (reference.size - 1) + shift) / ECHO.sample_rate_hz


def first_back_wall(volts, thickness_m):
    """The record around the first back-wall echo alone, on the same time axis."""
    half_s = 0.9 * thickness_m / ECHO.velocity_m_per_s
    t = np.arange(volts.size) / ECHO.sample_rate_hz
    return np.where(np.abs(t - travel_time_s(thickness_m, ECHO)) < half_s, volts, 0.0)


@pytest.mark.parametrize("thickness_m", [6.35e-3, 5.0e-3, 4.2e-3, 3.8e-3])
@pytest.mark.parametrize("noise_v", [0.0, 0.0025])
def test_a_plain_correlation_recovers_the_travel_time(thickness_m, noise_v):
    random = np.random.default_rng(1)
    calibration = echo_calibration(ECHO)

    def record(thickness):
        volts = echo_volts(thickness, ECHO) + noise_v * random.standard_normal(ECHO.record_samples)
        return calibration.volts(counts_of(volts, calibration))

    now, initial = record(thickness_m), record(PRISTINE_M)
    change_s = lag_s(first_back_wall(now, thickness_m), first_back_wall(initial, PRISTINE_M))
    expected_s = 2.0 * (thickness_m - PRISTINE_M) / ECHO.velocity_m_per_s
    # The parabola through a 5 MHz correlation sampled at 100 MHz errs by up to 0.05 ns; noise at 46 dB
    # by some 0.1 ns (bound: 1 / (2 pi f SNR sqrt(n)) with 60 samples), four times that allowed.
    assert now.size == ECHO.record_samples
    assert change_s == pytest.approx(expected_s, abs=0.06e-9 if noise_v == 0.0 else 0.5e-9)


def test_travel_time_is_equation_17s():
    assert travel_time_s(PRISTINE_M, ECHO) == pytest.approx(8e-6 + 2 * 6.35e-3 / 5900.0, rel=1e-15)


def envelope_peak_v(volts, time_s):
    """Largest excursion within a quarter of a microsecond of a time."""
    centre = round(time_s * ECHO.sample_rate_hz)
    return float(np.max(np.abs(volts[centre - 25 : centre + 26])))


def test_multiples_follow_at_the_round_trip_and_fade():
    echo = replace(ECHO, front_wall_v=0.0)
    volts = echo_volts(PRISTINE_M, echo)
    round_trip_s = 2.0 * PRISTINE_M / ECHO.velocity_m_per_s
    peaks = [envelope_peak_v(volts, echo.delay_s + k * round_trip_s) for k in (1, 2, 3, 4)]
    loss = 10.0 ** (-echo.attenuation_db_per_m * 2.0 * PRISTINE_M / 20.0)
    expected = [echo.back_wall_v * loss * (echo.multiple_ratio * loss) ** k for k in range(4)]
    # The carrier's crest falls between samples by at most half a sample: 1 - cos(pi / 20) = 1.2 %.
    np.testing.assert_allclose(peaks, expected, rtol=0.013)


def test_attenuation_grows_with_the_path():
    none = replace(ECHO, attenuation_db_per_m=0.0, multiple_ratio=0.0, front_wall_v=0.0)
    strong = replace(none, attenuation_db_per_m=500.0)
    for thickness_m in (3e-3, 6e-3):
        ratio = np.max(np.abs(echo_volts(thickness_m, strong))) / np.max(
            np.abs(echo_volts(thickness_m, none))
        )
        assert 20.0 * np.log10(ratio) == pytest.approx(-500.0 * 2.0 * thickness_m, rel=1e-9)


def test_the_front_wall_is_small_inverted_and_at_the_delay():
    volts = echo_volts(PRISTINE_M, ECHO)
    k = round(ECHO.delay_s * ECHO.sample_rate_hz)
    assert volts[k] == pytest.approx(-ECHO.front_wall_v, rel=1e-3)
    assert np.all(volts[: k - 100] == 0.0)


def test_bandwidth_is_the_one_asked_for():
    alone = replace(ECHO, multiple_ratio=0.0, front_wall_v=0.0)
    volts = echo_volts(PRISTINE_M, alone)
    n = 1 << 16
    spectrum = np.abs(np.fft.rfft(volts, n))
    frequency_hz = np.fft.rfftfreq(n, 1.0 / ECHO.sample_rate_hz)
    band = frequency_hz[spectrum >= 0.5 * spectrum.max()]
    # One line of the zero-padded spectrum is 1.5 kHz wide; two at each end.
    assert band[-1] - band[0] == pytest.approx(ECHO.bandwidth_fraction * ECHO.centre_frequency_hz, abs=6.2e3)
    assert 0.5 * (band[0] + band[-1]) == pytest.approx(ECHO.centre_frequency_hz, abs=6.2e3)


def test_no_wall_no_echo():
    with pytest.raises(ValueError, match=r"thickness_m is 0\.0 m"):
        echo_volts(0.0, ECHO)
