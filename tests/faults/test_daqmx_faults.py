"""Single faults of NI-DAQmx boards: the error, the coil, and the recovery.

`test_daqmx_fault_matrix` goes through every call; here are the faults a laboratory meets by name.
"""

import math
import os
import threading
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
from support.daqmx_models import context, in_a_process, running_brain
from support.daqmx_rig import (
    QUICK_PULSE_S,
    QUICK_TWIN,
    READ_TIMEOUT_S,
    TRANSPORTS,
    Forwarder,
    board,
    coil_pulses_s,
    counts_of_the_twin,
    functions_of,
    meet,
    parameters_of,
    quick_description,
    reach,
    take,
    why_no,
    wired,
)
from support.waiting import happened

from hardware_drivers.daqmx.chassis import LADDER
from hardware_drivers.daqmx.instruments import open_daqmx
from hardware_drivers.daqmx.parameters import LONGEST_PULSE_S
from hardware_drivers.errors import (
    AcquisitionTimeoutError,
    BusyError,
    ConfigurationError,
    ConnectionLostError,
)
from hardware_drivers.measurement import ShotKey
from simulator.doubles.chassis.description import SIMULTANEOUS_16_BIT, SIMULTANEOUS_18_BIT, SLOW
from simulator.parameters.electronics import NoiseParameters

SERIAL = SIMULTANEOUS_16_BIT.serial_number
NAME = SIMULTANEOUS_16_BIT.name
DESCRIPTION = replace(
    quick_description(board(), SIMULTANEOUS_18_BIT, SLOW, positions="CD"),
    # A coil whose pulse comes from another board than the one that samples its sensor.
    transducers={
        "C": wired(SERIAL, 0),
        "D": wired(SERIAL, 1),
        "E": wired(SIMULTANEOUS_18_BIT.serial_number, 2, counter_serial=SERIAL),
    },
)


@pytest.fixture(params=TRANSPORTS)
def transport(request, doubles, monkeypatch):
    reach(request.param, doubles, monkeypatch)
    yield request.param
    doubles.control.clear_faults()
    doubles.control.release_hangs()
    doubles.control.vacate("LabVIEW on BENCH-7")
    record = doubles.control.record()
    assert record["reservations"] == {}
    assert record["tasks"] == []
    assert all(0.0 < pulse_s <= QUICK_PULSE_S for pulse_s in coil_pulses_s(record))


by_both = pytest.mark.parametrize("transport", ["library", "grpc"], indirect=True)


@pytest.fixture
def parameters(doubles, transport):
    return parameters_of(DESCRIPTION, doubles, transport=transport)


def key(shot_index=0, position="C"):
    return ShotKey(position=position, set_index=1, shot_index=shot_index)


def assert_sound(parameters, acquired, which):
    np.testing.assert_array_equal(
        acquired.waveform.counts, counts_of_the_twin(DESCRIPTION, parameters, which)
    )


# A shot --------------------------------------------------------------------------------------------


@by_both
def test_the_digitizer_starts_before_the_coil_and_nothing_is_created_within_a_turn(doubles, parameters):
    with open_daqmx(parameters) as rig:
        take(rig, doubles, key(0))
        doubles.control.clear_record()
        assert_sound(parameters, take(rig, doubles, key(1)), key(1))
        record = doubles.control.record()
    assert [name for name in functions_of(record) if not name.startswith("Get")] == [
        "StartTask", "StartTask", "WaitUntilTaskDone", "StopTask", "ReadBinaryI16", "StopTask",
    ]  # fmt: skip
    assert record["calls"][0]["end_ns"] <= record["calls"][1]["begin_ns"]


def test_the_coil_waits_until_the_pre_trigger_has_filled(doubles, parameters):
    # 2 ms: far longer than any call, so the wait can only be the counter's own.
    slow = replace(parameters, pretrigger_samples=20_000, record_samples=32_600)
    with open_daqmx(slow) as rig:
        rig.digitizer.arm(key())
        doubles.control.clear_record()
        rig.striker.strike(key())
        record = doubles.control.record()
        waveform = rig.digitizer.read(READ_TIMEOUT_S).waveform
    started_ns = record["calls"][0]["begin_ns"]
    assert record["lines"][0]["ns"] - started_ns >= 1e9 * slow.initial_delay_s == 4_000_000
    assert waveform.pretrigger_samples == 20_000


