"""Pulse-echo record of a dual-element probe on a thinning plate (paper, section 2 and equation 17).

One element sends, the other receives; between them and the wall lies a delay line. The first back-wall
echo arrives at ``D + sqrt(4 th^2 + s^2) / c`` with the probe's delay D, the thickness th, the wave speed c
and the distance s of the two elements' points on the wall; the k-th has gone up and down k times.

A rough far wall is a phase screen (Kirchhoff's approximation): every facet of the beam's spot reflects by
its local thickness, and the record is the sum over the facets. For heights of SD sigma the mean of this sum
falls by exp(-2 k^2 sigma^2), k = 2 pi f / c; the rest arrives smeared, and how it adds up is chance. Shadows,
multiple scattering within the roughness and the angle of a facet beyond its phase are left out.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from hardware_drivers.measurement import Calibration
from simulator.echo.far_wall import FarWall, build_smooth_wall
from simulator.numerics.arrays import FloatArray
from simulator.parameters.echo import EchoParameters

PULSE_HALF_LENGTH = 5.0
"""A pulse is drawn this many standard deviations to both sides: it is then below 4e-6 of its peak."""
SMALLEST_FRACTION = 1e-6
"""Echoes below this part of the first one's nominal peak are left out: far below a code of any receiver."""
ARRIVALS_PER_PERIOD = 320
"""Grid of arrival times a carrier period; sharing an arrival between two points costs 5e-5 of its height."""

SALT_WATER_VELOCITY_M_PER_S = 1_520.0
"""Wave speed of a 3.5 % solution of salt at 20 C (handbook value)."""
STEEL_REFLECTION = 0.94
"""Reflection of a wave in steel at water, (46 - 1.5) / (46 + 1.5) by the handbook's impedances in MRayl."""


def sound_path_m(thickness_m: float, echo: EchoParameters, times: int = 1) -> float:
    """Return the length of the sound path in the wall in m, ``times`` up and down."""
    return math.hypot(2.0 * times * thickness_m, echo.element_separation_m)


def travel_time_s(thickness_m: float, echo: EchoParameters) -> float:
    """Return the time from firing to the first back-wall echo's envelope peak in a smooth wall, in s."""
    return echo.delay_s + sound_path_m(thickness_m, echo) / echo.velocity_m_per_s


def warm_probe_and_wall(echo: EchoParameters, warmer_k: float) -> EchoParameters:
    """Return the echo parameters with delay and wave speed of probe and wall warmer by ``warmer_k``."""
    return replace(
        echo,
        delay_s=echo.delay_s * (1.0 + echo.delay_per_k * warmer_k),
        velocity_m_per_s=echo.velocity_m_per_s * (1.0 + echo.velocity_per_k * warmer_k),
    )


def simulate_echo(wall: float | FarWall, echo: EchoParameters) -> FloatArray:
    """Simulate a noise-free pulse-echo record in V, shape (record_samples,); time zero is the firing pulse.

    Parameters
    ----------
    wall
        Thickness of a smooth wall, or the facets of a rough one.

    Raises
    ------
    ValueError
        No wall: the thickness is not positive.
    """
    if isinstance(wall, FarWall):
        volts = _simulate_rough_wall(wall, echo)
    elif not wall > 0.0:
        raise ValueError(f"thickness_m is {wall} m; an echo needs a positive thickness")
    elif echo.attenuation_exponent > 0.0:
        volts = _simulate_rough_wall(build_smooth_wall(wall), echo)
    else:
        volts = _simulate_smooth_wall(wall, echo)
    # Cross-talk from the front wall has the opposite sign of the reflections at the free back wall.
    _add_pulse(volts, echo.delay_s, -echo.front_wall_v, echo)
    return volts


def _simulate_smooth_wall(thickness_m: float, echo: EchoParameters) -> FloatArray:
    """Simulate the back-wall echoes of a smooth wall in V, in closed form, shape (record_samples,)."""
    volts = np.zeros(echo.record_samples)
    end_s = echo.record_samples / echo.sample_rate_hz
    for times in range(1, echo.record_samples):
        way_m = sound_path_m(thickness_m, echo, times)
        arrival_s = echo.delay_s + way_m / echo.velocity_m_per_s
        fraction = echo.multiple_ratio ** (times - 1) * _remaining_amplitude(way_m, echo)
        if fraction < SMALLEST_FRACTION or arrival_s >= end_s:
            break
        _add_pulse(volts, arrival_s, echo.back_wall_v * fraction, echo)
    return volts


