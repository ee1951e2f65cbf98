"""Pulse-echo record of a dual-element probe on a thinning plate (paper, section 2 and equation 17).

One element sends, the other receives; between them and the wall lies a delay line. The travel time of
the first back-wall echo is ``D + 2 th / c`` with the probe's delay D, the thickness th and the wave
speed c; further echoes follow every ``2 th / c``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hardware_drivers.measurement import Calibration
from simulator.scenario import EchoParameters

FloatArray = NDArray[np.float64]

PULSE_HALF_LENGTH = 5.0
"""A pulse is drawn this many standard deviations to both sides: it is then below 4e-6 of its peak."""


def travel_time_s(thickness_m: float, echo: EchoParameters) -> float:
    """Time from the firing pulse to the peak of the first back-wall echo's envelope."""
    return echo.delay_s + 2.0 * thickness_m / echo.velocity_m_per_s


def echo_volts(thickness_m: float, echo: EchoParameters) -> FloatArray:
    """Noise-free record, shape (record_samples,); time zero is the firing pulse.

    Raises
    ------
    ValueError
        No wall: the thickness is not positive.
    """
    if not thickness_m > 0.0:
        raise ValueError(f"thickness_m is {thickness_m} m; an echo needs a positive thickness")
    volts = np.zeros(echo.record_samples)
    # Cross-talk from the front wall has the opposite sign of the reflections at the free back wall.
    _add_pulse(volts, echo.delay_s, -echo.front_wall_v, echo)
    round_trip_s = 2.0 * thickness_m / echo.velocity_m_per_s
    loss = 10.0 ** (-echo.attenuation_db_per_m * 2.0 * thickness_m / 20.0)
    amplitude_v, arrival_s = echo.back_wall_v * loss, echo.delay_s + round_trip_s
    end_s = echo.record_samples / echo.sample_rate_hz
    smallest_v = 1e-6 * echo.back_wall_v  # far below a code of any receiver
    while amplitude_v > smallest_v and arrival_s < end_s:
        _add_pulse(volts, arrival_s, amplitude_v, echo)
        amplitude_v *= echo.multiple_ratio * loss
        arrival_s += round_trip_s
    return volts


def _add_pulse(volts: FloatArray, arrival_s: float, amplitude_v: float, echo: EchoParameters) -> None:
    """Add a tone burst with a Gaussian envelope that peaks at its arrival."""
    # The spectrum of the envelope falls to one half (-6 dB) at half the bandwidth.
    half_bandwidth_hz = 0.5 * echo.bandwidth_fraction * echo.centre_frequency_hz
    spread_s = math.sqrt(2.0 * math.log(2.0)) / (2.0 * math.pi * half_bandwidth_hz)
    first = max(0, math.ceil((arrival_s - PULSE_HALF_LENGTH * spread_s) * echo.sample_rate_hz))
    last = min(volts.size, math.floor((arrival_s + PULSE_HALF_LENGTH * spread_s) * echo.sample_rate_hz) + 1)
    t = np.arange(first, last) / echo.sample_rate_hz - arrival_s
    envelope = np.exp(-0.5 * (t / spread_s) ** 2)
    volts[first:last] += amplitude_v * envelope * np.cos(2.0 * np.pi * echo.centre_frequency_hz * t)


def echo_calibration(echo: EchoParameters) -> Calibration:
    """Linear scaling of the receiver over its range."""
    half = float(1 << (echo.resolution_bits - 1))
    return Calibration(
        coefficients_v=np.array([0.0, echo.range_v / half]),
        resolution_bits=echo.resolution_bits,
        range_v=echo.range_v,
    )