def test_each_turn_commits_once_and_ends_the_one_before(doubles, parameters):
    with open_daqmx(parameters) as rig:
        for position in "CDE":
            for shot in range(2):
                which = key(shot, position)
                assert_sound(parameters, take(rig, doubles, which), which)
        live = doubles.control.record()["tasks"]
    assert len(live) == 2
    assert {task["state"] for task in live} == {"committed"}


@by_both
def test_a_record_stores_its_acquisition_settings(doubles, parameters, transport):
    with open_daqmx(parameters) as rig:
        settings = take(rig, doubles, key()).settings
        identity = rig.identity
    assert settings["board_serial"] == f"{SERIAL:08X}"
    assert settings["product"] == "PXIe-6386"
    assert settings["trigger_level_v"] == 0.25
    assert settings["calibration_temperature_c"] == SIMULTANEOUS_16_BIT.temperature_c
    assert settings["driver_version"] == identity["daqmx_driver_version"] == "24.8.0"
    assert settings["transport"] == identity["transport"] == transport
    assert identity[f"board_{SIMULTANEOUS_18_BIT.serial_number:08X}"] == "PXIe-6396"
    assert "dry_run" not in settings


def test_only_the_thread_that_opened_them_may_call_the_instruments(parameters):
    caught = []

    def call(method, *arguments):
        try:
            method(*arguments)
        except ConfigurationError as error:
            caught.append(str(error))

    with open_daqmx(parameters) as rig:
        for method, *arguments in (
            (rig.digitizer.arm, key()),
            (rig.digitizer.read, 1.0),
            (rig.digitizer.disarm,),
            (rig.striker.strike, key()),
            (rig.striker.make_safe,),
            (rig.self_calibrating.self_calibrate,),
        ):
            other = threading.Thread(target=call, args=(method, *arguments))
            other.start()
            other.join()
    assert len(caught) == 6
    assert all("thread" in text for text in caught)


# What the hardware cannot do is refused ---------------------------------------------------------------


def with_wiring(parameters, **changes):
    wiring = replace(parameters.transducers["C"], **changes)
    return replace(parameters, transducers={"C": wiring})


def test_a_board_too_slow_is_refused_with_the_rate_it_can_do(parameters):
    slow = with_wiring(parameters, board_serial=f"{SLOW.serial_number:X}", striker_serial=f"{SERIAL:X}")
    with pytest.raises(ConfigurationError, match=r"10000000 Hz; PCI-6221 00C16021 does at most 250000 Hz"):
        open_daqmx(slow).__enter__()


def test_a_range_the_board_does_not_have_is_refused_with_those_it_has(parameters):
    with pytest.raises(ConfigurationError, match=r"range_v is 4\.0 V.*-1\.\.1, -2\.\.2, -5\.\.5, -10\.\.10"):
        open_daqmx(with_wiring(parameters, range_v=4.0)).__enter__()


@pytest.mark.parametrize(
    "changes", [{"input": "ai9"}, {"counter": "ctr7"}, {"terminal_configuration": "nrse"}]
)
def test_missing_wiring_is_refused(parameters, changes):
    with pytest.raises(ConfigurationError, match="DAQmx -200"):
        open_daqmx(with_wiring(parameters, **changes)).__enter__()


def test_a_missing_serial_number_is_reported_with_those_present(parameters):
    with pytest.raises(ConnectionLostError, match=r"0000BEEF; there are: .*01E16086 \(PXI1Slot3\)"):
        open_daqmx(with_wiring(parameters, board_serial="BEEF")).__enter__()


def test_the_driver_has_a_cap_of_its_own(doubles, parameters):
    # Past the parameters' own check, as a later change of theirs might let it pass.
    object.__setattr__(parameters, "pulse_s", 0.6)
    with pytest.raises(ConfigurationError, match=r"0\.6 s.*at most 0\.5 s"):
        open_daqmx(parameters).__enter__()
    assert "CreateCOPulseChanTime" not in functions_of(doubles.control.record())


# Missed strikes -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("function", "code"), [("ReadBinaryI16", -200284), ("WaitUntilTaskDone", -200560)])
def test_a_missed_strike_is_a_timeout_and_the_next_one_is_taken(doubles, parameters, function, code):
    with open_daqmx(parameters) as rig:
        take(rig, doubles, key(0))
        doubles.control.inject(f"DAQmx{function}", "error", code=code)
        with pytest.raises(AcquisitionTimeoutError, match=str(code)):
            take(rig, doubles, key(1))
        assert not any(doubles.control.record()["levels"].values())
        assert_sound(parameters, take(rig, doubles, key(2)), key(2))
    assert "ResetDevice" not in functions_of(doubles.control.record())


