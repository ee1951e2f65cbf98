"""Analog input: coercion, triggers in wall time, and codes that are the twin's to the last bit."""

import math

import numpy as np
import pytest
from support.daqmx_rig import counts_of_the_twin, parameters_of
from support.doubles_bench import Caller, SteppedClock

from hardware_drivers.measurement import ShotKey
from simulator.doubles.chassis.description import build_default_description
from simulator.doubles.device_model import Brain
from simulator.doubles.vendor_api.statuses import Status
from simulator.parameters.electronics import NoiseParameters
from simulator.parameters.experiment import TwinParameters

QUIET = TwinParameters(noise=NoiseParameters(enabled=False))
BOARDS = {"B": "PXI1Slot2", "C": "PXI1Slot3", "D": "PXI1Slot4"}
"""Positions and boards of the default description: 18, 16 and 12 bits."""
RESOLUTION, RAW_SIZE, COEFFICIENTS, MAXIMUM, RATE = 0x1765, 0x22DA, 0x1930, 0x1815, 0x1344
COUPLING, DC, AC = 0x64, 10050, 10045
FALL_G = 9.81


@pytest.fixture
def brain():
    return Brain(build_default_description(QUIET), clock=SteppedClock())


@pytest.fixture
def me(brain):
    return Caller(brain)


def strike(me, position, digitizer, **times):
    """Fire the coil of a position and wait for the record."""
    coil = me.coil(f"{BOARDS[position]}/ctr0", **times)
    me("StartTask", digitizer)
    me("StartTask", coil)
    me("WaitUntilTaskDone", digitizer, time_to_wait=1.0)
    return coil


def read(me, task, wide, **arguments):
    function = "ReadBinaryI32" if wide else "ReadBinaryI16"
    return me(function, task, **{"timeout": 1.0} | arguments)["read_array"]


# The property on which everything rests


@pytest.mark.parametrize(
    ("position", "shot"), [("B", (0, 0, 0.0)), ("C", (41, 7, 20.5)), ("D", (300, 3, 225.0))]
)
def test_codes_are_the_twin_s_bit_for_bit(brain, me, position, shot):
    set_index, shot_index, hour_h = shot
    key = ShotKey(position=position, set_index=set_index, shot_index=shot_index)
    task = me.digitizer(f"{BOARDS[position]}/ai0")
    brain.announce(key, hour_h)
    strike(me, position, task)
    resolution = int(me("GetChanAttribute", task, attribute=RESOLUTION)["value"])
    codes = read(me, task, me("GetChanAttribute", task, attribute=RAW_SIZE)["value"] == 32)
    description = brain.bench.description
    # The twin by itself, with only the figures of the board's kind.
    expected = counts_of_the_twin(description, parameters_of(description, None), key, hour_h)
    np.testing.assert_array_equal(codes, expected)
    assert resolution == {"B": 18, "C": 16, "D": 12}[position]


def test_without_announcements_strikes_are_counted_into_sets(brain, me):
    task = me.digitizer("PXI1Slot3/ai0")
    for _ in range(11):
        coil = strike(me, "C", task)
        me("StopTask", task)
        me("ClearTask", coil)
    keys = [(found["set_index"], found["shot_index"]) for found in brain.record()["strikes"]]
    assert keys == [*((0, index) for index in range(10)), (1, 0)]


def test_a_cancelled_strike_is_not_counted(brain, me):
    coil = me.coil("PXI1Slot3/ctr0")
    me("StartTask", coil)
    with pytest.raises(Status, match="200010"):
        me("StopTask", coil)
    me("StartTask", coil)
    (found,) = brain.record()["strikes"]
    assert (found["set_index"], found["shot_index"]) == (0, 0)


def test_an_announcement_holds_for_one_strike(brain, me):
    brain.announce(ShotKey(position="C", set_index=7, shot_index=2), 3.5)
    task = me.digitizer("PXI1Slot3/ai0")
    for _ in range(2):
        me("ClearTask", strike(me, "C", task))
        me("StopTask", task)
    first, second = brain.record()["strikes"]
    assert (first["set_index"], first["shot_index"], first["hour_h"]) == (7, 2, 3.5)
    assert (second["set_index"], second["shot_index"], second["hour_h"]) == (0, 0, 3.5)


