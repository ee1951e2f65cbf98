"""Through NI's package and the driver come the twin's counts, bit for bit, whatever board and shot."""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.daqmx_models import running_brain
from support.daqmx_rig import board, counts_of_the_twin, meet, parameters_of, quick_description, take, why_no

from hardware_drivers.daqmx import open_daqmx
from hardware_drivers.measurement import ShotKey
from simulator.doubles.chassis.description import (
    SIMULTANEOUS_12_BIT,
    SIMULTANEOUS_16_BIT,
    SIMULTANEOUS_18_BIT,
)

BOARDS = {"16 bit": SIMULTANEOUS_16_BIT, "18 bit": SIMULTANEOUS_18_BIT, "12 bit": SIMULTANEOUS_12_BIT}


@pytest.fixture(params=["library", "grpc"], scope="module")
def transport(request):
    if reason := why_no(request.param):
        pytest.skip(reason)
    return request.param


@pytest.fixture(params=BOARDS.values(), ids=BOARDS.keys(), scope="module")
def opened(request, transport):
    """Yield one open rig for all shots: within a turn nothing is created."""
    description = quick_description(board(request.param), positions="CD")
    with ExitStack() as stack:
        doubles = stack.enter_context(running_brain(description))
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        if transport == "library":
            meet(doubles, patch)
        parameters = parameters_of(description, doubles, transport=transport)
        yield description, doubles, parameters, stack.enter_context(open_daqmx(parameters))


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    position=st.sampled_from("CD"),
    set_index=st.integers(0, 10_000),
    shot_index=st.integers(0, 9),
)
def test_counts_are_the_twins_bit_for_bit(opened, position, set_index, shot_index):
    description, doubles, parameters, rig = opened
    key = ShotKey(position=position, set_index=set_index, shot_index=shot_index)
    acquired = take(rig, doubles, key)
    expected = counts_of_the_twin(description, parameters, key)
    assert acquired.waveform.counts.dtype == expected.dtype
    np.testing.assert_array_equal(acquired.waveform.counts, expected)


def test_volts_follow_the_polynomial_of_the_board(opened):
    """A slope of range / 2**n would be off by the 2 % that the codes reach beyond the range."""
    description, doubles, _, rig = opened
    waveform = take(rig, doubles, ShotKey(position="C", set_index=0, shot_index=0)).waveform
    mine = description.boards[0]
    half = 2.0 ** (mine.kind.resolution_bits - 1)
    codes = waveform.counts.astype(np.float64)
    straight = mine.offset_v + 5.0 * (1.0 + mine.over_range_fraction) * (1.0 + mine.gain_error_fraction) * (
        codes / half
    )
    bent = 5.0 * (mine.quadratic_fraction * (codes / half) ** 2 + mine.cubic_fraction * (codes / half) ** 3)
    # Two ways to sum four terms of at most 6 V: some units in the last place.
    np.testing.assert_allclose(waveform.volts(), straight + bent, rtol=0.0, atol=1e-14)
    assert waveform.calibration.resolution_bits == mine.kind.resolution_bits