# Busy ---------------------------------------------------------------------------------------------


def test_a_board_used_by_another_process_is_busy_and_never_reset(doubles, parameters):
    doubles.control.occupy(f"{SERIAL}/ai", "LabVIEW on BENCH-7")
    with pytest.raises(BusyError, match=r"-50103.*owner: .*LabVIEW on BENCH-7"):
        open_daqmx(parameters).__enter__()
    doubles.control.vacate("LabVIEW on BENCH-7")
    with open_daqmx(parameters) as rig:
        take(rig, doubles, key(0))
        take(rig, doubles, key(0, "D"))
        doubles.control.occupy(f"{SERIAL}/ctr0", "LabVIEW on BENCH-7")
        for _ in range(3):
            with pytest.raises(BusyError, match="LabVIEW on BENCH-7"):
                rig.digitizer.arm(key(1))
        # Even a loss of the connection after that resets nothing: the board is shared.
        doubles.control.vacate("LabVIEW on BENCH-7")
        doubles.control.inject("DAQmxStartTask", "error", code=-200324, times=3)
        for _ in range(3):
            with pytest.raises(ConnectionLostError):
                rig.digitizer.arm(key(1))
        assert_sound(parameters, take(rig, doubles, key(2)), key(2))
    assert "ResetDevice" not in functions_of(doubles.control.record())


# Losses and the ladder ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("transport", "code"),
    [*(("library", code) for code in (-88710, -200279, -200324, -201003, -50405)), ("grpc", -200324)],
    indirect=["transport"],
)
def test_a_loss_is_recovered_by_fresh_tasks(doubles, parameters, code):
    with open_daqmx(parameters) as rig:
        take(rig, doubles, key(0))
        doubles.control.inject("DAQmxReadBinaryI16", "error", code=code)
        with pytest.raises(ConnectionLostError, match=str(code)):
            take(rig, doubles, key(1))
        assert_sound(parameters, take(rig, doubles, key(2)), key(2))
    assert "ResetDevice" not in functions_of(doubles.control.record())


@by_both
def test_the_ladder_is_climbed_rung_by_rung_and_left_after_a_sound_record(doubles, parameters):
    with open_daqmx(parameters) as rig:
        take(rig, doubles, key(0))
        doubles.control.clear_record()
        doubles.control.inject("DAQmxStartTask", "error", code=-200324, times=0)
        resets = []
        for attempt in range(6):
            with pytest.raises(ConnectionLostError, match="-200324") as caught:
                rig.digitizer.arm(key(1))
            used_up = f"still so after {attempt} attempts"
            assert (used_up in str(caught.value)) == (attempt >= len(LADDER))
            resets.append(functions_of(doubles.control.record()).count("ResetDevice"))
        # Our two boards, at the second rung, once.
        assert resets == [0, 0, 2, 2, 2, 2]
        doubles.control.clear_faults()
        assert_sound(parameters, take(rig, doubles, key(2)), key(2))
        doubles.control.inject("DAQmxStartTask", "error", code=-200324)
        with pytest.raises(ConnectionLostError) as caught:
            rig.digitizer.arm(key(3))
        assert "attempts" not in str(caught.value)
        assert_sound(parameters, take(rig, doubles, key(4)), key(4))
    assert functions_of(doubles.control.record()).count("ResetDevice") == 2


def test_a_rung_is_climbed_once_a_loss_and_not_again_within_the_shot(doubles, parameters):
    with open_daqmx(parameters) as rig:
        take(rig, doubles, key(0))
        doubles.control.inject("DAQmxReadBinaryI16", "error", code=-88710)
        with pytest.raises(ConnectionLostError):
            take(rig, doubles, key(1))
        rig.digitizer.arm(key(2))
        doubles.control.clear_record()
        rig.striker.strike(key(2))
        assert functions_of(doubles.control.record()) == ["StartTask", "WaitUntilTaskDone", "StopTask"]


