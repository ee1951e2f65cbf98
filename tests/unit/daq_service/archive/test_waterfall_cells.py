"""Records reduced to cells: compared with the definition sample by sample and with known shifts."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.archived_sets import CURVED, make_shot
from support.synthetic_records import Scene

from daq_service.archive.waterfall.cells import (
    anchors_of,
    coarsen,
    frame_of,
    merge_planes,
    planes_of_records,
)


def by_definition(waveform, anchor_s, frame):
    """Put each sample into the cell of its time after the anchor."""
    planes = np.full((2, frame.n_cells), np.nan, dtype=np.float32)
    for sample, volts in enumerate(waveform.volts().astype(np.float32)):
        after = round((sample - waveform.pretrigger_samples) - anchor_s * waveform.sample_rate_hz, 9)
        # As times after the anchor are counted: the first sample not before it is number 0.
        cell = math.floor(math.floor(after) / frame.width) - frame.first
        if 0 <= cell < frame.n_cells:
            planes[0, cell] = np.fmin(planes[0, cell], volts)
            planes[1, cell] = np.fmax(planes[1, cell], volts)
    return planes


@pytest.mark.parametrize("alignment", ["trigger", "first"])
@pytest.mark.parametrize("width", [1, 4, 32])
@pytest.mark.parametrize("anchor_s", [0.0, 1e-7, 3.14159e-6, -2.2e-6, 19.99e-6])
def test_each_sample_is_in_the_cell_of_its_time(alignment, width, anchor_s):
    waveform = make_shot("B", 0, 1, calibration=CURVED).waveform
    whole = frame_of(waveform, alignment)
    frame = whole.part(None, None, width)
    expected = by_definition(waveform, anchor_s, frame)
    np.testing.assert_array_equal(planes_of_records([(waveform, anchor_s)], frame), expected)


def test_a_frame_covers_the_whole_record_in_few_cells():
    waveform = Scene().waveform()
    frame = frame_of(waveform, "trigger")
    assert (frame.width, frame.n_cells <= 1024) == (16, True)
    planes = planes_of_records([(waveform, 0.0)], frame)
    assert np.isfinite(planes).all()
    assert planes[0].min() == np.float32(waveform.volts().min())
    assert frame.first_s <= -waveform.pretrigger_samples / waveform.sample_rate_hz
    aligned = frame_of(waveform, "first")
    assert aligned.first_s == pytest.approx(-0.5 * 13_000 / 10e6, abs=aligned.cell_s)


def test_records_shifted_by_fractions_of_a_sample_are_aligned():
    """The same pulse at 64 fractions of a sample: after alignment no peak is a cell off."""
    scene = Scene(ssw_fraction=0.0)
    frame = frame_of(scene.waveform(), "first").part(None, None, 1)
    peaks, at_trigger = [], []
    for k in range(64):
        moved = scene.with_(isw_time_s=50e-6 + k * 0.37e-7)
        row = planes_of_records([(moved.waveform(), moved.isw_time_s)], frame)
        peaks.append(int(np.nanargmax(row[1])) + frame.first)
        unmoved = planes_of_records([(moved.waveform(), 0.0)], frame)
        at_trigger.append(int(np.nanargmax(unmoved[1])) + frame.first)
    # A maximum between two samples appears at one of them, with a quantized flat top at a neighbor.
    assert max(peaks) - min(peaks) <= 3
    assert max(at_trigger) - min(at_trigger) == pytest.approx(63 * 0.37, abs=3)


def test_whole_samples_are_shifted_exactly():
    scene = Scene(noise_fraction=0.01)
    waveform = scene.waveform()
    frame = frame_of(waveform, "first")
    row = planes_of_records([(waveform, 50e-6)], frame)
    # As many cells later, to the last bit: 160 samples are 10 cells of 16.
    later = planes_of_records([(waveform, 50e-6 - 160 / waveform.sample_rate_hz)], frame)
    np.testing.assert_array_equal(later[:, 10:], row[:, :-10])


def test_a_single_sample_survives_at_every_width():
    waveform = Scene().waveform()
    counts = waveform.counts.copy()
    counts[7_777] = -32_000
    spiked = replace(waveform, counts=counts)
    spike = np.float32(spiked.volts()[7_777])
    frame = frame_of(waveform, "trigger")
    row = merge_planes([planes_of_records([(item, 0.0)], frame) for item in (waveform, spiked, waveform)])
    for width in (16, 32, 64, 256, 1024, 16_384):
        part = frame.part(None, None, width)
        its = coarsen(row, frame, part)
        assert np.nanmin(its) == spike
        assert np.nanargmin(its[0]) + part.first == (7_777 - 1_000) // width


@pytest.mark.parametrize("span", [(None, None), (-20e-6, 3e-6), (5e-6, 5.1e-6), (1.0, 2.0)])
def test_coarser_cells_are_those_of_the_record(span):
    waveform = make_shot("B", 0, 3).waveform
    finest = frame_of(waveform, "first").part(None, None, 1)
    row = planes_of_records([(waveform, 2.34e-6)], finest)
    for width in (1, 2, 8, 128):
        part = finest.part(*span, width)
        np.testing.assert_array_equal(
            coarsen(row, finest, part), planes_of_records([(waveform, 2.34e-6)], part)
        )


def test_records_of_another_rate_are_not_placed_and_anchors_are_those_that_were_found():
    frame = frame_of(make_shot("B", 0, 1).waveform, "trigger")
    other_rate = make_shot("B", 0, 1, rate_hz=2e7).waveform
    assert np.isnan(planes_of_records([(other_rate, 0.0)], frame)).all()
    results = {
        "features": {"shot_id": [1, 2], "isw_time_s": [1e-6, math.nan]},
        "set_features": {"isw_time_s": [9.0]},
        "thickness": {"shot_id": [3], "travel_time_s": [2e-6]},
    }
    assert anchors_of(results) == {1: 1e-6, 3: 2e-6}
