"""Pulse-echo travel time and thickness (paper, eq. 17)."""

import math

import numpy as np
import pytest

from analysis.errors import EchoNotFoundError, InvalidInputError, RecordError
from analysis.ultrasound.thickness import (
    compute_thickness,
    find_reference_echo,
    substitute_reference,
    travel_time,
)
from hardware_drivers.measurement import Calibration, Waveform

RATE_HZ = 100e6
CARRIER_HZ = 5e6
DELAY_S = 8e-6
SPEED = 5900.0
INITIAL_M = 6.35e-3
CALIBRATION = Calibration(coefficients_v=np.array([0.0, 1.0 / 8192]), resolution_bits=14, range_v=1.0)
SPREAD_S = 0.15e-6  # about half the centre frequency as bandwidth


def arrival_s(thickness_m):
    return DELAY_S + 2.0 * thickness_m / SPEED


def burst(time_s, centre_s, phase_rad=0.0):
    t = time_s - centre_s
    return np.exp(-0.5 * (t / SPREAD_S) ** 2) * np.cos(2 * np.pi * CARRIER_HZ * t + phase_rad)


def waveform_of(volts, rate_hz=RATE_HZ, pretrigger=0):
    counts = np.clip(np.rint(volts * 8192), -8192, 8191).astype(np.int16)
    return Waveform(
        counts=counts, sample_rate_hz=rate_hz, pretrigger_samples=pretrigger, calibration=CALIBRATION
    )


def record(thickness_m, *, noise_v=0.0, seed=0, phase_rad=0.0, front_v=0.02, n=2048, pretrigger=0):
    t = (np.arange(n) - pretrigger) / RATE_HZ
    volts = -front_v * burst(t, DELAY_S)
    for echo in range(8):
        centre_s = DELAY_S + (echo + 1) * 2.0 * thickness_m / SPEED
        volts += 0.5 * 0.45**echo * burst(t, centre_s, phase_rad)
    volts += noise_v * np.random.default_rng(seed).standard_normal(n)
    return waveform_of(volts, pretrigger=pretrigger)


def reference(waveform=None, **changes):
    arguments = {"delay_s": DELAY_S, "initial_thickness_m": INITIAL_M, "velocity_m_per_s": SPEED} | changes
    return find_reference_echo(record(INITIAL_M) if waveform is None else waveform, **arguments)


def measured_m(waveform, echo):
    found = travel_time(waveform, echo)
    return compute_thickness(found.travel_time_s, echo.travel_time_s, DELAY_S, INITIAL_M).thickness_m


@pytest.mark.parametrize("front_v", [0.0, 0.02])
def test_reference_is_the_first_back_wall_echo(front_v):
    echo = reference(record(INITIAL_M, front_v=front_v))
    # A count is 1/4096 of the echo; over the 36 samples of its top that is .02 ns.
    assert echo.travel_time_s == pytest.approx(arrival_s(INITIAL_M), abs=0.05e-9)


def test_reference_needs_no_exact_speed_or_thickness():
    assert reference(velocity_m_per_s=5400.0, initial_thickness_m=6.2e-3).travel_time_s == pytest.approx(
        reference().travel_time_s, abs=1e-15
    )


# From the pristine plate over the paper's 4.2 mm (.73 us, 3.6 carrier periods earlier) and 3.8 mm (its core).
@pytest.mark.parametrize("thickness_mm", [6.5, 6.35, 6.3, 6.0, 5.55, 5.0, 4.5, 4.2, 3.8, 3.0, 2.0])
def test_thinning_wall_is_followed_without_a_cycle_skip(thickness_mm):
    echo = reference()
    found = travel_time(record(thickness_mm * 1e-3), echo)
    # Neighbour echoes and quantisation move the pick by up to .1 ns; a slip would be 200 ns.
    assert found.travel_time_s == pytest.approx(arrival_s(thickness_mm * 1e-3), abs=0.2e-9)
    assert found.quality == "good"
    assert found.reason == ""
    assert found.correlation_coefficient > 0.98
    assert measured_m(record(thickness_mm * 1e-3), echo) == pytest.approx(thickness_mm * 1e-3, abs=1e-6)


def test_a_later_echo_stands_in_for_a_lost_reference():
    first, later_m = reference(), 5.1e-3
    seen = record(later_m, noise_v=0.01)
    later = substitute_reference(
        reference(seen, initial_thickness_m=later_m),
        travel_time_s=travel_time(seen, first).travel_time_s,
        reference_travel_time_s=first.travel_time_s,
    )
    for wall_m in (INITIAL_M, later_m, 3.9e-3):
        # Noise of a hundredth of the echo moves a pick by some 20 nm; its envelope's peak by more than 1 um.
        assert measured_m(record(wall_m), later) == pytest.approx(measured_m(record(wall_m), first), abs=1e-7)


