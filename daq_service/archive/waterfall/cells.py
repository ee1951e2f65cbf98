"""Reduce records to cells of extremes; pure functions.

The samples of a record count from its anchor: the trigger, or the time of its first detected pulse or echo.
The first sample not before the anchor is number 0, and cell c holds the samples c width .. (c + 1) width - 1.
A sample belongs to the cell that contains its time after the anchor, for any fractional position of the
anchor: nothing is interpolated, and no sample is lost or added.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hardware_drivers.measurement import PulseEchoRecord, Results, SetRecord, Shot, Waveform

Alignment = Literal["trigger", "first"]
"""Anchor of a record: the trigger, or its first detected pulse (ISW) or echo."""
ALIGNMENTS: tuple[Alignment, ...] = get_args(Alignment)
MAX_CELLS = 1024
"""Maximum number of cells of a record in a tile."""
Planes = NDArray[np.float32]
"""Shape (2, n_cells): minimum and maximum volts of each cell, NaN if there is no sample."""
_ON_A_SAMPLE = 1e-6
"""Tolerance in samples: an anchor this close to a sample is that sample, since times in s are rounded."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """Cells of a position's records.

    Attributes
    ----------
    width
        Samples of a cell, a power of two.
    first
        Index of the first cell; it starts ``first * width`` samples after the anchor.
    n_samples
         Number of samples of the records.
    """

    sample_rate_hz: float
    n_samples: int
    width: int
    first: int
    n_cells: int

    @property
    def cell_s(self) -> float:
        """Return the duration of a cell in s."""
        return self.width / self.sample_rate_hz

    @property
    def first_s(self) -> float:
        """Return the start of the first cell in s after the anchor."""
        return self.first * self.cell_s

    def part(self, from_s: float | None, to_s: float | None, width: int) -> Frame:
        """Return the frame with cells of ``width`` samples that covers a range of times of this frame.

        Times in s after the anchor, None is no limit; outside this frame the result has no cells.
        """
        start, end = self.first * self.width, (self.first + self.n_cells) * self.width
        if from_s is not None:
            start = max(start, math.floor(from_s * self.sample_rate_hz))
        if to_s is not None:
            end = min(end, math.ceil(to_s * self.sample_rate_hz))
        first = start // width
        return replace(self, width=width, first=first, n_cells=max(0, -(-end // width) - first))


def build_frame(waveform: Waveform, alignment: Alignment) -> Frame:
    """Compute the frame for all records with the sampling of a waveform: at most 1024 cells per record.

    Aligned at the trigger it covers the complete record; at the first pulse it extends from half a record
    before to one record after the pulse.
    """
    n_samples = int(waveform.counts.size)
    width = 1
    while n_samples > MAX_CELLS * width:
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


def extract_anchors(results: Results) -> dict[int, float]:
    """Find the time of the first detected pulse or echo, in s after the trigger, by shot id.

    Shots without a finite time are omitted.
    """
    anchors: dict[int, float] = {}
    for table, column in (("features", "isw_time_s"), ("thickness", "travel_time_s")):
        rows = results.get(table, {})
        pairs = zip(rows.get("shot_id", ()), rows.get(column, ()), strict=True)
        anchors.update((int(shot), float(time_s)) for shot, time_s in pairs if math.isfinite(float(time_s)))
    return anchors


def new_planes(frame: Frame) -> Planes:
    """Create float32 planes of a frame without any sample: NaN, shape (2, n_cells)."""
    return np.full((2, frame.n_cells), np.nan, dtype=np.float32)


def merge_planes(rows: Iterable[Planes]) -> Planes:
    """Compute minimum and maximum over the planes of one or more rows of one frame; NaN without any sample.

    ValueError without a row.
    """
    lows, highs = zip(*rows, strict=True)
    return np.stack([np.fmin.reduce(lows), np.fmax.reduce(highs)])


def compute_record_planes(placed: Iterable[tuple[Waveform, float]], frame: Frame) -> Planes:
    """Compute the extremes in V of records in each cell of a frame, shape (2, n_cells); NaN without a sample.

    ``placed`` has each record with its anchor in s after the trigger. Records of another sampling rate than
    the frame's are skipped.
    """
    start, size = frame.first * frame.width, frame.n_cells * frame.width
    # Extremes of each sample of the frame first: far fewer cells remain to reduce.
    low, high = np.full(size, np.inf), np.full(size, -np.inf)
    for waveform, anchor_s in placed:
        if waveform.sample_rate_hz != frame.sample_rate_hz:
            continue
        anchor = waveform.pretrigger_samples + anchor_s * waveform.sample_rate_hz
        before = math.ceil(anchor - _ON_A_SAMPLE) + start  # samples of the record ahead of the frame
        volts = waveform.volts()[max(before, 0) : max(before + size, 0)]
        inside = slice(max(-before, 0), max(-before, 0) + volts.size)
        np.minimum(low[inside], volts, out=low[inside])
        np.maximum(high[inside], volts, out=high[inside])
    cells = frame.n_cells, frame.width
    planes = np.stack([low.reshape(cells).min(axis=1), high.reshape(cells).max(axis=1)]).astype(np.float32)
    planes[np.isinf(planes)] = np.nan
    return planes


def compute_planes(
    record: SetRecord, position: str, alignment: Alignment, anchors: Mapping[int, float], frame: Frame
) -> Planes:
    """Compute the extremes in V of the accepted records of a set at a position in each cell of a frame.

    ``anchors`` holds the time of the first pulse or echo in s by shot id; a record without one is skipped,
    unless the alignment is the trigger. The result has shape (2, n_cells), NaN without a sample.
    """
    placed = [
        (item.waveform, 0.0 if alignment == "trigger" else anchors[item.sequence])
        for item in select_accepted_records(record, position)
        if alignment == "trigger" or item.sequence in anchors
    ]
    return compute_record_planes(placed, frame)


def select_accepted_records(record: SetRecord, position: str) -> list[Shot | PulseEchoRecord]:
    """Select the records of a set at a position that no repetition replaces, in order; empty if none."""
    return [
        item
        for item in record.records
        if item.key.position == position and record.outcomes.get(item.sequence, "accepted") == "accepted"
    ]


def coarsen(planes: Planes, frame: Frame, part: Frame) -> Planes:
    """Combine the cells of ``frame`` to the wider ones of ``part``; NaN outside ``frame``.

    Parameters
    ----------
    planes
        Shape (..., 2, frame.n_cells), in V.
    part
        Its width is a multiple of that of ``frame``.

    Returns
    -------
    ndarray of float32, shape (..., 2, part.n_cells)
    """
    factor = part.width // frame.width
    start = part.first * factor - frame.first
    padded = np.full((*planes.shape[:-1], part.n_cells * factor), np.nan, dtype=np.float32)
    low, high = max(0, start), min(frame.n_cells, start + padded.shape[-1])
    if low < high:
        padded[..., low - start : high - start] = planes[..., low:high]
    cells = padded.reshape(*planes.shape[:-1], part.n_cells, factor)
    minimum = np.fmin.reduce(cells[..., 0, :, :], axis=-1)
    maximum = np.fmax.reduce(cells[..., 1, :, :], axis=-1)
    return np.stack([minimum, maximum], axis=-2)
