"""Transduction from the force at the sensor to the counts of a triggered record.

force less preload -> volts (PZT) -> plus noise -> analog-edge trigger -> ADC counts. The PZT does not
see the static preload; a force that falls below it leaves a small negative voltage.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.fft import next_fast_len

from hardware_drivers.measurement import Calibration, Counts
from simulator.electronics.interference import Interference
from simulator.electronics.sampling_kernel import (
    add_noise,
    find_first_crossing_s,
    find_rising_edge,
    interpolate_cubic,
    invert_scaling,
)
from simulator.numerics.arrays import FloatArray
from simulator.numerics.normal_numbers import draw_standard_normals
from simulator.parameters.electronics import AdcParameters, NoiseParameters

EARLY_TRIGGER_S = 30e-6
"""Noise may fire the trigger this long before, or delay it this long after, the noise-free crossing."""

INVERSE_TOLERANCE_COUNTS = 1e-6
"""Accuracy of the inverted polynomial before rounding."""


def make_adc_calibration(adc: AdcParameters) -> Calibration:
    """Build the ADC's scaling polynomial; ideal codes reach ``over_range_fraction`` beyond the range."""
    half = float(1 << (adc.resolution_bits - 1))
    full_scale_v = adc.range_v * (1.0 + adc.over_range_fraction)
    return Calibration(
        coefficients_v=np.array(
            [
                adc.offset_v,
                full_scale_v / half * (1.0 + adc.gain_error_fraction),
                adc.range_v * adc.quadratic_fraction / half**2,
                adc.range_v * adc.cubic_fraction / half**3,
            ]
        ),
        resolution_bits=adc.resolution_bits,
        range_v=adc.range_v,
    )


def quantise_volts(volts: FloatArray, calibration: Calibration) -> Counts:
    """Quantise voltages to the nearest code by the inverse scaling, clipped to the codes.

    Parameters
    ----------
    volts
        float64, any shape.
    calibration
        Its polynomial must rise over all codes.

    Returns
    -------
    Counts
        int16 up to 16 bits, else int32, of the same shape.

    Raises
    ------
    ValueError
        The slope of the polynomial varies by more than half.
    """
    low, high = calibration.full_scale_counts
    curved, passes = _prepare_inversion(calibration)
    flat = np.ascontiguousarray(volts, dtype=np.float64).reshape(-1)
    codes: Counts
    if calibration.resolution_bits <= 16:
        codes = np.empty(flat.size, dtype=np.int16)
    else:
        codes = np.empty(flat.size, dtype=np.int32)
    offset_v, slope_v = calibration.coefficients_v[:2]
    invert_scaling(flat, offset_v, slope_v, curved, passes, low, high, codes)
    return codes.reshape(np.shape(volts))


@lru_cache(maxsize=64)
def _prepare_inversion(calibration: Calibration) -> tuple[FloatArray, int]:
    """Prepare `invert_scaling`: return the polynomial's curvature over its slope, and the number of passes.

    Raise ValueError for a scaling whose slope varies by more than half.
    """
    # The polynomial is a line with a slight bend: take the bend at the last answer off the line's,
    # again and again. Each step shrinks the error by `bend`, the largest relative change of slope.
    low, _ = calibration.full_scale_counts
    curved = calibration.coefficients_v[2:] / calibration.coefficients_v[1]
    powers = np.arange(2, curved.size + 2)
    bend = float(np.sum(np.abs(curved) * powers * (-1.1 * low) ** (powers - 1.0)))
    if bend >= 0.5:
        raise ValueError(
            f"the scaling polynomial's slope varies by {bend:.2g} of itself; at most 0.5 is supported"
        )
    error_counts, passes = -1.1 * low * bend, 0
    while error_counts > INVERSE_TOLERANCE_COUNTS:
        error_counts *= bend
        passes += 1
    return curved, passes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriggeredRecord:
    """Counts around the trigger.

    Attributes
    ----------
    counts
        Shape (record_samples,); the trigger is sample ``pretrigger_samples``.
    trigger_time_s
        Time of the trigger sample from the striker's contact.
    """

    counts: Counts
    trigger_time_s: float