# Time


def test_the_wave_comes_when_a_striker_that_fell_from_its_height_meets_the_chain(brain, me):
    task = me.digitizer("PXI1Slot3/ai0")
    strike(me, "C", task, initial_delay=0.0, high_time=0.02)
    (found,) = brain.record()["strikes"]
    high, low = brain.record()["lines"]
    key = ShotKey(position="C", set_index=0, shot_index=0)
    height_m = brain.bench.strikes.specimen.strike(key, 0.0).drop_height_m
    assert low["ns"] - high["ns"] == 20_000_000
    # Rounded to whole nanoseconds.
    assert found["contact_ns"] - low["ns"] == round(math.sqrt(2.0 * height_m / FALL_G) * 1e9)
    # Done with the last of the 12,600 samples after the trigger, which comes about 0.1 ms after contact.
    done_ns = brain.bench.clock.now_ns()
    assert 1_260_000 + 50_000 < done_ns - found["contact_ns"] < 1_260_000 + 200_000


@pytest.mark.parametrize(("late_ns", "heard"), [(-20_000, True), (20_000, False)])
def test_a_wave_before_the_pretrigger_is_full_triggers_nothing(brain, me, late_ns, heard):
    task, coil = me.digitizer("PXI1Slot3/ai0"), me.coil("PXI1Slot3/ctr0", initial_delay=0.0)
    me("StartTask", coil)
    (strike,) = brain.record()["strikes"]
    key = ShotKey(position="C", set_index=0, shot_index=0)
    travel_s = brain.bench.strikes.specimen.simulate_wave(key, 0.0).truth["trigger_time_s"]
    # 1000 samples at 10 MS/s are 100 us: start so that they are full just before the wave, or just after.
    brain.bench.clock.time_ns = strike["contact_ns"] + round(travel_s * 1e9) - 100_000 + late_ns
    me("StartTask", task)
    if heard:
        assert read(me, task, wide=False, timeout=0.5).size == 13_600
        return
    with pytest.raises(Status) as caught:
        read(me, task, wide=False, timeout=0.5)
    assert caught.value.code == -200284
    assert caught.value.values["samps_per_chan_read"] == 0
    assert "read_array" not in caught.value.values


def test_nothing_triggers_without_a_strike(brain, me):
    task = me.digitizer("PXI1Slot3/ai0")
    me("StartTask", task)
    began_ns = brain.bench.clock.now_ns()
    with pytest.raises(Status) as caught:
        me("WaitUntilTaskDone", task, time_to_wait=0.25)
    assert caught.value.code == -200560
    assert brain.bench.clock.now_ns() - began_ns == 250_000_000
    assert not me.is_done(task)


def test_another_position_s_strike_triggers_nothing_here(brain, me):
    task, coil = me.digitizer("PXI1Slot3/ai0"), me.coil("PXI1Slot2/ctr0")
    me("StartTask", task)
    me("StartTask", coil)
    with pytest.raises(Status, match="-200560"):
        me("WaitUntilTaskDone", task, time_to_wait=0.2)


def test_a_coil_cut_early_drops_its_striker_early(brain, me):
    task, coil = me.digitizer("PXI1Slot3/ai0"), me.coil("PXI1Slot3/ctr0", initial_delay=0.0, high_time=0.5)
    me("StartTask", task)
    me("StartTask", coil)
    # A record that was looked for meanwhile must not stick to the old time.
    assert not me.is_done(task)
    brain.bench.clock.pass_s(0.03)
    with pytest.raises(Status, match="200010"):
        me("StopTask", coil)
    me("WaitUntilTaskDone", task, time_to_wait=0.1)
    (found,) = brain.record()["strikes"]
    assert found["released_ns"] - found["lifted_ns"] == 30_000_000


