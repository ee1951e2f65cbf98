"""Records reduced to cells: compared with the definition sample by sample and with known shifts."""

import math

import numpy as np
import pytest
from support.archived_sets import CURVED, make_shot
from support.synthetic_records import Scene

from daq_service.archive.waterfall.cells import build_frame, coarsen, compute_record_planes, extract_anchors


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
    whole = build_frame(waveform, alignment)
    frame = whole.part(None, None, width)
    expected = by_definition(waveform, anchor_s, frame)
    np.testing.assert_array_equal(compute_record_planes([(waveform, anchor_s)], frame), expected)


def test_a_frame_covers_the_whole_record_in_few_cells():
    waveform = Scene().waveform()
    frame = build_frame(waveform, "trigger")
    assert (frame.width, frame.n_cells <= 1024) == (16, True)
    planes = compute_record_planes([(waveform, 0.0)], frame)
    assert np.isfinite(planes).all()
    assert planes[0].min() == np.float32(waveform.volts().min())
    assert frame.first_s <= -waveform.pretrigger_samples / waveform.sample_rate_hz
    aligned = build_frame(waveform, "first")
    assert aligned.first_s == pytest.approx(-0.5 * 13_000 / 10e6, abs=aligned.cell_s)


@pytest.mark.parametrize("span", [(None, None), (-20e-6, 3e-6), (5e-6, 5.1e-6), (1.0, 2.0)])
def test_coarser_cells_are_those_of_the_record(span):
    waveform = make_shot("B", 0, 3).waveform
    finest = build_frame(waveform, "first").part(None, None, 1)
    row = compute_record_planes([(waveform, 2.34e-6)], finest)
    for width in (1, 2, 8, 128):
        part = finest.part(*span, width)
        np.testing.assert_array_equal(
            coarsen(row, finest, part), compute_record_planes([(waveform, 2.34e-6)], part)
        )


def test_records_of_another_rate_are_not_placed_and_anchors_are_those_that_were_found():
    frame = build_frame(make_shot("B", 0, 1).waveform, "trigger")
    other_rate = make_shot("B", 0, 1, rate_hz=2e7).waveform
    assert np.isnan(compute_record_planes([(other_rate, 0.0)], frame)).all()
    results = {
        "features": {"shot_id": [1, 2], "isw_time_s": [1e-6, math.nan]},
        "set_features": {"isw_time_s": [9.0]},
        "thickness": {"shot_id": [3], "travel_time_s": [2e-6]},
    }
    assert extract_anchors(results) == {1: 1e-6, 3: 2e-6}
