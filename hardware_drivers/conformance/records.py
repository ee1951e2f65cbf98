"""Rules for every record, whichever instrument made it."""

from __future__ import annotations

import numpy as np

from hardware_drivers.instruments import Acquired

RANGE_FRACTION = 0.25
"""Full scale in volts is the range within this: boards reach up to a fifth beyond it, an ADC of few bits a
little less; a wrong unit or resolution is off by a factor of two at least."""


def require_storable_record(acquired: Acquired) -> None:
    """Raise AssertionError unless counts, calibration, truth and settings make a record that can be stored.

    Counts are int16 or int32 and read-only, the highest code is within `RANGE_FRACTION` of the range, truth
    values are float, settings float or str.
    """
    waveform, calibration = acquired.waveform, acquired.waveform.calibration
    assert waveform.counts.dtype in (np.int16, np.int32), "counts are integers"
    assert not waveform.counts.flags.writeable, "counts are read-only"
    assert np.isfinite(calibration.coefficients_v).all(), "the calibration is made of numbers"
    top_v = float(calibration.volts(np.array([calibration.full_scale_counts[1]], dtype=np.int32))[0])
    assert abs(abs(top_v) / calibration.range_v - 1.0) <= RANGE_FRACTION, (
        f"the highest code is {top_v:g} V by the calibration, its range is {calibration.range_v:g} V"
    )
    assert all(isinstance(value, float) for value in acquired.truth.values()), "what is true is a number"
    assert all(isinstance(value, (float, str)) for value in acquired.settings.values()), (
        "settings are numbers (float) and texts"
    )