@pytest.mark.parametrize("held_s", [0.0, 0.004])
def test_a_striker_that_was_hardly_lifted_strikes_nothing(brain, me, held_s):
    task, coil = me.digitizer("PXI1Slot3/ai0"), me.coil("PXI1Slot3/ctr0", initial_delay=0.0)
    brain.announce(ShotKey(position="C", set_index=9, shot_index=9), 1.0)
    me("StartTask", task)
    me("StartTask", coil)
    brain.bench.clock.pass_s(held_s)
    with pytest.raises(Status, match="200010"):
        me("StopTask", coil)
    with pytest.raises(Status, match="-200560"):
        me("WaitUntilTaskDone", task, time_to_wait=0.2)
    assert brain.record()["strikes"] == []
    # The shot that was announced is still to come.
    me("StartTask", coil)
    (found,) = brain.record()["strikes"]
    assert (found["set_index"], found["shot_index"]) == (9, 9)


# Coercion and refusals


@pytest.mark.parametrize(
    ("board", "asked_hz", "given_hz"),
    [
        ("PXI1Slot3", 10e6, 10e6),
        ("PXI1Slot3", 3.3e6, 100e6 / 30),
        ("PXI1Slot3", 100e6 / 7, 100e6 / 7),
        ("PXI1Slot4", 3.3e6, 20e6 / 6),
        ("Dev1", 250e3, 250e3),
        ("Dev1", 30e3, 20e6 / 666),
    ],
)
def test_rates_divide_the_timebase(me, board, asked_hz, given_hz):
    task = me.digitizer(f"{board}/ai0", rate=asked_hz)
    assert me("GetTimingAttribute", task, attribute=RATE)["value"] == given_hz
    assert given_hz >= asked_hz


@pytest.mark.parametrize(
    ("channels", "rate_hz"),
    [
        ("PXI1Slot3/ai0", 14.3e6),
        ("PXI1Slot4/ai0", 10.1e6),
        ("Dev1/ai0", 10e6),
        ("PXI1Slot3/ai0", 0.0),
        ("PXI1Slot3/ai0", math.nan),
    ],
)
def test_a_rate_beyond_the_board_is_refused_with_its_limit(me, channels, rate_hz):
    task = me.digitizer(channels, rate=rate_hz)
    with pytest.raises(Status, match="Maximum Value") as caught:
        me("StartTask", task)
    assert caught.value.code == -200077


@pytest.mark.parametrize(
    ("board", "asked_v", "given_v"),
    [("PXI1Slot3", 1.0, 1.0), ("PXI1Slot3", 2.5, 5.0), ("PXI1Slot4", 30.0, 42.0), ("Dev1", 0.25, 1.0)],
)
def test_ranges_are_those_of_the_board(me, board, asked_v, given_v):
    task = me.digitizer(f"{board}/ai0", range_v=asked_v)
    assert me("GetChanAttribute", task, attribute=MAXIMUM)["value"] == given_v


def test_a_range_beyond_the_board_is_refused(me):
    task = me.digitizer("PXI1Slot3/ai0", range_v=12.0)
    with pytest.raises(Status, match="-200077"):
        me("StartTask", task)


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"pretrigger": 1}, -200213),
        ({"pretrigger": 13_599}, -200213),
        ({"samples": 1, "pretrigger": 2}, -200077),
        ({"level": 5.0}, -200077),
        ({"level": -0.1}, -200077),
    ],
)
def test_impossible_records_and_triggers_are_refused(me, changes, code):
    task = me.digitizer("PXI1Slot3/ai0", **changes)
    with pytest.raises(Status) as caught:
        me("StartTask", task)
    assert caught.value.code == code


def test_a_trigger_on_a_channel_outside_the_task_is_refused(me):
    task = me.digitizer("PXI1Slot3/ai0")
    me("CfgAnlgEdgeRefTrig", task, trigger_source="PXI1Slot3/ai1", trigger_level=0.25, pretrigger_samples=9)
    with pytest.raises(Status, match="-200265"):
        me("StartTask", task)


