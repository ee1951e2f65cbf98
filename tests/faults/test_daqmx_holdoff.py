"""A coil whose switching reaches its sensor, and the holdoff that keeps it from the trigger.

The doubles strike and record in real time. Shots are compared with those of the twin without any crosstalk.
"""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from support.daqmx_rig import (
    QUICK_PULSE_S,
    READ_TIMEOUT_S,
    board,
    coil_pulses_s,
    counts_of_the_twin,
    functions_of,
    parameters_of,
    quick_description,
    reach,
    take,
    wired,
)
from support.waiting import happened

from analysis.waves.features import extract_features
from hardware_drivers.daqmx.instruments import open_daqmx
from hardware_drivers.daqmx.pulse_record import FreeInput
from hardware_drivers.errors import AcquisitionTimeoutError, ConfigurationError, InstrumentError
from hardware_drivers.measurement import ShotKey
from simulator.doubles.chassis.crosstalk import Crosstalk
from simulator.doubles.chassis.description import SIMULTANEOUS_12_BIT, SIMULTANEOUS_18_BIT

QUIET = Crosstalk()
SPIKE = Crosstalk(on_v=0.6, off_v=0.6, decay_s=2e-6)
RINGING = Crosstalk(on_v=0.6, off_v=4.0, decay_s=0.5e-3, ringing_hz=20e3)
HOLDOFF_S = 7e-3
"""Half of the fall from 1 mm."""
NARROW, WIDE = SIMULTANEOUS_12_BIT.serial_number, SIMULTANEOUS_18_BIT.serial_number
DESCRIPTION = quick_description(board(), SIMULTANEOUS_18_BIT, SIMULTANEOUS_12_BIT, positions="C")
SERIAL = DESCRIPTION.boards[0].serial_number
DESCRIPTION = replace(
    DESCRIPTION,
    boards=(*DESCRIPTION.boards, replace(board(), serial_number=0x0BAD0001, name="Dev9")),
    transducers={
        **DESCRIPTION.transducers,
        # Sensors whose coils hang at another board: in the chassis, on an S Series, and elsewhere.
        "D": wired(SERIAL, 1, counter_serial=WIDE),
        "E": wired(NARROW, 1),
        "F": wired(NARROW, 0),
        "G": wired(SERIAL, 2, counter_serial=0x0BAD0001),
    },
)


@pytest.fixture(params=["library", "grpc"])
def transport(request, doubles, monkeypatch):
    reach(request.param, doubles, monkeypatch)
    happened(doubles.control.wait_until_quiet, "the striker landed")
    doubles.control.clear_record()
    yield request.param
    doubles.control.clear_faults()
    doubles.control.disturb("C", QUIET)
    record = doubles.control.record()
    assert record["reservations"] == {}
    assert record["tasks"] == []
    assert all(0.0 < pulse_s <= QUICK_PULSE_S for pulse_s in coil_pulses_s(record))


by_library = pytest.mark.parametrize("transport", ["library"], indirect=True)


@pytest.fixture
def parameters(doubles, transport):
    return parameters_of(DESCRIPTION, doubles, transport=transport)


def key(shot_index, position="C"):
    return ShotKey(position=position, set_index=1, shot_index=shot_index)


def only(parameters, position, **changes):
    wiring = {position: parameters.transducers[position]}
    return replace(parameters, transducers=wiring, **changes)


def test_without_a_holdoff_the_spike_takes_the_trigger_and_with_one_the_wave_does(doubles, parameters):
    mine = only(parameters, "C")
    # The ringing lasts 1.4 ms beyond the pulse of 3 ms: 4 ms count from its end, not from its begin.
    for crosstalk, holdoff_s, lost in (
        (SPIKE, None, True),
        (SPIKE, HOLDOFF_S, False),
        (RINGING, 4e-3, False),
    ):
        doubles.control.disturb("C", crosstalk)
        with open_daqmx(replace(mine, holdoff_s=holdoff_s)) as rig:
            for shot in range(2):
                # The ball of a record that a spike took still falls when the record is read.
                happened(doubles.control.wait_until_quiet, "the striker landed")
                acquired = take(rig, doubles, key(shot))
                features = extract_features(acquired.waveform)
                assert ("false_trigger" in features.flags) is lost
                if not lost:
                    expected = counts_of_the_twin(DESCRIPTION, mine, key(shot))
                    np.testing.assert_array_equal(acquired.waveform.counts, expected)
                assert acquired.settings.get("holdoff_s") == holdoff_s


@by_library
def test_within_a_turn_a_held_off_shot_makes_the_same_calls(doubles, parameters):
    with open_daqmx(only(parameters, "C", holdoff_s=HOLDOFF_S)) as rig:
        take(rig, doubles, key(0))
        doubles.control.clear_record()
        take(rig, doubles, key(1))
        record = doubles.control.record()
    assert [name for name in functions_of(record) if not name.startswith("Get")] == [
        "StartTask", "StartTask", "WaitUntilTaskDone", "StopTask", "ReadBinaryI16", "StopTask",
    ]  # fmt: skip


