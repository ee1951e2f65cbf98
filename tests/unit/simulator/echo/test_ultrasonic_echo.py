"""Pulse-echo records: arrival, multiples, attenuation, the V-shaped path, bubbles."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.echo.far_wall import build_smooth_wall
from simulator.echo.pulse import (
    SALT_WATER_VELOCITY_M_PER_S,
    STEEL_REFLECTION,
    simulate_bubbles,
    simulate_echo,
    travel_time_s,
    warm_probe_and_wall,
)
from simulator.parameters.echo import EchoParameters

ECHO = EchoParameters(
    element_separation_m=0.0, roughness_fraction=0.0, velocity_per_k=0.0, bubble_probability=0.0
)
PRISTINE_M = 6.35e-3


def test_travel_time_is_equation_17s():
    assert travel_time_s(PRISTINE_M, ECHO) == pytest.approx(8e-6 + 2 * 6.35e-3 / 5900.0, rel=1e-15)


def envelope_peak_v(volts, time_s):
    """Largest excursion within a quarter of a microsecond of a time."""
    centre = round(time_s * ECHO.sample_rate_hz)
    return float(np.max(np.abs(volts[centre - 25 : centre + 26])))


def test_multiples_follow_at_the_round_trip_and_fade():
    echo = replace(ECHO, front_wall_v=0.0)
    volts = simulate_echo(PRISTINE_M, echo)
    round_trip_s = 2.0 * PRISTINE_M / ECHO.velocity_m_per_s
    peaks = [envelope_peak_v(volts, echo.delay_s + k * round_trip_s) for k in (1, 2, 3, 4)]
    loss = 10.0 ** (-echo.attenuation_db_per_m * 2.0 * PRISTINE_M / 20.0)
    expected = [echo.back_wall_v * loss * (echo.multiple_ratio * loss) ** k for k in range(4)]
    # The carrier's crest falls between samples by at most half a sample: 1 - cos(pi / 20) = 1.2 %.
    np.testing.assert_allclose(peaks, expected, rtol=0.013)


def test_the_front_wall_is_small_inverted_and_at_the_delay():
    volts = simulate_echo(PRISTINE_M, ECHO)
    k = round(ECHO.delay_s * ECHO.sample_rate_hz)
    assert volts[k] == pytest.approx(-ECHO.front_wall_v, rel=1e-3)
    assert np.all(volts[: k - 100] == 0.0)


def test_bandwidth_is_the_one_asked_for():
    alone = replace(ECHO, multiple_ratio=0.0, front_wall_v=0.0)
    volts = simulate_echo(PRISTINE_M, alone)
    n = 1 << 16
    spectrum = np.abs(np.fft.rfft(volts, n))
    frequency_hz = np.fft.rfftfreq(n, 1.0 / ECHO.sample_rate_hz)
    band = frequency_hz[spectrum >= 0.5 * spectrum.max()]
    # One line of the zero-padded spectrum is 1.5 kHz wide; two at each end.
    assert band[-1] - band[0] == pytest.approx(ECHO.bandwidth_fraction * ECHO.centre_frequency_hz, abs=6.2e3)
    assert 0.5 * (band[0] + band[-1]) == pytest.approx(ECHO.centre_frequency_hz, abs=6.2e3)


def test_no_wall_no_echo():
    with pytest.raises(ValueError, match=r"thickness_m is 0\.0 m"):
        simulate_echo(0.0, ECHO)


def envelope(volts):
    """Modulus of the analytic signal."""
    n = volts.size
    spectrum = np.fft.fft(volts)
    spectrum[1 : n // 2] *= 2.0
    spectrum[n // 2 + 1 :] = 0.0
    return np.abs(np.fft.ifft(spectrum))


@pytest.mark.parametrize("separation_m", [1e-3, 2.7e-3, 6e-3])
def test_the_way_between_two_elements_is_a_v(separation_m):
    echo = replace(ECHO, element_separation_m=separation_m, front_wall_v=0.0)
    volts = envelope(simulate_echo(3.8e-3, echo))
    for times in (1, 2, 3):
        arrival_s = echo.delay_s + np.hypot(2.0 * times * 3.8e-3, separation_m) / echo.velocity_m_per_s
        centre = round(arrival_s * echo.sample_rate_hz)
        # The envelope's top is flat: neighbour echoes tilt it by some 10 ns, a sample.
        assert abs(centre - 30 + np.argmax(volts[centre - 30 : centre + 31]) - centre) <= 2
    assert travel_time_s(3.8e-3, echo) == pytest.approx(
        8e-6 + np.sqrt(4.0 * 3.8e-3**2 + separation_m**2) / 5900.0, rel=1e-15
    )


@pytest.mark.parametrize("thickness_m", [6.35e-3, 3e-3, 1.5e-3])
@pytest.mark.parametrize("separation_m", [0.0, 2.7e-3])
def test_facets_of_one_thickness_give_the_pulses_drawn_one_by_one(thickness_m, separation_m):
    echo = replace(ECHO, element_separation_m=separation_m)
    drawn, summed = simulate_echo(thickness_m, echo), simulate_echo(build_smooth_wall(thickness_m), echo)
    # Sharing an arrival between two points of the grid: (2 pi / 320)^2 / 8 = 5e-5 of an echo's peak.
    np.testing.assert_allclose(summed, drawn, atol=1e-4 * echo.back_wall_v)


@pytest.mark.parametrize("exponent", [1.0, 4.0])
def test_attenuation_grows_with_its_power_of_the_frequency(exponent):
    echo = replace(
        ECHO, attenuation_db_per_m=300.0, attenuation_exponent=exponent, multiple_ratio=0.0, front_wall_v=0.0
    )
    near, far = (np.fft.rfft(simulate_echo(th, echo)) for th in (3e-3, 6e-3))
    frequency_hz = np.fft.rfftfreq(ECHO.record_samples, 1.0 / ECHO.sample_rate_hz)
    band = np.abs(frequency_hz - 5e6) < 2e6
    lost_db = -20.0 * np.log10(np.abs(far[band] / near[band]))
    expected_db = 300.0 * (frequency_hz[band] / 5e6) ** exponent * 6e-3
    # The arrival's sharing costs up to 5e-5 of the peak, .02 dB where the pulse has fallen to a fiftieth.
    np.testing.assert_allclose(lost_db, expected_db, atol=0.03)


def test_a_warmer_wall_sends_its_echo_later_by_the_gauges_coefficient():
    echo = replace(ECHO, velocity_per_k=-1.8e-4, delay_per_k=1e-3)
    warm = warm_probe_and_wall(echo, 10.0)
    assert warm.delay_s == pytest.approx(8.08e-6, rel=1e-12)
    assert travel_time_s(PRISTINE_M, warm) == pytest.approx(8.08e-6 + 12.7e-3 / (5900.0 * 0.9982), rel=1e-12)
    assert warm_probe_and_wall(echo, 0.0) == echo


def test_bubbles_follow_the_wall_echo_with_the_given_rate_and_strength():
    echo = replace(ECHO, bubbles_per_beam=3.0)
    records = simulate_bubbles(5e-3, echo, np.random.default_rng(0), 400)
    seen = np.abs(records) > 0.0
    first, last = np.flatnonzero(seen.any(axis=0))[[0, -1]] / echo.sample_rate_hz
    # Nothing before the first back-wall echo, less the pulse's half length of .9 us.
    assert first > travel_time_s(5e-3, echo) - 1e-6
    assert last < travel_time_s(5e-3, echo) + 2.0 * echo.liquid_depth_m / SALT_WATER_VELOCITY_M_PER_S + 1e-6
    # A record without a bubble: exp(-3) = 5 % of them; all but 1e-4 of the counts lie within 3.9 SD.
    none = np.count_nonzero(~seen.any(axis=1))
    assert abs(none - 400 * np.exp(-3.0)) < 3.9 * np.sqrt(400 * np.exp(-3.0))
    # The mean square is that of shot noise: rate x E[height^2] x the pulse's energy. The sensitivity is
    # 16^-u with u even, so its mean square is (1 - 16^-2) / (2 ln 16).
    spot_m2 = np.pi * echo.beam_diameter_m**2 / (4.0 * np.log(2.0))
    loss = 10.0 ** (-echo.attenuation_db_per_m * 10e-3 / 20.0)
    through = (1.0 - STEEL_REFLECTION**2) / STEEL_REFLECTION
    height_v = 0.5 * loss * through * 1e-3 * (SALT_WATER_VELOCITY_M_PER_S / 5e6) / (2.0 * spot_m2)
    pulse = simulate_echo(3e-3, replace(ECHO, multiple_ratio=0.0, front_wall_v=0.0, attenuation_db_per_m=0.0))
    energy = float(pulse @ pulse) / 0.5**2
    # Those whose echo starts after the record's end are not in it.
    within = (20.48e-6 - travel_time_s(5e-3, echo)) * SALT_WATER_VELOCITY_M_PER_S / 2.0 / echo.liquid_depth_m
    expected = 3.0 * min(within, 1.0) * height_v**2 * (1.0 - 16.0**-2) / (2.0 * np.log(16.0)) * energy
    # 1,200 bubbles, of heights whose square scatters by 1.3 of its mean: 4 % each SD, four of them.
    assert (records**2).sum(axis=1).mean() == pytest.approx(expected, rel=0.16)