def _simulate_rough_wall(wall: FarWall, echo: EchoParameters) -> FloatArray:
    """Simulate the back-wall echoes of all facets of a rough wall in V, shape (record_samples,).

    The weighted arrivals are convolved with the pulse by its spectrum; facets of thickness 0 send nothing
    back. The pulse is filtered by the difference of the attenuation at each frequency from that at the
    centre, at the mean path of each echo; the attenuation at the centre is each facet's own.
    """
    reaches = wall.thickness_m > 0.0
    thickness_m, weights = wall.thickness_m[reaches], wall.weights[reaches]
    spread_s = _envelope_sd_s(echo)
    # Long enough that what would run over the record's end does not come back at its beginning.
    n = next_fast_len(
        echo.record_samples + 2 * math.ceil(PULSE_HALF_LENGTH * spread_s * echo.sample_rate_hz), real=True
    )
    end_s = echo.record_samples / echo.sample_rate_hz + PULSE_HALF_LENGTH * spread_s
    fineness = math.ceil(ARRIVALS_PER_PERIOD * echo.centre_frequency_hz / echo.sample_rate_hz)
    frequency_hz = np.arange(n // 2 + 1) * (echo.sample_rate_hz / n)
    spectrum = np.zeros(n // 2 + 1, dtype=np.complex128)
    arrivals = np.zeros(n * fineness)
    square_m2 = (2.0 * thickness_m) ** 2
    nepers_per_m = echo.attenuation_db_per_m * math.log(10.0) / 20.0
    for times in range(1, echo.record_samples):
        way_m = np.sqrt(times**2 * square_m2 + echo.element_separation_m**2)
        arrival_s = echo.delay_s + way_m / echo.velocity_m_per_s
        height = echo.multiple_ratio ** (times - 1) * weights * np.exp(-nepers_per_m * way_m)
        inside = arrival_s < end_s
        if not inside.any() or height.sum() < SMALLEST_FRACTION:
            break
        _add_heights_to_grid(arrivals, arrival_s[inside] * (echo.sample_rate_hz * fineness), height[inside])
        if echo.attenuation_exponent > 0.0:
            mean_m = float(way_m @ height / height.sum())
            lines = rfft(arrivals)[: spectrum.size]
            spectrum += lines * _attenuation_by_frequency(frequency_hz, mean_m, echo)
            arrivals[:] = 0.0
    if echo.attenuation_exponent == 0.0:
        spectrum = rfft(arrivals)[: spectrum.size]
    spectrum = spectrum * (echo.back_wall_v * echo.sample_rate_hz) * _pulse_spectrum(frequency_hz, echo)
    volts: FloatArray = irfft(spectrum, n)[: echo.record_samples]
    return np.ascontiguousarray(volts)


def _add_heights_to_grid(grid: FloatArray, place: FloatArray, height: FloatArray) -> None:
    """Add heights to a grid in place, each shared by the two points around its fractional index."""
    index = place.astype(np.intp)
    later = place - index
    first = int(index.min())
    count = int(index.max()) - first + 2
    grid[first : first + count] += np.bincount(index - first, weights=height * (1.0 - later), minlength=count)
    grid[first : first + count] += np.bincount(index + 1 - first, weights=height * later, minlength=count)


def _remaining_amplitude(way_m: float, echo: EchoParameters) -> float:
    """Return the fraction of the amplitude left after a path in the wall in m, at centre frequency."""
    return float(10.0 ** (-echo.attenuation_db_per_m * way_m / 20.0))


def _attenuation_by_frequency(frequency_hz: FloatArray, way_m: float, echo: EchoParameters) -> FloatArray:
    """Return the amplitude left at each frequency over that at the centre frequency, shape as given.

    ``way_m`` is the length of the sound path in the wall in m.
    """
    relative = (frequency_hz / echo.centre_frequency_hz) ** echo.attenuation_exponent - 1.0
    filtered: FloatArray = 10.0 ** (-echo.attenuation_db_per_m * relative * way_m / 20.0)
    return filtered


def _pulse_spectrum(frequency_hz: FloatArray, echo: EchoParameters) -> FloatArray:
    """Return the real Fourier transform of `_add_pulse`'s unit burst around its peak, in s."""
    spread_s = _envelope_sd_s(echo)
    lines = [
        np.exp(-0.5 * (2.0 * np.pi * (frequency_hz - sign * echo.centre_frequency_hz) * spread_s) ** 2)
        for sign in (1.0, -1.0)
    ]
    spectrum: FloatArray = spread_s * math.sqrt(0.5 * math.pi) * (lines[0] + lines[1])
    return spectrum


def _envelope_sd_s(echo: EchoParameters) -> float:
    """Return the SD of the pulse's Gaussian envelope in s.

    Its spectrum is one half (-6 dB) at half the bandwidth.
    """
    half_bandwidth_hz = 0.5 * echo.bandwidth_fraction * echo.centre_frequency_hz
    return math.sqrt(2.0 * math.log(2.0)) / (2.0 * math.pi * half_bandwidth_hz)


def _add_pulse(volts: FloatArray, arrival_s: float, amplitude_v: float, echo: EchoParameters) -> None:
    """Add a tone burst with a Gaussian envelope to volts in place, with its peak at the arrival."""
    spread_s = _envelope_sd_s(echo)
    first = max(0, math.ceil((arrival_s - PULSE_HALF_LENGTH * spread_s) * echo.sample_rate_hz))
    last = min(volts.size, math.floor((arrival_s + PULSE_HALF_LENGTH * spread_s) * echo.sample_rate_hz) + 1)
    t = np.arange(first, last) / echo.sample_rate_hz - arrival_s
    envelope = np.exp(-0.5 * (t / spread_s) ** 2)
    volts[first:last] += amplitude_v * envelope * np.cos(2.0 * np.pi * echo.centre_frequency_hz * t)


def simulate_bubbles(
    thickness_m: float, echo: EchoParameters, random: np.random.Generator, records: int
) -> FloatArray:
    """Simulate echoes of bubbles in the liquid behind the wall in V, shape (records, record_samples).

    A bubble of radius a, long against the wave, reflects like a sphere, a / 2 in amplitude at the distance
    1; the mean of that spherical wave over a spot of area S is a lambda / (2 S). Going through the far wall
    and back leaves 1 - R^2 of the amplitude. Bubbles move between two records: each record has its own,
    drawn evenly over the spot and the liquid's depth. Gas that sticks to the wall itself reflects like the
    liquid does within 1 - R = 6 %, and is left out.
    """
    volts = np.zeros((records, echo.record_samples))
    spot_m2 = math.pi * echo.beam_diameter_m**2 / (4.0 * math.log(2.0))
    wave_m = SALT_WATER_VELOCITY_M_PER_S / echo.centre_frequency_hz
    way_m = sound_path_m(thickness_m, echo)
    through = (1.0 - STEEL_REFLECTION**2) / STEEL_REFLECTION
    strongest_v = (
        echo.back_wall_v
        * _remaining_amplitude(way_m, echo)
        * through
        * echo.bubble_radius_m
        * wave_m
        / (2.0 * spot_m2)
    )
    for record in volts:
        count = int(random.poisson(echo.bubbles_per_beam))
        # Evenly over the disk where the beam has fallen to 1/16: its square's radius is even.
        sensitivity = 16.0 ** -random.uniform(0.0, 1.0, count)
        depth_m = random.uniform(0.0, echo.liquid_depth_m, count)
        for weight, deep_m in zip(sensitivity, depth_m, strict=True):
            arrival_s = (
                echo.delay_s
                + way_m / echo.velocity_m_per_s
                + 2.0 * float(deep_m) / SALT_WATER_VELOCITY_M_PER_S
            )
            _add_pulse(record, arrival_s, float(strongest_v * weight), echo)
    return volts


def build_echo_calibration(echo: EchoParameters) -> Calibration:
    """Build the receiver's linear calibration: half of all codes span 0 to ``range_v``."""
    half = float(1 << (echo.resolution_bits - 1))
    return Calibration(
        coefficients_v=np.array([0.0, echo.range_v / half]),
        resolution_bits=echo.resolution_bits,
        range_v=echo.range_v,
    )
