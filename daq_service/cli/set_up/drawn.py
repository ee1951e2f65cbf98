"""Prepare records and shots for drawing on the set-up page."""

from __future__ import annotations

import numpy as np

from analysis.waves.features import ShotFeatures
from hardware_drivers.measurement import Waveform

COLUMNS = 1000
"""Columns that a record is drawn in: each from its lowest to its highest sample."""


def compute_envelope(record: Waveform, first_s: float = 0.0) -> dict[str, object]:
    """Compute the lowest and highest voltage in each of at most `COLUMNS` sections of a record.

    Returns arrays in V, start and section length in s, and the input range in V.

    Parameters
    ----------
    first_s
        Time of the first sample.
    """
    volts = record.volts()
    columns = min(COLUMNS, volts.size)
    edges = np.linspace(0, volts.size, columns, endpoint=False).astype(np.intp)
    return {
        "first_s": first_s,
        "column_s": volts.size / columns / record.sample_rate_hz,
        "lowest_v": np.minimum.reduceat(volts, edges),
        "highest_v": np.maximum.reduceat(volts, edges),
        "range_v": record.calibration.range_v,
    }


def prepare_shot_for_page(
    shot: Waveform, features: ShotFeatures, *, rising: bool = True
) -> dict[str, object]:
    """Convert a shot to a JSON object for drawing: envelope, marks of ISW and PSW (s, V), flags.

    Heights are negative for a falling wave; NaN for a missing one. ``rising`` is the direction of the wave.
    """
    sign = 1.0 if rising else -1.0
    marks = {
        "ISW": (features.isw_time_s, sign * features.isw_amplitude_v),
        "PSW": (features.psw_time_s, sign * features.psw_amplitude_v),
    }
    return {
        "shot": compute_envelope(shot, -shot.pretrigger_samples / shot.sample_rate_hz),
        "marks": [{"name": name, "time_s": time_s, "height_v": v} for name, (time_s, v) in marks.items()],
        "flags": features.flags,
    }