@by_library
@pytest.mark.parametrize("position", ["D", "F"])
def test_a_counter_of_another_board_of_the_chassis_starts_the_acquisition(doubles, parameters, position):
    with open_daqmx(only(parameters, position, holdoff_s=HOLDOFF_S)) as rig:
        counts = take(rig, doubles, key(0, position)).waveform.counts
    np.testing.assert_array_equal(counts, counts_of_the_twin(DESCRIPTION, parameters, key(0, position)))


@by_library
@pytest.mark.parametrize(
    ("position", "message"),
    [
        ("E", r"PXI-6115 00F12015 by /PXI1Slot4/Ctr1InternalOutput.*S Series: ctr0.*-89136"),
        ("G", r"01E16086 by /Dev9/Ctr2InternalOutput of PXIe-6386 0BAD0001.*in its chassis.*-89125"),
    ],
)
def test_a_board_that_the_counter_cannot_start_is_refused_before_a_test_begins(parameters, position, message):
    with pytest.raises(ConfigurationError, match=message):
        open_daqmx(only(parameters, position, holdoff_s=HOLDOFF_S)).__enter__()
    with open_daqmx(only(parameters, position)):
        pass  # without a holdoff it is as good as any


@by_library
def test_the_driver_refuses_a_holdoff_that_the_parameters_let_pass(doubles, parameters):
    """As a later change of theirs might: the wave would come while nothing is armed, or the ringing."""
    mine = only(parameters, "C", holdoff_s=HOLDOFF_S)
    for name, value, message in (
        ("holdoff_s", 0.02, r"0\.02 s; it must be longer than ringing_s = 0 s and shorter than 0\.01418 s"),
        ("ringing_s", 8e-3, r"0\.007 s; it must be longer than ringing_s = 0\.008 s and shorter than"),
    ):
        wrong = replace(mine)
        object.__setattr__(wrong, name, value)
        with pytest.raises(ConfigurationError, match=message):
            open_daqmx(wrong).__enter__()
    assert coil_pulses_s(doubles.control.record()) == []


@by_library
@pytest.mark.parametrize(
    ("call", "error"),
    [
        ("DAQmxCfgDigEdgeStartTrig", "would be started by nothing instead"),
        ("DAQmxSetTrigAttribute:StartTrig.Delay", "would hold off for 0 s"),
        ("DAQmxGetTrigAttribute:StartTrig.Delay", r"would hold off for 0\.00707 s"),
    ],
)
def test_a_holdoff_that_differs_from_the_request_stops_the_shot(doubles, parameters, call, error):
    doubles.control.inject(call, "lie")
    with pytest.raises(InstrumentError, match=error):
        open_daqmx(only(parameters, "C", holdoff_s=HOLDOFF_S)).__enter__()


@by_library
def test_a_wave_that_comes_before_the_holdoff_is_over_is_a_missed_strike(doubles, parameters):
    low = only(parameters, "C", drop_height_m=8e-3, holdoff_s=30e-3)
    with open_daqmx(low) as rig, pytest.raises(AcquisitionTimeoutError, match="-200284"):
        take(rig, doubles, key(0), read_timeout_s=0.2)


def test_a_whole_strike_is_recorded_with_both_edges_and_the_wave(doubles, parameters):
    mine = only(parameters, "C", holdoff_s=HOLDOFF_S)
    doubles.control.disturb("C", replace(SPIKE, off_v=-0.4, decay_s=50e-6))
    with closing(FreeInput(mine, "C", READ_TIMEOUT_S)) as free:
        noise, strike = free.record_quiet_input(), free.strike()
    rate_hz = strike.sample_rate_hz
    volts = strike.volts()
    off = round(mine.pulse_s * rate_hz)
    assert strike.counts.size == mine.whole_strike_samples
    assert volts[0] == pytest.approx(0.6, rel=0.01)
    assert volts[off + 1] == pytest.approx(-0.4, rel=0.01)
    after_s = (np.argmax(volts[off + 10_000 :]) + 10_000) / rate_hz
    assert after_s == pytest.approx(mine.fall_s, rel=0.3), "the drop height scatters by a tenth"
    assert noise.counts.size == mine.record_samples
    assert np.abs(noise.volts()).max() < 1e-3
    assert coil_pulses_s(doubles.control.record()) == [pytest.approx(mine.pulse_s, abs=1e-8)]


@by_library
def test_a_rehearsal_records_no_strike(doubles, parameters):
    with pytest.raises(ConfigurationError, match="dry_run is true"):
        FreeInput(replace(parameters, dry_run=True), "C", READ_TIMEOUT_S)
    assert doubles.control.record()["calls"] == []
