"""Records reduced to cells of extremes; pure functions.

A record's samples count from its anchor: the trigger, or the time at which its first pulse or echo was found.
The first sample not before the anchor is number 0, and cell c holds the samples c width .. (c + 1) width - 1.
So a sample lies in the cell into which its time after the anchor falls, whatever fraction of a sample the
anchor has: nothing is interpolated, and no single sample is ever lost or made.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from daq_service.archive.records import Results, SetRecord
from hardware_drivers.measurement import PulseEchoRecord, Shot, Waveform

Alignment = Literal["trigger", "first"]
"""At the trigger, or at the first pulse (ISW) or echo that was found in the record."""
ALIGNMENTS: tuple[Alignment, ...] = get_args(Alignment)
MOST_CELLS = 1024
"""Of one record in a tile."""
Planes = NDArray[np.float32]
"""Shape (2, n_cells): least and greatest volts of each cell, NaN where there is no sample."""
_ON_A_SAMPLE = 1e-6
"""In samples: an anchor that lies on a sample is that sample, though times in seconds are rounded."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """The cells of a position's records.

    Attributes
    ----------
    width
        Samples of a cell, a power of two.
    first
        Number of the first cell; it begins ``first * width`` samples after the anchor.
    n_samples
        Of the records for which it was made.
    """

    sample_rate_hz: float
    n_samples: int
    width: int
    first: int
    n_cells: int

    @property
    def cell_s(self) -> float:
        """Seconds of a cell."""
        return self.width / self.sample_rate_hz

    @property
    def first_s(self) -> float:
        """Where the first cell begins, in seconds after the anchor."""
        return self.first * self.cell_s

    def part(self, from_s: float | None, to_s: float | None, width: int) -> Frame:
        """Cells of another width that cover a range of times inside this frame; empty beside it."""
        begin, end = self.first * self.width, (self.first + self.n_cells) * self.width
        if from_s is not None:
            begin = max(begin, math.floor(from_s * self.sample_rate_hz))
        if to_s is not None:
            end = min(end, math.ceil(to_s * self.sample_rate_hz))
        first = begin // width
        return replace(self, width=width, first=first, n_cells=max(0, -(-end // width) - first))


def frame_of(waveform: Waveform, alignment: Alignment) -> Frame:
    """Frame of all records that are sampled like this one.

    At the trigger it holds the whole record; at the first pulse it reaches from half a record before it to a
    whole record after it.
    """
    n_samples = int(waveform.counts.size)
    width = 1
    while n_samples > MOST_CELLS * width:
        width *= 2
    before = waveform.pretrigger_samples if alignment == "trigger" else n_samples // 2
    end = n_samples - (waveform.pretrigger_samples if alignment == "trigger" else 0)
    first = -before // width
    return Frame(
        sample_rate_hz=waveform.sample_rate_hz,
        n_samples=n_samples,
        width=width,
        first=first,
        n_cells=-(-end // width) - first,
    )


def anchors_of(results: Results) -> dict[int, float]:
    """Shot id to the time of the first pulse or echo after the trigger, where one was found."""
    found: dict[int, float] = {}
    for table, column in (("features", "isw_time_s"), ("thickness", "travel_time_s")):
        rows = results.get(table, {})
        pairs = zip(rows.get("shot_id", ()), rows.get(column, ()), strict=True)
        found.update((int(shot), float(time_s)) for shot, time_s in pairs if math.isfinite(float(time_s)))
    return found


def nothing(frame: Frame) -> Planes:
    """Cells without a sample."""
    return np.full((2, frame.n_cells), np.nan, dtype=np.float32)


def merged(rows: Iterable[Planes]) -> Planes:
    """Extremes of several rows of one frame."""
    lows, highs = zip(*rows, strict=True)
    return np.stack([np.fmin.reduce(lows), np.fmax.reduce(highs)])


def of_record(waveform: Waveform, anchor_s: float, frame: Frame) -> Planes | None:
    """Cells of one record; None: it has another rate."""
    if waveform.sample_rate_hz != frame.sample_rate_hz:
        return None
    anchor = waveform.pretrigger_samples + anchor_s * waveform.sample_rate_hz
    origin = math.ceil(anchor - _ON_A_SAMPLE)
    planes, size = nothing(frame), int(waveform.counts.size)
    first = max(frame.first, -origin // frame.width)
    end = min(frame.first + frame.n_cells, (size - 1 - origin) // frame.width + 1)
    if first < end:
        starts = np.maximum(np.arange(first, end) * frame.width + origin, 0)
        stop = min(end * frame.width + origin, size)
        volts, inside = waveform.volts()[:stop], slice(first - frame.first, end - frame.first)
        planes[0, inside] = np.minimum.reduceat(volts, starts)
        planes[1, inside] = np.maximum.reduceat(volts, starts)
    return planes


def of_set(
    record: SetRecord, position: str, alignment: Alignment, anchors: Mapping[int, float], frame: Frame
) -> Planes:
    """Cells of all accepted records of a set at a position that can be placed; maybe of none."""
    rows = [
        of_record(taken.waveform, 0.0 if alignment == "trigger" else anchors[taken.sequence], frame)
        for taken in accepted(record, position)
        if alignment == "trigger" or taken.sequence in anchors
    ]
    return merged([nothing(frame), *(row for row in rows if row is not None)])


def accepted(record: SetRecord, position: str) -> list[Shot | PulseEchoRecord]:
    """Choose the records of a position, of repeated shots the ones that count."""
    return [
        taken
        for taken in record.records
        if taken.key.position == position and record.outcomes.get(taken.sequence, "accepted") == "accepted"
    ]


def coarser(planes: Planes, frame: Frame, part: Frame) -> Planes:
    """Take the cells of a coarser frame, or of a part of it, from those of a finer one.

    Parameters
    ----------
    planes
        Shape (..., 2, frame.n_cells).

    Returns
    -------
    ndarray of float32, shape (..., 2, part.n_cells)
    """
    factor = part.width // frame.width
    begin = part.first * factor - frame.first
    inside = np.full((*planes.shape[:-1], part.n_cells * factor), np.nan, dtype=np.float32)
    low, high = max(0, begin), min(frame.n_cells, begin + inside.shape[-1])
    if low < high:
        inside[..., low - begin : high - begin] = planes[..., low:high]
    cells = inside.reshape(*planes.shape[:-1], part.n_cells, factor)
    least = np.fmin.reduce(cells[..., 0, :, :], axis=-1)
    greatest = np.fmax.reduce(cells[..., 1, :, :], axis=-1)
    return np.stack([least, greatest], axis=-2)
