"""From force to counts: quantisation, clipping, noise, and where the trigger sits."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from hardware_drivers.measurement import Calibration
from simulator.electronics.transduction import (
    add_noise_volts,
    make_adc_calibration,
    quantise_volts,
    simulate_triggered_record,
)
from simulator.parameters.electronics import AdcParameters, NoiseParameters

ADC = AdcParameters()
CALIBRATION = make_adc_calibration(ADC)
STEP_S = 2e-7
TIME_S = np.arange(7_500) * STEP_S
WIDTH_S = 178e-6
GAIN_V_PER_N = 2.5 / 150.0


def pulse_n(time_s, peak_time_s, peak_n):
    """Solitary pulse in closed form: cos^4 of the width of the paper's transducer."""
    return peak_n * np.cos(np.pi * np.clip((time_s - peak_time_s) / WIDTH_S, -0.5, 0.5)) ** 4


def force_n(time_s=TIME_S, peak_n=150.0):
    return pulse_n(time_s, 160e-6, peak_n) + pulse_n(time_s, 490e-6, 0.5 * peak_n)


def record(force=None, *, gain=GAIN_V_PER_N, adc=ADC, phase=0.0, noise_v=0.0, seed=1):
    return simulate_triggered_record(
        force_step_s=STEP_S,
        dynamic_force_n=force_n() if force is None else force,
        sensor_gain_v_per_n=gain,
        adc=adc,
        calibration=make_adc_calibration(adc),
        sampling_phase=phase,
        noise=NoiseParameters(rms_v=noise_v, slow_rms_v=0.0),
        random=np.random.default_rng(seed),
    )


def record_time_s(found, adc=ADC):
    """Time of each sample from the striker's contact."""
    return (
        found.trigger_time_s + (np.arange(adc.record_samples) - adc.pretrigger_samples) / adc.sample_rate_hz
    )


@pytest.mark.parametrize("bits", [12, 14, 16, 18])
def test_every_code_is_its_own_nearest(bits):
    adc = replace(ADC, resolution_bits=bits)
    low, high = make_adc_calibration(adc).full_scale_counts
    codes = np.arange(low, high + 1, dtype=np.int32)
    counts = quantise_volts(make_adc_calibration(adc).volts(codes), make_adc_calibration(adc))
    assert counts.dtype == (np.int16 if bits <= 16 else np.int32)
    np.testing.assert_array_equal(counts, codes)


@pytest.mark.parametrize("bend", [{}, {"quadratic_fraction": 0.01, "cubic_fraction": -0.01, "offset_v": 0.5}])
def test_counts_are_the_rounded_inverse_of_the_polynomial(bend):
    calibration = make_adc_calibration(replace(ADC, **bend))
    lowest_v, highest_v = calibration.volts(np.array([-32_760, 32_760], dtype=np.int32))
    volts = np.random.default_rng(1).uniform(lowest_v, highest_v, 200)

    def inverse(v):
        # The root, to 1e-9 of a code, by a method that knows nothing of ours.
        return brentq(
            lambda x: np.polyval(calibration.coefficients_v[::-1], x) - v, -40_000, 40_000, xtol=1e-9
        )

    np.testing.assert_array_equal(quantise_volts(volts, calibration), np.rint([inverse(v) for v in volts]))


def test_quantisation_error_is_at_most_half_a_code():
    volts = np.random.default_rng(2).uniform(-5.0, 5.0, 20_000)
    error_v = CALIBRATION.volts(quantise_volts(volts, CALIBRATION)) - volts
    # The widest code is the linear term times one plus the polynomial's bend (below 1e-3).
    assert np.max(np.abs(error_v)) <= 0.5 * CALIBRATION.coefficients_v[1] * 1.001
    assert np.max(np.abs(error_v)) > 0.4 * CALIBRATION.coefficients_v[1]