@pytest.mark.parametrize("height", [0.1, 0.2])
def test_weaker_echo_before_the_back_wall_is_not_taken_for_it(height):
    # A lamination or the front wall's tail, at a third of the way.
    extra = record(5e-3).volts() + height * burst(np.arange(2048) / RATE_HZ, DELAY_S + 0.7e-6)
    disturbed = waveform_of(extra)
    found = travel_time(disturbed, reference())
    assert found.travel_time_s == pytest.approx(arrival_s(5e-3), abs=1e-9)


def test_stronger_echo_beyond_the_gate_does_not_matter():
    extra = record(INITIAL_M).volts() + 0.5 * burst(np.arange(2048) / RATE_HZ, DELAY_S + 4.35e-6)
    focused = waveform_of(extra)
    assert extra.max() > 1.1 * 0.5  # the first echo is .5 V
    found = travel_time(focused, reference())
    assert found.travel_time_s == pytest.approx(arrival_s(INITIAL_M), abs=0.2e-9)


def test_pretrigger_is_not_travel_time():
    shifted = record(INITIAL_M, pretrigger=50, n=2098)
    assert reference(shifted).travel_time_s == pytest.approx(reference().travel_time_s, abs=1e-12)
    echo = reference()
    late = travel_time(record(5e-3, pretrigger=50, n=2098), echo)
    assert late.travel_time_s == pytest.approx(travel_time(record(5e-3), echo).travel_time_s, abs=1e-12)


@pytest.mark.parametrize("degrees", [120, 150, 180, 210, 240])
def test_a_possible_cycle_slip_is_reported(degrees):
    # A carrier turned that far under the same envelope puts two maxima about equally far from its peak.
    found = travel_time(record(5e-3, phase_rad=math.radians(degrees)), reference())
    assert found.quality == "suspect"
    assert "slip" in found.reason


@pytest.mark.parametrize("degrees", [-60, -30, 30, 60])
def test_carrier_turned_a_little_is_no_slip(degrees):
    assert travel_time(record(5e-3, phase_rad=math.radians(degrees)), reference()).quality == "good"


def test_quality_follows_the_likeness_of_the_echo():
    echo, seen = reference(), set()
    for seed in range(60):
        found = travel_time(record(5e-3, noise_v=0.02 + 0.005 * seed, seed=seed), echo)
        coefficient = found.correlation_coefficient
        if coefficient < 0.6:
            assert found.quality == "bad"
        elif coefficient < 0.9:
            assert found.quality == "suspect"
            assert f"correlation {coefficient:.2f}" in found.reason
        elif "slip" not in found.reason:
            assert (found.quality, found.reason) == ("good", "")
        seen.add(found.quality)
    assert seen == {"good", "suspect", "bad"}


def test_silence_has_no_travel_time():
    silent = waveform_of(np.zeros(2048))
    found = travel_time(silent, reference())
    assert math.isnan(found.travel_time_s)
    assert math.isnan(found.correlation_coefficient)
    assert (found.quality, found.reason) == ("bad", "no echo in the gate")
    assert math.isnan(compute_thickness(found.travel_time_s, 1e-5, DELAY_S, INITIAL_M).thickness_m)
    with pytest.raises(EchoNotFoundError, match="check the coupling"):
        reference(silent)


def test_noise_alone_is_no_reference():
    volts = np.random.default_rng(0).standard_normal(2048) * 0.05
    noise = waveform_of(volts)
    with pytest.raises(EchoNotFoundError):
        reference(noise)


def test_equation_17():
    # The paper's own numbers: .73 us less of 2.153 us is 34 % thinner, 4.2 mm.
    result = compute_thickness(8e-6 + 1.4237e-6, 8e-6 + 2.1525e-6, 8e-6, 6.35e-3)
    assert result.thickness_m == pytest.approx(4.2e-3, abs=1e-6)
    assert result.thickness_loss_m == pytest.approx(2.15e-3, abs=1e-6)
    assert result.thickness_m + result.thickness_loss_m == pytest.approx(6.35e-3, rel=1e-12)


def test_bad_input_is_refused():
    with pytest.raises(InvalidInputError, match="must exceed delay_s"):
        compute_thickness(9e-6, 8e-6, 8e-6, 6.35e-3)
    with pytest.raises(InvalidInputError, match="initial_thickness_m"):
        compute_thickness(9e-6, 1e-5, 8e-6, 0.0)
    with pytest.raises(InvalidInputError, match="velocity_m_per_s is 0"):
        reference(velocity_m_per_s=0.0)
    with pytest.raises(InvalidInputError, match="delay_s is -1"):
        reference(delay_s=-1.0)
    with pytest.raises(InvalidInputError, match="enclose"):
        reference(thinnest_fraction=1.2)
    with pytest.raises(RecordError, match="record longer"):
        reference(record(INITIAL_M, n=900))
    with pytest.raises(RecordError, match="record longer"):
        travel_time(record(INITIAL_M, n=1000), reference())
    other = waveform_of(np.zeros(2048), 50e6)
    with pytest.raises(RecordError, match="new reference"):
        travel_time(other, reference())