def test_a_board_replugged_at_once_is_found_by_the_second_rung(doubles, parameters):
    with open_daqmx(parameters) as rig:
        take(rig, doubles, key(0))
        doubles.control.unplug(SERIAL)
        doubles.control.plug(SERIAL, "Dev7")
        try:
            for _ in range(2):  # its tasks are gone; fresh ones ask for the name it had
                with pytest.raises(ConnectionLostError):
                    rig.digitizer.arm(key(1))
            assert_sound(parameters, take(rig, doubles, key(2)), key(2))
            rig.striker.make_safe()
        finally:
            doubles.control.unplug(SERIAL)
            doubles.control.plug(SERIAL, NAME)


def test_an_unplugged_board_is_found_again_under_its_new_name(doubles, parameters):
    with open_daqmx(parameters) as rig:
        take(rig, doubles, key(0))
        doubles.control.unplug(SERIAL)
        try:
            with pytest.raises(ConnectionLostError):
                rig.digitizer.arm(key(1))
            for _ in range(4):
                with pytest.raises(ConnectionLostError, match=f"{SERIAL:08X}|{NAME}"):
                    rig.digitizer.arm(key(1))
            assert not any(doubles.control.record()["levels"].values())
        finally:
            doubles.control.plug(SERIAL, "Dev7")
        try:
            assert_sound(parameters, take(rig, doubles, key(2)), key(2))
            assert rig.identity[f"board_{SERIAL:08X}"] == "PXIe-6386"
        finally:
            rig.striker.make_safe()
            doubles.control.unplug(SERIAL)
            doubles.control.plug(SERIAL, NAME)


def test_a_board_unplugged_during_the_pulse_takes_the_coil_down(doubles, parameters):
    with open_daqmx(parameters) as rig:
        take(rig, doubles, key(0))
        rig.digitizer.arm(key(1))
        doubles.control.unplug(SERIAL)
        try:
            with pytest.raises(ConnectionLostError):
                rig.striker.strike(key(1))
            rig.striker.make_safe()
        finally:
            doubles.control.plug(SERIAL, NAME)
        with pytest.raises(ConfigurationError, match="not armed"):
            rig.digitizer.read(1.0)
        assert_sound(parameters, take(rig, doubles, key(2)), key(2))


def test_a_pulse_at_another_terminal_is_refused_before_it_is_connected(doubles, parameters):
    with open_daqmx(parameters) as rig:
        doubles.control.inject("DAQmxGetChanAttribute:CO.Pulse.Term", "lie", times=0)
        with pytest.raises(ConnectionLostError, match="PFI12"):
            rig.striker.strike(key())
        doubles.control.clear_faults()
    assert coil_pulses_s(doubles.control.record()) == []


# Coil ---------------------------------------------------------------------------------------------


def test_make_safe_ends_a_pulse_at_once(doubles, parameters):
    long = replace(parameters, pulse_s=0.5)
    with open_daqmx(long) as rig:
        doubles.control.inject("DAQmxWaitUntilTaskDone", "error", code=-200560)
        with pytest.raises(AcquisitionTimeoutError):
            rig.striker.strike(key())
        rig.striker.make_safe()
        (pulse_s,) = coil_pulses_s(doubles.control.record()) or [0.0]
        assert pulse_s < 0.25
        doubles.control.clear_record()


@by_both
def test_a_coil_that_cannot_be_switched_off_is_reported_and_ends_by_itself(monkeypatch, transport):
    """Neither stop nor abort nor clear goes through: only the board's own counter is left."""
    with running_brain(DESCRIPTION) as doubles:  # its own: the refused tasks stay in it
        if transport == "library":
            meet(doubles, monkeypatch)
        long = parameters_of(DESCRIPTION, doubles, transport=transport, pulse_s=LONGEST_PULSE_S)
        with open_daqmx(long) as rig:
            rig.digitizer.arm(key())
            for function in ("StopTask", "TaskControl", "ClearTask", "WaitUntilTaskDone"):
                doubles.control.inject(f"DAQmx{function}", "error", code=-50405, times=0)
            with pytest.raises(ConnectionLostError, match="-50405"):
                rig.striker.strike(key())
            with pytest.raises(ConnectionLostError, match=rf"may be on .* pulse_s = {LONGEST_PULSE_S} s"):
                rig.striker.make_safe()
            doubles.control.clear_faults()
            arm_until_free(rig)
        (pulse_s,) = coil_pulses_s(doubles.control.record())
    assert pulse_s == pytest.approx(LONGEST_PULSE_S, rel=1e-3)