def test_codes_reach_two_percent_beyond_the_range_and_then_clip():
    low, high = CALIBRATION.full_scale_counts
    counts = quantise_volts(np.array([5.05, -5.05, 5.2, -5.2, 1e9, -1e9]), CALIBRATION)
    assert low < counts[1] < counts[0] < high
    assert counts[2:].tolist() == [high, low, high, low]


def test_a_polynomial_that_is_no_line_is_refused():
    bent = Calibration(coefficients_v=np.array([0.0, 1e-4, 1e-8]), resolution_bits=16, range_v=5.0)
    with pytest.raises(ValueError, match="slope varies by"):
        quantise_volts(np.zeros(3), bent)


def test_without_noise_counts_are_the_signal_rounded():
    # At every fifth point of the force's grid: the fraction between two points is the same everywhere.
    adc = replace(ADC, sample_rate_hz=1e6, record_samples=1_300, pretrigger_samples=90)
    found = record(adc=adc)
    place = record_time_s(found, adc) / STEP_S
    below = np.floor(place).astype(int)
    assert np.ptp(place - below) < 1e-6
    padded = np.concatenate([np.zeros(1_000), force_n()])
    between = lagrange(padded, below + 1_000, (place - below)[0])
    np.testing.assert_array_equal(found.counts, quantise_volts(GAIN_V_PER_N * between, CALIBRATION))


def lagrange(values, index, x):
    """Cubic through the four points around ``index + x``, from the definition of Lagrange's polynomials."""
    nodes = (-1, 0, 1, 2)
    total = np.zeros(index.size)
    for i in nodes:
        weight = np.prod([(x - j) / (i - j) for j in nodes if j != i])
        total += weight * values[index + i]
    return total


@pytest.mark.parametrize("step_s", [1e-7, 2e-7, 5e-7])
def test_interpolation_adds_next_to_nothing(step_s):
    time_s = np.arange(round(1.5e-3 / step_s)) * step_s
    found = simulate_triggered_record(
        force_step_s=step_s,
        dynamic_force_n=force_n(time_s),
        sensor_gain_v_per_n=GAIN_V_PER_N,
        adc=ADC,
        calibration=CALIBRATION,
        sampling_phase=0.5,
        noise=NoiseParameters(enabled=False),
        random=np.random.default_rng(1),
    )
    exact_v = GAIN_V_PER_N * force_n(record_time_s(found))
    error_v = CALIBRATION.volts(found.counts) - exact_v
    # Half a code from rounding, 1e-3 wider by the polynomial's bend; the cubic errs by 3/128 h^4 times
    # the fourth derivative, 3e-7 N or 3e-5 codes.
    assert np.max(np.abs(error_v)) <= 0.502 * CALIBRATION.coefficients_v[1]


def test_a_strong_pulse_clips():
    found = record(gain=3.0 * GAIN_V_PER_N)
    low, high = CALIBRATION.full_scale_counts
    assert found.counts.max() == high
    assert np.count_nonzero(found.counts == high) > 100
    assert found.counts.min() > low


@pytest.mark.parametrize("phase", [0.0, 0.25, 0.999])
def test_the_trigger_is_the_first_sample_at_the_level(phase):
    found = record(phase=phase)
    volts = CALIBRATION.volts(found.counts)
    p = ADC.pretrigger_samples
    code_v = CALIBRATION.coefficients_v[1]
    # The comparator sees the voltage before rounding: half a code of tolerance.
    assert volts[p] >= ADC.trigger_level_v - 0.5 * code_v
    assert volts[p - 1] < ADC.trigger_level_v + 0.5 * code_v
    assert np.all(volts[: p - 1] < ADC.trigger_level_v)
    crossing_s = brentq(
        lambda t: GAIN_V_PER_N * pulse_n(t, 160e-6, 150.0) - ADC.trigger_level_v, 80e-6, 160e-6
    )
    # The first sample not before the crossing, which is found to 1 ns by a chord of the 0.2-us grid.
    assert -1e-9 <= found.trigger_time_s - crossing_s <= 1.0 / ADC.sample_rate_hz + 1e-9


