"""What the coil couples into its sensor, and which record of a shot it takes: start, delay, reference."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.daqmx_rig import QUICK_TWIN, board, quick_description
from support.doubles_bench import Caller, SteppedClock

from hardware_drivers.measurement import ShotKey
from simulator.doubles.chassis.crosstalk import Crosstalk
from simulator.doubles.chassis.description import SIMULTANEOUS_12_BIT, SIMULTANEOUS_18_BIT, SLOW
from simulator.doubles.device_model import Brain
from simulator.doubles.vendor_api.statuses import Status

RATE_HZ = 10e6
NAME = "PXI1Slot3"
CTR0, CTR1 = f"/{NAME}/Ctr0InternalOutput", f"/{NAME}/Ctr1InternalOutput"
RISING, FALLING, SECONDS = 10280, 10171, 10364
DELAY, DELAY_UNITS, SOURCE_EDGE = 0x1856, 0x18C8, 0x1404
PULSE_S = 3e-3
FALL_S = math.sqrt(2.0 * 1e-3 / 9.81)
PRETRIGGER, SAMPLES = 1_000, 13_600
LEVEL_V, CODE_V = 0.25, 5.1 / 2**15
KEY = ShotKey(position="C", set_index=3, shot_index=1)
SPIKE = Crosstalk(on_v=0.6, off_v=-0.4, decay_s=50e-6, ringing_hz=20e3)


def made(*boards):
    return Brain(quick_description(*boards or (board(), SIMULTANEOUS_18_BIT, SLOW)), clock=SteppedClock())


@pytest.fixture
def brain():
    return made()


@pytest.fixture
def me(brain):
    return Caller(brain)


def start_by(me, task, source=CTR0, edge=FALLING, delay_s=None):
    me("CfgDigEdgeStartTrig", task, trigger_source=source, trigger_edge=edge)
    if delay_s is not None:
        me("SetTrigAttribute", task, attribute=DELAY_UNITS, value=SECONDS)
        me("SetTrigAttribute", task, attribute=DELAY, value=delay_s)


def free(me, samples, channel=f"{NAME}/ai0"):
    """Task that records without a trigger."""
    task = me("CreateTask")["task"]
    me("CreateAIVoltageChan", task, physical_channel=channel)
    me("CfgSampClkTiming", task, rate=RATE_HZ, samps_per_chan=samples)
    return task


def volts_of(me, task, **arguments):
    codes = me("ReadBinaryI16", task, **{"timeout": 2.0} | arguments)["read_array"]
    polynomial = me("GetChanAttribute", task, attribute=0x1930)["value"]
    return np.polynomial.polynomial.polyval(codes.astype(float), polynomial)


def shot(me, task, counter=f"{NAME}/ctr0"):
    coil = me.coil(counter, high_time=PULSE_S)
    me("StartTask", task)
    me("StartTask", coil)
    return coil


def expected(crosstalk, t):
    """The formula of one edge, by itself."""
    return np.exp(-t / crosstalk.decay_s) * np.cos(2.0 * np.pi * crosstalk.ringing_hz * t)


def test_a_free_record_from_the_pulse_s_begin_shows_both_edges_and_the_wave(brain, me):
    length_s = PULSE_S + FALL_S + 2e-3
    brain.disturb("C", {"on_v": 0.6, "off_v": -0.4, "decay_s": 50e-6, "ringing_hz": 20e3})
    task = free(me, round(length_s * RATE_HZ))
    start_by(me, task, edge=RISING)
    shot(me, task)
    volts = volts_of(me, task)
    t = np.arange(5_000) / RATE_HZ
    edge = round(PULSE_S * RATE_HZ)
    # Half a code is what rounding leaves.
    np.testing.assert_allclose(volts[: t.size], 0.6 * expected(SPIKE, t), atol=CODE_V)
    np.testing.assert_allclose(volts[edge:][: t.size], -0.4 * expected(SPIKE, t), atol=CODE_V)
    (strike,) = brain.record()["strikes"]
    lifted = next(line["ns"] for line in brain.record()["lines"] if line["level"])
    contact = (strike["contact_ns"] - lifted) / 1e9 * RATE_HZ
    wave = edge + 10_000 + int(np.argmax(volts[edge + 10_000 :]))
    assert 500 < wave - contact < 3_000, "the wave passes the sensor 0.05 to 0.3 ms after the contact"
    assert volts[wave] > LEVEL_V
    assert np.abs(volts[edge + 20_000 : round(contact)]).max() < 2 * CODE_V, "nothing in between"


@pytest.mark.parametrize(("height_v", "taken"), [(0.3, True), (0.2, False), (-0.3, False)])
def test_a_spike_above_the_level_takes_the_record_of_a_trigger_armed_over_it(brain, me, height_v, taken):
    brain.disturb("C", {"off_v": height_v, "decay_s": 2e-6})
    task = me.digitizer(f"{NAME}/ai0")
    shot(me, task)
    volts = volts_of(me, task)
    # The incident wave of 1 mm rises above half a volt; after a spike of 2 us nothing does for 1.26 ms.
    assert bool(volts.max() < 0.5) is taken
    if taken:
        assert volts[PRETRIGGER] == pytest.approx(height_v, rel=0.06), "up to a sample after the edge"
        assert np.abs(volts[:PRETRIGGER]).max() < 2 * CODE_V


def test_a_start_at_the_edge_alone_protects_only_while_the_pre_trigger_fills(brain, me):
    brain.disturb("C", {"off_v": 4.0, "decay_s": 0.2e-3, "ringing_hz": 20e3})
    task = me.digitizer(f"{NAME}/ai0")
    start_by(me, task)
    shot(me, task)
    volts = volts_of(me, task)
    assert volts[:PRETRIGGER].max() > 2.0, "the pre-trigger fills with the ringing, which then triggers"


def test_an_acquisition_armed_for_the_falling_edge_ignores_the_rising_edge(brain, me):
    task = free(me, 100)
    start_by(me, task)
    coil = shot(me, task)
    start_ns = brain.bench.clock.now_ns()
    me("WaitUntilTaskDone", task, time_to_wait=1.0)
    low = brain.record()["lines"][-1]
    assert low["level"] == 0
    assert brain.bench.clock.now_ns() == low["ns"] + 10_000 > start_ns + 3_000_000
    me("ClearTask", coil)


@pytest.mark.parametrize(("passed_s", "done_after_s"), [(1e-3, 10e-6), (1e-4, None)])
def test_a_pulse_that_is_stopped_starts_at_its_own_end_or_never(brain, me, passed_s, done_after_s):
    task = free(me, 100)
    start_by(me, task)
    coil = shot(me, task)
    brain.bench.clock.pass_s(passed_s)  # the pulse begins after 0.2 ms
    with pytest.raises(Status, match="200010"):
        me("StopTask", coil)
    stopped_ns = brain.bench.clock.now_ns()
    if done_after_s is None:
        assert not me.is_done(task)
        with pytest.raises(Status, match="-200284"):
            volts_of(me, task, timeout=0.1)
    else:
        me("WaitUntilTaskDone", task, time_to_wait=1.0)
        assert brain.bench.clock.now_ns() - stopped_ns == round(done_after_s * 1e9)


def test_a_wave_on_crosstalk_is_separated_and_keeps_its_shape():
    """What is left of the ringing when the wave comes moves the trigger and adds to the volts only."""
    records = []
    for crosstalk in ({}, {"off_v": 0.2, "decay_s": 20e-3}):
        brain = made()
        me = Caller(brain)
        brain.disturb("C", crosstalk)
        task = me.digitizer(f"{NAME}/ai0")
        start_by(me, task, delay_s=8e-3)
        brain.announce(KEY, 0.0)
        shot(me, task)
        records.append(volts_of(me, task))
        (strike,) = brain.record()["strikes"]
        fall_s = (strike["contact_ns"] - brain.record()["lines"][-1]["ns"]) / 1e9
    quiet, upon = records
    shift = int(np.argmax(upon)) - int(np.argmax(quiet))
    pedestal_v = 0.2 * math.exp(-fall_s / 20e-3)
    assert 0 < shift < 300, "the level is passed earlier"
    # It falls by a fifteenth over the record; the chain's passage is not in the fall.
    np.testing.assert_allclose(upon[shift:] - quiet[: SAMPLES - shift], pedestal_v, rtol=0.1)


def test_hum_above_the_level_triggers_by_itself(brain, me):
    brain.disturb("C", {"hum_v": 0.5, "hum_hz": 50.0})
    task = me.digitizer(f"{NAME}/ai0")
    me("StartTask", task)
    volts = volts_of(me, task)
    assert volts[PRETRIGGER] == pytest.approx(LEVEL_V, abs=2 * CODE_V)
    t = np.arange(SAMPLES) / RATE_HZ
    np.testing.assert_allclose(
        volts, 0.5 * np.sin(2.0 * np.pi * 50.0 * (t - t[PRETRIGGER]) + math.pi / 6.0), atol=3 * CODE_V
    )


def test_flyback_and_bounces_are_drawn_where_they_belong(brain, me):
    brain.disturb("C", {"flyback_v": -2.0, "flyback_s": 1e-3, "on_v": 1.0, "bounces": 2, "bounce_s": 1e-4})
    task = free(me, 45_000)
    start_by(me, task, edge=RISING)
    shot(me, task)
    volts = volts_of(me, task)
    assert [volts[n] for n in (0, 1_000, 2_000)] == pytest.approx([1.0, 0.5, 0.25], abs=CODE_V)
    off = round(PULSE_S * RATE_HZ)
    ramp = -2.0 * (1.0 - np.arange(10_000) / 10_000)
    np.testing.assert_allclose(volts[off : off + 10_000], ramp, atol=CODE_V)


def test_a_pulse_too_short_to_lift_the_striker_is_recorded(brain, me):
    brain.disturb("C", {"on_v": 1.0, "decay_s": 1e-4})
    task = me.digitizer(f"{NAME}/ai0")
    coil = me.coil(f"{NAME}/ctr0", high_time=0.2e-3)
    me("StartTask", task)
    me("StartTask", coil)
    assert volts_of(me, task)[PRETRIGGER] == pytest.approx(1.0, rel=2e-3)
    assert brain.record()["strikes"] == []


# What boards refuse


@pytest.mark.parametrize(
    ("source", "delay_s", "code"),
    [
        (CTR1, 1e-3, None),
        ("/PXI1Slot2/Ctr3InternalOutput", 1e-3, None),
        ("/Dev1/Ctr0InternalOutput", 1e-3, -89125),
        (CTR0, 0.1e-6, -200333),
        (CTR0, 50.0, -200334),
    ],
)
def test_routes_and_delays_of_an_x_series_board(me, source, delay_s, code):
    assert refusal(me, me.digitizer(f"{NAME}/ai0"), source, delay_s) == code


@pytest.mark.parametrize(
    ("source", "delay_s", "code"),
    [
        ("/PXI1Slot4/Ctr0InternalOutput", 0.5, None),
        ("/PXI1Slot4/Ctr1InternalOutput", 1e-3, -89136),
        (CTR0, 1e-3, None),
        ("/PXI1Slot4/Ctr0InternalOutput", 0.9, -200334),
    ],
)
def test_routes_and_delays_of_an_s_series_board(source, delay_s, code):
    me = Caller(made(SIMULTANEOUS_12_BIT, board()))
    assert refusal(me, me.digitizer("PXI1Slot4/ai0"), source, delay_s) == code


def refusal(me, task, source, delay_s):
    """Status of the commit, None where it goes."""
    start_by(me, task, source, delay_s=delay_s)
    try:
        me.control(task, 3)
    except Status as status:
        return status.code
    assert me("GetTrigAttribute", task, attribute=DELAY)["value"] == pytest.approx(delay_s, abs=1e-8)
    return None


def test_a_delay_is_taken_in_seconds_only(me):
    task = me.digitizer(f"{NAME}/ai0")
    me("CfgDigEdgeStartTrig", task, trigger_source=CTR0, trigger_edge=FALLING)
    me("SetTrigAttribute", task, attribute=DELAY, value=1e-3)
    with pytest.raises(Status, match="in seconds only"):
        me.control(task, 3)


def test_noise_at_the_comparator_is_that_of_the_record(brain, me):
    """A spike a little below the level triggers with the noise on it, and the record shows both."""
    noisy = replace(QUICK_TWIN, noise=replace(QUICK_TWIN.noise, enabled=True))
    brain = Brain(replace(brain.bench.description, twin=noisy), clock=SteppedClock())
    me = Caller(brain)
    brain.disturb("C", {"off_v": 0.2, "decay_s": 2e-3})
    task = me.digitizer(f"{NAME}/ai0")
    shot(me, task)
    volts = volts_of(me, task)
    assert volts[PRETRIGGER] >= LEVEL_V - CODE_V > volts[PRETRIGGER - 1] - CODE_V
    assert 0.1 < volts[PRETRIGGER : PRETRIGGER + 1_000].mean() < 0.2