def test_the_minimum_limit_must_be_the_smaller_one(me):
    task = me("CreateTask")["task"]
    with pytest.raises(Status, match="-200082"):
        me("CreateAIVoltageChan", task, physical_channel="Dev1/ai0", min_val=1.0, max_val=1.0)


def test_a_coupling_that_the_board_has_is_taken_and_no_other(me):
    task = me.digitizer("PXI1Slot3/ai0")
    me("SetChanAttribute", task, attribute=COUPLING, value=DC)
    assert me("GetChanAttribute", task, attribute=COUPLING)["value"] == DC
    with pytest.raises(Status, match="-200077"):
        me("SetChanAttribute", task, attribute=COUPLING, value=AC)


# Reading


def test_eighteen_bits_do_not_go_into_sixteen(me):
    task = me.digitizer("PXI1Slot2/ai0")
    strike(me, "B", task)
    with pytest.raises(Status) as caught:
        read(me, task, wide=False)
    assert caught.value.code == -200789
    assert read(me, task, wide=True).dtype == np.int32


def test_sixteen_bits_go_into_thirty_two(me):
    task = me.digitizer("PXI1Slot3/ai0")
    strike(me, "C", task)
    assert read(me, task, wide=True).max() > 2**10


def test_codes_are_clipped_at_the_ends_of_the_range(brain, me):
    for position, bits in (("B", 18), ("C", 16), ("D", 12)):
        task = me.digitizer(f"{BOARDS[position]}/ai0", range_v=1.0)
        strike(me, position, task)
        codes = read(me, task, wide=bits > 16)
        assert codes.max() == 2 ** (bits - 1) - 1
        # Two per cent beyond the range, less the errors of gain (0.08 %) and offset (0.12 %).
        volts = np.polynomial.polynomial.polyval(
            float(codes.max()), me("GetChanAttribute", task, attribute=COEFFICIENTS)["value"]
        )
        assert volts == pytest.approx(1.02, rel=3e-3)
        me("ClearTask", task)


def test_a_record_is_read_in_pieces_and_never_beyond_its_end(me):
    task = me.digitizer("PXI1Slot3/ai0")
    strike(me, "C", task)
    first = read(me, task, wide=False, num_samps_per_chan=600)
    rest = read(me, task, wide=False)
    assert (first.size, rest.size) == (600, 13_000)
    with pytest.raises(Status, match="-200278"):
        read(me, task, wide=False, num_samps_per_chan=1)


def test_a_buffer_without_room_is_refused_and_nothing_is_lost(me):
    task = me.digitizer("PXI1Slot3/ai0")
    strike(me, "C", task)
    with pytest.raises(Status, match="-200229"):
        read(me, task, wide=False, array_size_in_samps=13_599)
    assert read(me, task, wide=False).size == 13_600


def test_without_a_trigger_the_record_is_the_noise_floor():
    rms_v = 0.02
    noise = NoiseParameters(rms_v=rms_v, slow_rms_v=0.0)
    brain = Brain(build_default_description(TwinParameters(noise=noise)), clock=SteppedClock())
    me = Caller(brain)
    task = me.digitizer("PXI1Slot3/ai0")
    me("DisableRefTrig", task)
    codes = read(me, task, wide=False)
    volts = np.polynomial.polynomial.polyval(
        codes.astype(float), me("GetChanAttribute", task, attribute=COEFFICIENTS)["value"]
    )
    # The rms of 13,600 samples scatters by 1 / sqrt(2 n) = 0.6 %: five of these.
    assert np.std(volts) == pytest.approx(rms_v, rel=0.03)
    # 13,600 samples at 10 MS/s.
    assert brain.bench.clock.now_ns() - 1_000_000_000 == 1_360_000


def test_a_read_starts_the_task(brain, me):
    task = me.digitizer("PXI1Slot3/ai0")
    with pytest.raises(Status, match="-200284"):
        read(me, task, wide=False, timeout=0.0)
    assert brain.record()["tasks"][0]["state"] == "running"
