"""Crosstalk at a sensor's input without a wave: the coil's switching, and the mains."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le

from hardware_drivers.bounds import bounded
from hardware_drivers.nanoseconds import NS_PER_S
from simulator.numerics.arrays import FloatArray

FADED_V = 1e-5
"""A spike is drawn until it is smaller than this: a fifteenth of a 16-bit code of +-5 V."""


@bounded
class Crosstalk:
    """Voltage that a coil couples into the sensor next to it, and hum; none by default.

    Each edge of the pulse starts ``height exp(-t / decay_s) cos(2 pi ringing_hz t)``.
    """

    on_v: Annotated[float, Ge(-100.0), Le(100.0)] = 0.0
    """Height of the spike where the coil goes on, with its sign."""
    off_v: Annotated[float, Ge(-100.0), Le(100.0)] = 0.0
    """Height of the spike where it goes off."""
    decay_s: Annotated[float, Gt(0.0), Le(1.0)] = 2e-6
    """Time in which a spike falls to 1/e."""
    ringing_hz: Annotated[float, Ge(0.0), Le(1e7)] = 0.0
    """Frequency it rings at; 0: it only decays."""
    flyback_v: Annotated[float, Ge(-100.0), Le(100.0)] = 0.0
    """Voltage at off that falls to nothing, evenly, with the coil's current in its diode."""
    flyback_s: Annotated[float, Gt(0.0), Le(1.0)] = 1e-3
    """Time that takes."""
    bounces: Annotated[int, Ge(0), Le(100)] = 0
    """Contact bounces of a relay after each edge; each repeats the spike at half the height before it."""
    bounce_s: Annotated[float, Gt(0.0), Le(0.1)] = 0.5e-3
    """Time from one bounce to the next."""
    hum_v: Annotated[float, Ge(0.0), Le(100.0)] = 0.0
    """Amplitude of the mains hum."""
    hum_hz: Annotated[float, Gt(0.0), Le(1e6)] = 50.0
    """Its frequency."""

    @property
    def silent(self) -> bool:
        """Return whether nothing is coupled: neither spikes, nor flyback, nor hum."""
        return not (self.on_v or self.off_v or self.flyback_v or self.hum_v)

    @property
    def reach_s(self) -> float:
        """Return the time after an edge until its spike, bounces and flyback are below `FADED_V`, s."""
        tallest_v = max(abs(self.on_v), abs(self.off_v))
        fading_s = self.decay_s * math.log(max(tallest_v / FADED_V, 1.0))
        return max(self.bounces * self.bounce_s + fading_s, self.flyback_s if self.flyback_v else 0.0)

    def volts(
        self, pulses: Iterable[tuple[int, int]], first_ns: float, rate_hz: float, samples: int
    ) -> FloatArray:
        """Compute the crosstalk voltage (hum, spikes, flyback) at the input in V, shape (samples,).

        Parameters
        ----------
        pulses
            Times when the coil went on and off, ns, one pair per pulse.
        first_ns
            Time of the first sample on the same clock, ns.
        rate_hz
            Sample rate, Hz.
        """
        volts = np.zeros(samples)
        if self.hum_v:
            # Whole periods taken off first: a clock of ns since boot has few digits left for a phase.
            phase = math.fmod(first_ns / NS_PER_S * self.hum_hz, 1.0)
            t = np.arange(samples) / rate_hz
            volts += self.hum_v * np.sin(2.0 * math.pi * (phase + self.hum_hz * t))
        for on_ns, off_ns in pulses:
            for edge_ns, height_v in ((on_ns, self.on_v), (off_ns, self.off_v)):
                for bounce in range(self.bounces + 1 if height_v else 0):
                    since_s = (edge_ns - first_ns) / NS_PER_S + bounce * self.bounce_s
                    self._add_spike(volts, since_s, rate_hz, height_v * 0.5**bounce)
            if self.flyback_v:
                after, t = _select_after_edge(volts, (off_ns - first_ns) / NS_PER_S, self.flyback_s, rate_hz)
                after += self.flyback_v * np.maximum(1.0 - t / self.flyback_s, 0.0)
        return volts

    def _add_spike(self, volts: FloatArray, since_s: float, rate_hz: float, height_v: float) -> None:
        """Add the decaying spike of one edge, ``height_v`` high, to ``volts`` in place until it has faded.

        The edge is ``since_s`` after the first sample; what is outside the record is left out.
        """
        fading_s = self.decay_s * math.log(max(abs(height_v) / FADED_V, 1.0))
        after, t = _select_after_edge(volts, since_s, fading_s, rate_hz)
        spike = height_v * np.exp(-t / self.decay_s)
        after += spike * np.cos(2.0 * math.pi * self.ringing_hz * t) if self.ringing_hz else spike


def _select_after_edge(
    volts: FloatArray, since_s: float, length_s: float, rate_hz: float
) -> tuple[FloatArray, FloatArray]:
    """Return a view of the samples within ``length_s`` after an edge, and the time of each since the edge, s.

    ``since_s`` is the time of the edge after the first sample. Both are empty if none is in the record.
    """
    first = min(max(math.ceil(since_s * rate_hz), 0), volts.size)
    last = min(max(math.ceil((since_s + length_s) * rate_hz), first), volts.size)
    return volts[first:last], np.arange(first, last) / rate_hz - since_s