def simulate_triggered_record(
    *,
    force_step_s: float,
    dynamic_force_n: FloatArray,
    sensor_gain_v_per_n: float,
    adc: AdcParameters,
    calibration: Calibration,
    sampling_phase: float = 0.0,
    noise: NoiseParameters,
    random: np.random.Generator,
    interference: Interference | None = None,
    stray: Callable[[float, float, int], FloatArray] | None = None,
) -> TriggeredRecord | None:
    """Sample, trigger and quantise one shot; return None if nothing triggers the record.

    Parameters
    ----------
    force_step_s
        Step of the force's uniform time grid, which starts at the striker's contact.
    dynamic_force_n
        float64, shape (n,): force at the sensor less the static preload; zero before the contact.
    sampling_phase
        Phase of the free-running sample clock at the noise-free crossing, in samples, 0 .. 1.
    noise, random
        Electronic noise and the generator it is drawn from.
    interference
        Hum and spikes; a spike before the wave may take the trigger.
    stray
        Further volts on the wave, of the first sample's time from the contact, the rate and the number of
        samples: they move the trigger, and whether they alone would trigger is the caller's to see.

    Returns
    -------
    TriggeredRecord or None
        None if no rising edge passes the trigger level: the strike is missed.

    Raises
    ------
    ValueError
        The force ends before the record does, or the slope of the ADC's scaling varies by more than half.
    """
    volts = sensor_gain_v_per_n * dynamic_force_n
    crossing_s: float = find_first_crossing_s(volts, force_step_s, adc.trigger_level_v)
    margin = round(EARLY_TRIGGER_S * adc.sample_rate_hz)
    expected_s = [crossing_s]
    if interference is not None:
        expected_s = [*(crossing_s + interference.find_false_triggers_s(adc.trigger_level_v)), crossing_s]
    for edge_s in expected_s:
        start_s = edge_s - (adc.pretrigger_samples + margin + sampling_phase) / adc.sample_rate_hz
        # With a force step of 0.5 us and pulses 100 us wide a chord would leave the curve by 4e-5 of the
        # peak, half a 16-bit code; the cubic stays within 1e-8 but where a contact opens or closes.
        sampled: FloatArray = interpolate_cubic(
            volts, force_step_s, start_s, adc.sample_rate_hz, adc.record_samples + 2 * margin
        )
        if interference is not None:
            sampled += interference.volts(start_s - crossing_s, adc.sample_rate_hz, sampled.size)
        if stray is not None:
            sampled += stray(start_s, adc.sample_rate_hz, sampled.size)
        if noise.enabled:
            add_noise_volts(sampled, adc.sample_rate_hz, noise, random)
        trigger: int = find_rising_edge(sampled, adc.trigger_level_v, adc.pretrigger_samples, 2 * margin + 1)
        if trigger >= 0:
            break
    else:
        return None
    first = trigger - adc.pretrigger_samples
    last_s = start_s + (first + adc.record_samples - 1) / adc.sample_rate_hz
    force_end_s = (dynamic_force_n.size - 1) * force_step_s
    if last_s > force_end_s:
        raise ValueError(
            f"the force ends {force_end_s:.6g} s after the contact, the record {last_s:.6g} s after it; "
            "compute the force for longer or shorten the record"
        )
    return TriggeredRecord(
        counts=quantise_volts(sampled[first : first + adc.record_samples], calibration),
        trigger_time_s=start_s + trigger / adc.sample_rate_hz,
    )


def add_noise_volts(
    volts: FloatArray, sample_rate_hz: float, noise: NoiseParameters, random: np.random.Generator
) -> None:
    """Add white and slow noise to volts, shape (n_samples,), in place; draws from ``random``."""
    # The grain of float32, 1e-7 of the noise, is far below a code.
    white = draw_standard_normals(random, volts.size)
    if noise.slow_rms_v == 0.0:
        volts += white.astype(np.float64) * noise.rms_v
        return
    per_step, n_coarse, n_lines = _prepare_slow_noise_grid(
        volts.size, sample_rate_hz / noise.slow_bandwidth_hz
    )
    spectrum = np.zeros(n_coarse // 2 + 1, dtype=np.complex128)
    parts = random.standard_normal((2, n_lines))
    # A line of real and imaginary variance v adds 4 v / n_coarse^2 to the variance of the noise.
    spectrum[1 : n_lines + 1] = (parts[0] + 1j * parts[1]) * (n_coarse / np.sqrt(4.0 * n_lines))
    coarse = np.fft.irfft(spectrum, n_coarse)
    add_noise(volts, white, noise.rms_v, coarse, _lagrange_cubic_weights(per_step), noise.slow_rms_v)


@lru_cache(maxsize=64)
def _prepare_slow_noise_grid(n_samples: int, shortest_period: float) -> tuple[int, int, int]:
    """Choose the slow noise's grid: samples per step, length in steps, lines of its spectrum.

    The spectrum is even up to the shortest period, given in samples; the grid is ten times finer than that,
    or as fine as the samples, and brought from there to the samples by a cubic (within 0.4 % at the shortest
    period).
    """
    per_step = max(1, int(shortest_period / 10.0))
    n_coarse = next_fast_len(n_samples // per_step + 4, real=True)
    n_lines = min(max(1, int(n_coarse * per_step / shortest_period)), (n_coarse - 1) // 2)
    return per_step, n_coarse, n_lines


@lru_cache(maxsize=64)
def _lagrange_cubic_weights(per_step: int) -> FloatArray:
    """Return weights of Lagrange's cubic through -1, 0, 1, 2 for samples in 0 to 1, shape (4, per_step).

    Cached: callers must not write to the result.
    """
    x = np.arange(per_step) / per_step
    return np.array(
        [
            -x * (x - 1.0) * (x - 2.0) / 6.0,
            (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0,
            -(x + 1.0) * x * (x - 2.0) / 2.0,
            (x + 1.0) * x * (x - 1.0) / 6.0,
        ]
    )
