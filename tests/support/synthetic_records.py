"""Records of solitary waves drawn as cos^4 pulses: every feature is known in closed form."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hardware_drivers.measurement import Calibration, Waveform

PULSE_WIDTH_S = 178e-6
FWHM_S = 2.0 * PULSE_WIDTH_S / math.pi * math.acos(0.5**0.25)
RATE_HZ = 10e6
CALIBRATION = Calibration(coefficients_v=np.array([0.0, 10.0 / 32768]), resolution_bits=16, range_v=10.0)


def cos4(time_s, centre_s, width_s=PULSE_WIDTH_S):
    """Return a cos^4 pulse of unit height, zero beyond half its width."""
    phase = np.clip((time_s - centre_s) / width_s, -0.5, 0.5)
    return np.cos(np.pi * phase) ** 4


def band_limited(n, rate_hz, ends_hz, seed):
    """Return noise of rms 1 that ends at a frequency."""
    length = 2 * n
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(length))
    frequency_hz = np.fft.rfftfreq(length, 1.0 / rate_hz)
    spectrum[frequency_hz > ends_hz] = 0.0
    return np.fft.irfft(spectrum, length)[:n] / np.sqrt(2.0 * ends_hz / rate_hz)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Content of a record; amplitudes of PSW and SSW are fractions of the ISW."""

    isw_v: float = 5.0
    isw_time_s: float = 50e-6
    tof_s: float = 330e-6
    amplitude_ratio: float = 0.5
    ssw_delay_s: float = 170e-6
    ssw_fraction: float = 0.08
    offset_v: float = 0.03
    noise_fraction: float = 0.0
    width_s: float = PULSE_WIDTH_S
    pretrigger_samples: int = 1000
    n_samples: int = 13_000
    rate_hz: float = RATE_HZ

    def with_(self, **changes):
        return replace(self, **changes)

    def time_s(self):
        return (np.arange(self.n_samples) - self.pretrigger_samples) / self.rate_hz

    def volts(self, seed=0):
        t, psw = self.time_s(), self.isw_time_s + self.tof_s
        volts = cos4(t, self.isw_time_s, self.width_s)
        volts += self.amplitude_ratio * cos4(t, psw, self.width_s)
        volts += self.ssw_fraction * cos4(t, psw + self.ssw_delay_s, self.width_s)
        if self.noise_fraction:
            volts += self.noise_fraction * np.random.default_rng(seed).standard_normal(t.size)
        return self.isw_v * volts + self.offset_v

    def waveform(self, seed=0, extra_v=0.0):
        return waveform_of(self.volts(seed) + extra_v, self.rate_hz, self.pretrigger_samples)


def waveform_of(volts, rate_hz=RATE_HZ, pretrigger_samples=1000):
    """Quantise volts with a 16-bit, +-10 V converter."""
    low, high = CALIBRATION.full_scale_counts
    counts = np.clip(np.rint(volts / CALIBRATION.coefficients_v[1]), low, high).astype(np.int16)
    return Waveform(
        counts=counts, sample_rate_hz=rate_hz, pretrigger_samples=pretrigger_samples, calibration=CALIBRATION
    )
