"""Interference: hum, spikes and ringing at the digitizer's input."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from simulator.numerics.arrays import FloatArray

SPIKE_REACH_FWHM = 3.0
"""A spike is drawn this far to both sides of its peak: beyond, a Gaussian is below 2e-11 of it."""

RING_REACH_DECAYS = 12.0
"""A ring is drawn so long: what is left then is 6e-6 of it, far below a code."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Interference:
    """Hum and spikes around one strike.

    Attributes
    ----------
    hum_v, hum_frequency_hz, hum_phase_rad
        ``hum_v sin(2 pi f t + phase)``, t from the noise-free passage through the trigger level.
    spike_time_s
        Shape (n,), rising: peaks of the spikes on the same clock.
    spike_v
        Shape (n,): their heights with sign.
    spike_fwhm_s
        Full width at half maximum of each.
    """

    hum_v: float
    hum_frequency_hz: float
    hum_phase_rad: float
    spike_time_s: FloatArray
    spike_v: FloatArray
    spike_fwhm_s: float

    def find_false_triggers_s(self, level_v: float) -> FloatArray:
        """Return the times in s, negative and rising, at which a spike alone reaches the trigger level.

        They count from the noise-free crossing of the level by the wave.
        """
        found: FloatArray = self.spike_time_s[(self.spike_time_s < 0.0) & (self.spike_v >= level_v)]
        return found

    def volts(self, first_s: float, sample_rate_hz: float, n_samples: int) -> FloatArray:
        """Compute hum and spikes in V, shape (n_samples,), from ``first_s`` after the trigger crossing on."""
        t = first_s + np.arange(n_samples) / sample_rate_hz
        volts: FloatArray = self.hum_v * np.sin(
            2.0 * math.pi * self.hum_frequency_hz * t + self.hum_phase_rad
        )
        reach_s = SPIKE_REACH_FWHM * self.spike_fwhm_s
        near = (self.spike_time_s > t[0] - reach_s) & (self.spike_time_s < t[-1] + reach_s)
        for peak_s, height_v in zip(self.spike_time_s[near], self.spike_v[near], strict=True):
            first = max(0, math.floor((peak_s - reach_s - first_s) * sample_rate_hz))
            last = min(n_samples, math.ceil((peak_s + reach_s - first_s) * sample_rate_hz) + 1)
            widths = (t[first:last] - peak_s) / self.spike_fwhm_s
            volts[first:last] += height_v * np.exp(-4.0 * math.log(2.0) * widths**2)
        return volts


@dataclass(frozen=True, slots=True, kw_only=True)
class Ringing:
    """Knock or electrical burst: ``V sin(2 pi f t) exp(-t / tau)`` from its start on.

    Attributes
    ----------
    start_s
        From the striker's contact.
    """

    start_s: float
    height_v: float
    frequency_hz: float
    decay_s: float

    def volts(self, first_s: float, sample_rate_hz: float, n_samples: int) -> FloatArray:
        """Compute the ringing in V, shape (n_samples,), from ``first_s`` after the striker's contact on."""
        volts = np.zeros(n_samples)
        begins_s = self.start_s - first_s
        ends_s = begins_s + RING_REACH_DECAYS * self.decay_s
        first = min(max(math.ceil(begins_s * sample_rate_hz), 0), n_samples)
        last = min(max(math.ceil(ends_s * sample_rate_hz), first), n_samples)
        t = np.arange(first, last) / sample_rate_hz - begins_s
        volts[first:last] = np.sin(2.0 * math.pi * self.frequency_hz * t) * np.exp(-t / self.decay_s)
        return np.asarray(self.height_v * volts)
