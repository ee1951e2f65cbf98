"""Live figures: one small file per position with its latest waveform.

It is a picture, never a source of truth: written without fsync, at most ten times a second, and
replaced by rename, so a reader always sees a whole one. Layout: u32 little-endian length of the
JSON header, the header padded with spaces until the samples start at a multiple of 8, samples.
"""

from __future__ import annotations

import json
import logging
import math
import struct
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from analysis.waves.features import ShotFeatures
from daq_service.background.task import BackgroundTask
from daq_service.clock import MACHINE, MachineClock
from daq_service.shared_file import write_best_effort
from hardware_drivers.measurement import PulseEchoRecord, Shot, Waveform
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

SHORTEST_INTERVAL_NS, LONGEST_INTERVAL_NS = NS_PER_S // 10, NS_PER_S
COSTS_BETWEEN = 100
"""All positions' pictures together take a hundredth of the time: a slow disk makes them rarer, down to one a
second."""
MARKS = ("isw_time_s", "isw_amplitude_v", "psw_time_s", "psw_amplitude_v", "ssw_time_s", "ssw_amplitude_v")


def encode_live_figure(header: Mapping[str, Any], waveform: Waveform) -> bytes:
    """Encode a header and the ADC codes of a waveform as the bytes of a live file and of a live message.

    Layout: u32 length of the header, JSON header, padded until the samples start at a multiple of 8, samples;
    all little-endian.

    Raises
    ------
    ValueError
        A number of the header is not finite.
    TypeError
        JSON cannot hold a value of the header.
    """
    text = json.dumps(dict(header), separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-(4 + len(text)) % 8)
    samples = waveform.counts.astype(waveform.counts.dtype.newbyteorder("<"), copy=False)
    return struct.pack("<I", len(text)) + text + samples.tobytes()


class LiveFigure(BackgroundTask):
    """Writer of the live files of one data folder."""

    def __init__(self, folder: Path, rig_kind: str, *, machine: MachineClock = MACHINE) -> None:
        self._folder = folder / "live"
        with suppress(OSError):  # the first picture tells
            self._folder.mkdir(exist_ok=True)
        self._rig_kind = rig_kind
        self._machine = machine
        self._written_ns: dict[str, int] = {}
        self._cost_ns = 0
        self._refused: int | None = None

    def due(self, position: str) -> bool:
        """Return whether the live figure of a position is due for an update; the first one always is.

        The interval since the last one, 0.1 to 1 s, grows with the number of positions and the time that
        writing takes (`COSTS_BETWEEN`).
        """
        last = self._written_ns.get(position)
        pause_ns = COSTS_BETWEEN * len(self._written_ns) * self._cost_ns
        pause_ns = min(max(pause_ns, SHORTEST_INTERVAL_NS), LONGEST_INTERVAL_NS)
        return last is None or self._machine.mono_ns() - last >= pause_ns

    def show(
        self, measurement: Shot | PulseEchoRecord, *, due_h: float, features: ShotFeatures | None
    ) -> None:
        """Replace the live figure file of a position by a record, whether it is due or not.

        An OSError is logged as a warning once until its errno changes, and not raised: the figure is lost,
        not the shot.

        Parameters
        ----------
        due_h
            Scheduled hour of the test.
        features
            Features of a shot: their times, amplitudes and flags are marked; None: no marks.
        """
        waveform, key = measurement.waveform, measurement.key
        started_ns = self._machine.mono_ns()
        values = {} if features is None else features.values()
        header = {
            "position": key.position,
            "method": measurement.method,
            "sequence": measurement.sequence,
            **key.set_key._asdict(),
            "shot_index": key.shot_index,
            "utc_ns": measurement.stamp.utc_ns,
            "due_h": due_h,
            "sample_rate_hz": waveform.sample_rate_hz,
            "pretrigger_samples": waveform.pretrigger_samples,
            "coefficients_v": waveform.calibration.coefficients_v.tolist(),
            "dtype": waveform.counts.dtype.name,
            "flags": [] if features is None else list(features.flags),
            "marks": {name: _none_if_not_finite(values.get(name)) for name in MARKS},
            "written_wall_utc_ns": time.time_ns(),
            "rig": self._rig_kind,
        }
        error = write_best_effort(self._folder / f"{key.position}.bin", encode_live_figure(header, waveform))
        refused = None if error is None else error.errno
        if error is not None and refused != self._refused:
            # Once for a full disk, not ten times a second. Windows refuses while somebody reads the old one.
            log.warning("no live picture of %s: %s", key.position, error)
        self._refused = refused
        self._written_ns[key.position] = now_ns = self._machine.mono_ns()
        self._cost_ns = now_ns - started_ns


def _none_if_not_finite(value: float | None) -> float | None:
    """Return the value, or None if it is None, NaN or infinite."""
    return None if value is None or not math.isfinite(value) else value