def arm_until_free(rig):
    """Arm again: the driver waits until the striker has landed and retries refused tasks."""
    for _ in range(len(LADDER)):
        try:
            rig.digitizer.arm(key(1))
        except (BusyError, ConnectionLostError):
            continue
        break
    else:
        pytest.fail("the ladder did not get past tasks that could not be cleared")
    rig.striker.make_safe()


# Dry run ------------------------------------------------------------------------------------------


def test_a_dry_run_starts_no_counter_and_records_the_noise(monkeypatch, transport):
    noisy = replace(DESCRIPTION, twin=replace(QUICK_TWIN, noise=NoiseParameters(rms_v=0.02, slow_rms_v=0.0)))
    with running_brain(noisy) as doubles:
        if transport == "library":
            meet(doubles, monkeypatch)
        parameters = parameters_of(noisy, doubles, transport=transport, dry_run=True)
        with open_daqmx(parameters) as rig:
            acquired = take(rig, doubles, key())
        record = doubles.control.record()
    assert acquired.settings["dry_run"] == "yes"
    assert acquired.settings["pulse_s"] == 0.0
    assert acquired.waveform.pretrigger_samples == 0
    # 13,600 samples of 20 mV noise: its spread is known to 0.6 %, five times that is allowed.
    assert np.std(acquired.waveform.volts()) == pytest.approx(0.02, rel=0.03)
    assert functions_of(record).count("StartTask") == 1
    assert "CfgAnlgEdgeRefTrig" not in functions_of(record)
    assert record["lines"] == []


# Self-calibration -----------------------------------------------------------------------------------


def test_self_calibration_is_followed_by_the_new_scaling(monkeypatch, transport):
    drifting = replace(quick_description(SIMULTANEOUS_16_BIT, positions="C"))
    with running_brain(drifting) as doubles:
        if transport == "library":
            meet(doubles, monkeypatch)
        parameters = parameters_of(drifting, doubles, transport=transport)
        with open_daqmx(parameters) as rig:
            before = take(rig, doubles, key(0))
            done = rig.self_calibrating.self_calibrate()
            after = take(rig, doubles, key(1))
            rig.digitizer.arm(key(2))
            with pytest.raises(ConfigurationError, match="between sets"):
                rig.self_calibrating.self_calibrate()
    shift_v = after.waveform.calibration.coefficients_v[0] - before.waveform.calibration.coefficients_v[0]
    assert shift_v == pytest.approx(SIMULTANEOUS_16_BIT.self_calibration_shift_v, rel=1e-9)
    assert list(done) == [f"{SERIAL:08X}"]
    assert after.settings["calibration_date"] > before.settings["calibration_date"]


# What a board need not say --------------------------------------------------------------------------


METADATA = {
    "DAQmxGetCalInfoAttribute:SelfCal.Supported": ("calibration_date", ""),
    "DAQmxGetSelfCalLastDateAndTime": ("calibration_date", ""),
    "DAQmxGetCalInfoAttribute:SelfCal.LastTemp": ("calibration_temperature_c", math.nan),
}


@pytest.mark.parametrize("function", METADATA)
def test_a_board_without_calibration_information_is_used(doubles, parameters, function, caplog):
    """NI's simulated devices refuse the date with -200077."""
    doubles.control.inject(function, "error", code=-200077)
    with open_daqmx(parameters) as rig:
        acquired = take(rig, doubles, key())
    assert_sound(parameters, acquired, key())
    assert "is unknown: reading" in caplog.text
    name, unknown = METADATA[function]
    assert acquired.settings[name] == pytest.approx(unknown, nan_ok=True)


# Reference clock ------------------------------------------------------------------------------------


def test_a_chassis_clock_is_requested_and_the_shot_is_the_same(doubles, parameters):
    locked = replace(parameters, reference_clock="PXI_Clk10")
    with open_daqmx(locked) as rig:
        acquired = take(rig, doubles, key())
    assert_sound(parameters, acquired, key())
    assert acquired.settings["reference_clock"] == "PXI_Clk10"
    attributes = {call["attribute"] for call in doubles.control.record()["calls"]}
    assert {"RefClk.Src", "RefClk.Rate"} <= attributes


# gRPC ---------------------------------------------------------------------------------------------


on_a_server = pytest.mark.parametrize("transport", ["grpc"], indirect=True)


@pytest.fixture
def remote(doubles, transport):
    return parameters_of(DESCRIPTION, doubles, transport=transport, call_timeout_s=READ_TIMEOUT_S)


