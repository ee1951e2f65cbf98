"""Noise, moving mean and matched filter of a record."""

import numpy as np
import pytest
from support.synthetic_records import cos4

from analysis.errors import RecordError
from analysis.waves.record_reduction import (
    LEAST_EXCESS,
    ExtractionSettings,
    VoltRecord,
    apply_matched_filter,
    estimate_block_noise,
    estimate_fine_noise,
    kernel_noise_gain,
    moving_mean,
    noise_rms,
    reduce_records,
)


@pytest.mark.parametrize("n", [999, 13_000])
@pytest.mark.parametrize("scale", [1e-6, 1.0])
def test_noise_is_the_scaled_median_of_differences(n, scale):
    values = scale * np.random.default_rng(n).standard_normal(n)
    exact = 1.4826 * np.median(np.abs(np.diff(values))) / np.sqrt(2.0)
    # A histogram bin is 1/64 of the mean, 1.2 % of the median; inside it the density is even to a tenth,
    # and n values leave about n/80 in it, whose own unevenness is what remains: 1 / sqrt(n/80) of a bin.
    assert noise_rms(values) == pytest.approx(exact, rel=0.012 * (0.1 + np.sqrt(80 / n)))


@pytest.mark.parametrize("height", [100.0, 1000.0, 1e6])
def test_noise_ignores_offset_hum_and_a_few_glitches(height):
    random = np.random.default_rng(7)
    values = random.standard_normal(13_000)
    disturbed = values + 100.0 + 50.0 * np.sin(2 * np.pi * 50.0 * np.arange(13_000) / 1e7)
    disturbed[random.integers(0, 13_000, 20)] += height
    # 40 of 13,000 differences are glitches: they push the median up by .15 % of ranks, .4 % of its value;
    # wider bins, where it is read from a histogram, add up to 1 %.
    assert noise_rms(disturbed) == pytest.approx(noise_rms(values), rel=0.014)


def test_noise_of_a_constant_is_zero():
    assert noise_rms(np.full(1000, 3.3)) == 0.0


@pytest.mark.parametrize("n", [999, 1000])
def test_noise_of_blocks_is_the_fine_one_where_that_is_larger_than_by_chance(n):
    blocks = np.random.default_rng(n).standard_normal(n)
    fine = estimate_fine_noise(blocks)
    differences = blocks[:-3] - 3.0 * blocks[1:-2] + 3.0 * blocks[2:-1] - blocks[3:]
    assert fine == pytest.approx(1.4826 * np.median(np.abs(differences)) / np.sqrt(20.0), rel=1e-12)
    least = fine / LEAST_EXCESS
    assert estimate_block_noise(blocks, 0.999 * least) == fine
    assert estimate_block_noise(blocks, 1.001 * least) == 1.001 * least


def test_moving_mean_takes_zeros_outside():
    assert moving_mean(np.ones(6), 3).tolist() == pytest.approx([2 / 3, 1, 1, 1, 1, 2 / 3])


def test_matched_filter_gives_a_pulse_its_own_amplitude_and_place():
    pulse = 3.0 * cos4(np.arange(600), 300.0, 178.0)
    output = apply_matched_filter(pulse, 178.0)
    assert int(np.argmax(output)) == 300
    assert output[300] == pytest.approx(3.0, rel=1e-12)  # the same sum twice: rounding of an FFT


def test_matched_filter_states_its_own_noise():
    noise = np.random.default_rng(5).standard_normal((200, 1000))
    outputs = [apply_matched_filter(row, 100.0) for row in noise]
    spread = np.std([output[450:550] for output in outputs])
    # 200 records of about 1.5 independent values each know an SD to 4 %: four of these.
    assert spread == pytest.approx(kernel_noise_gain(100.0), rel=0.16)


def test_matched_filter_does_not_wrap_around():
    pulse = cos4(np.arange(600), 560.0, 178.0)
    output = apply_matched_filter(pulse, 178.0)
    # A pulse cut off at the end must not reappear at the beginning.
    assert np.abs(output[:300]).max() < 1e-12


def test_matched_filter_needs_four_samples():
    with pytest.raises(RecordError, match="3 samples"):
        apply_matched_filter(np.zeros(100), 3)


def test_reduction_names_time_zero_and_offset():
    volts = 0.7 + 2.0 * cos4((np.arange(13_005) - 1000) / 1e7, 50e-6)
    (record,) = reduce_records([VoltRecord(volts, 1e7, 1000)], ExtractionSettings())
    assert record.offset_v == pytest.approx(0.7, abs=1e-12)
    assert record.block_samples == 10
    assert record.blocks_v.size == 1300  # the last 5 samples make no block
    assert record.time_s(0) == pytest.approx(-100e-6 + 0.45e-6)
    assert record.index(record.time_s(17.25)) == pytest.approx(17.25)
    assert record.time_s(int(np.argmax(record.matched_v))) == pytest.approx(50e-6, abs=0.5e-6)