def test_quiet_before_and_time_after_the_incident_wave():
    found = record()
    volts = CALIBRATION.volts(found.counts)
    peak = int(np.argmax(volts))
    first_stir = int(np.argmax(volts > 0.005 * volts[peak]))
    assert first_stir / ADC.sample_rate_hz >= 60e-6
    assert (volts.size - 1 - peak) / ADC.sample_rate_hz >= 1.2e-3


def test_noise_is_white_and_of_the_size_asked_for():
    noise_v = 0.025
    quiet = np.concatenate(
        [CALIBRATION.volts(record(noise_v=noise_v, seed=s).counts)[:600] for s in range(40)]
    )
    n = quiet.size
    # Four standard errors each: of a mean, a standard deviation and a correlation of n draws.
    assert abs(quiet.mean()) < 4.0 * noise_v / np.sqrt(n)
    assert quiet.std() == pytest.approx(noise_v, rel=4.0 / np.sqrt(2 * n))
    for lag in (1, 2, 7, 50):
        assert abs(np.corrcoef(quiet[:-lag], quiet[lag:])[0, 1]) < 4.0 / np.sqrt(n)


def test_noise_moves_the_trigger_but_not_the_time_it_reports():
    times_s = np.array([record(noise_v=0.025, seed=s).trigger_time_s for s in range(60)])
    assert times_s.std() > 1e-7
    for s in range(10):
        found = record(noise_v=0.025, seed=s)
        volts = CALIBRATION.volts(found.counts)
        # Correlated with the exact pulse at the reported time, the noise averages out: the height
        # of a pulse some 700 samples wide is known to 0.025 V / sqrt(700) = 1 mV; four of them.
        shape = pulse_n(record_time_s(found), 160e-6, 1.0)
        height_v = volts @ shape / (shape @ shape)
        assert height_v == pytest.approx(2.5, abs=4e-3)


def test_a_weak_pulse_does_not_trigger():
    assert record(gain=0.09 * GAIN_V_PER_N) is None
    assert record(gain=0.11 * GAIN_V_PER_N) is not None


def test_a_force_that_ends_before_the_record_is_refused():
    with pytest.raises(ValueError, match="compute the force for longer"):
        record(force=force_n()[:6_000])


def test_slow_noise_is_slow_and_of_the_size_asked_for():
    noise = NoiseParameters(rms_v=0.0, slow_rms_v=0.012, slow_bandwidth_hz=20e3)
    table = np.zeros((200, 14_200))
    for seed, volts in enumerate(table):
        add_noise_volts(volts, 10e6, noise, np.random.default_rng(seed))
    # 28 lines of two parts each and 200 records: four standard errors of a standard deviation; the
    # interpolation takes up to 1 % off the upper end of the band.
    assert np.sqrt(np.mean(table**2)) == pytest.approx(0.012, rel=4.0 / np.sqrt(2 * 200 * 56) + 0.01)
    power = np.mean(np.abs(np.fft.rfft(table * np.hanning(14_200), axis=1)) ** 2, axis=0)
    frequency_hz = np.fft.rfftfreq(14_200, 1e-7)
    # Two lines of the window beyond the band; the images of the coarse grid stay 40 dB below it.
    assert power[frequency_hz > 22e3].sum() < 1e-4 * power.sum()
    halves = [power[(frequency_hz > low) & (frequency_hz < low + 8e3)].mean() for low in (2e3, 11e3)]
    # 11 lines of 200 records in each: the ratio's standard error is sqrt(2 / 2,200) = 3 %; four of it.
    assert halves[1] == pytest.approx(halves[0], rel=0.12)


def test_noise_off_leaves_the_signal_alone():
    off = simulate_triggered_record(
        force_step_s=STEP_S,
        dynamic_force_n=force_n(),
        sensor_gain_v_per_n=GAIN_V_PER_N,
        adc=ADC,
        calibration=CALIBRATION,
        noise=NoiseParameters(enabled=False),
        random=np.random.default_rng(1),
    )
    np.testing.assert_array_equal(off.counts, record().counts)