@on_a_server
def test_a_coil_whose_stop_hangs_is_switched_off_by_the_next_call(doubles, remote, monkeypatch):
    from hardware_drivers.daqmx.remote import Deadlines

    usual = Deadlines.deadline_s

    def short_for_what_hangs(self, method, request):
        return 0.1 if method.endswith(("/StopTask", "/TaskControl")) else usual(self, method, request)

    with open_daqmx(replace(remote, pulse_s=0.5)) as rig:
        rig.digitizer.arm(key(1))
        monkeypatch.setattr(Deadlines, "deadline_s", short_for_what_hangs)
        doubles.control.inject("DAQmxWaitUntilTaskDone", "error", code=-50405)
        for function in ("StopTask", "TaskControl"):
            doubles.control.inject(f"DAQmx{function}", "hang")
        with pytest.raises(ConnectionLostError, match="-50405"):
            rig.striker.strike(key(1))
        rig.striker.make_safe()
        (pulse_s,) = coil_pulses_s(doubles.control.record())
        # Two deadlines of 0.1 s have passed; the pulse itself would have lasted 0.5 s.
        assert 0.2 <= pulse_s < 0.5
        doubles.control.release_hangs()
        monkeypatch.undo()
    doubles.control.clear_record()


@on_a_server
def test_a_record_larger_than_grpcs_own_limit_comes_through(doubles, remote):
    # Quiet samples are negative codes here, ten bytes each: ten megabytes.
    large = replace(remote, dry_run=True, record_samples=1_000_000, call_timeout_s=20.0)
    with open_daqmx(large) as rig:
        rig.digitizer.arm(key())
        assert rig.digitizer.read(READ_TIMEOUT_S).waveform.counts.size == 1_000_000


@on_a_server
def test_only_the_tasks_of_a_killed_recorder_are_cleared(doubles, remote):
    from nidaqmx import Task
    from nidaqmx.grpc_session_options import GrpcSessionOptions

    from hardware_drivers.daqmx.remote import Channel

    started = context().Event()
    victim = in_a_process(arm_and_wait, remote, started)
    happened(started.wait, "the victim armed its digitizer")
    victim.kill()
    victim.join()
    channel = Channel(remote.grpc_address, call_timeout_s=READ_TIMEOUT_S, record_samples=1)
    other = Task("somebody", grpc_options=GrpcSessionOptions(channel.calls, "somebody"))
    left = [task["task"] for task in doubles.control.record()["tasks"]]
    assert len(left) == 3
    with open_daqmx(remote) as rig:
        names = {task["task"] for task in doubles.control.record()["tasks"]}
        assert names == {"somebody"}
        assert_sound(remote, take(rig, doubles, key(1)), key(1))
    assert [task["task"] for task in doubles.control.record()["tasks"]] == ["somebody"]
    other.close()
    channel.close()


def arm_and_wait(parameters, started):
    """Leave an armed digitizer behind, in a child."""
    with open_daqmx(parameters) as rig:
        rig.digitizer.arm(key(0))
        started.set()
        threading.Event().wait()


@on_a_server
def test_a_second_process_of_this_computer_does_not_clear_the_first_ones_tasks(doubles, remote):
    with open_daqmx(remote) as rig:
        rig.digitizer.arm(key(0))
        with pytest.raises(BusyError, match=f"process {os.getpid()}"):
            open_daqmx(remote).__enter__()
        rig.striker.strike(key(0))
        rig.digitizer.read(READ_TIMEOUT_S)


def test_a_killed_server_is_found_again_at_its_address():
    if reason := why_no("grpc"):
        pytest.skip(reason)
    with ExitStack() as stack:
        first = stack.enter_context(running_brain(DESCRIPTION))
        forwarder = stack.enter_context(Forwarder(first.grpc))
        remote = replace(
            parameters_of(DESCRIPTION, first, transport="grpc", call_timeout_s=1.0),
            grpc_address=forwarder.address,
        )
        rig = stack.enter_context(open_daqmx(remote))
        take(rig, first, key(0))
        rig.digitizer.arm(key(1))
        first.kill()
        with pytest.raises(ConnectionLostError, match="gRPC"):
            rig.striker.strike(key(1))
        for _ in range(3):
            with pytest.raises(ConnectionLostError, match="gRPC"):
                rig.digitizer.arm(key(1))
        second = stack.enter_context(running_brain(DESCRIPTION))
        forwarder.target = second.grpc
        assert_sound(remote, take(rig, second, key(2)), key(2))
