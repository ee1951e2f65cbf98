"""The X Series watchdog around a strike: idle when all is well, and what it does when the host is late.

The counter times the pulse and the watchdog is set longer than a whole strike, so a host that hangs while
the counter runs leaves nothing for it to do. It cuts a pulse that began late: where the call that starts
the counter hangs on its way to the board.
"""

from dataclasses import replace

import pytest
from support.daqmx_rig import (
    TRANSPORTS,
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

from hardware_drivers.daqmx.instruments import open_daqmx
from hardware_drivers.daqmx.parameters import WatchdogWiring
from hardware_drivers.errors import (
    AcquisitionTimeoutError,
    BusyError,
    ConfigurationError,
    ConnectionLostError,
)
from hardware_drivers.measurement import ShotKey
from simulator.doubles.chassis.description import SIMULTANEOUS_12_BIT, SIMULTANEOUS_16_BIT

SERIAL = SIMULTANEOUS_16_BIT.serial_number
S_SERIES = SIMULTANEOUS_12_BIT.serial_number
DESCRIPTION = replace(
    quick_description(board(), SIMULTANEOUS_12_BIT),
    transducers={"C": wired(SERIAL, 0), "D": wired(SERIAL, 1), "E": wired(SERIAL, 2)},
)
LINE = f"{SERIAL}/PFI12"
LONG_PULSE_S = 0.5
TIMEOUT_S = 1.0
SHORT_TIMEOUT_S = 0.5
"""Of tests that wait for it to pass; a quick strike takes a tenth of it."""
LATE_S = TIMEOUT_S - 0.5 * LONG_PULSE_S
"""The counter starts so long after the watchdog, half a pulse before its end: a quarter of a second of
slowness either way still has the watchdog end within the pulse."""


@pytest.fixture(params=TRANSPORTS)
def parameters(request, doubles, monkeypatch):
    reach(request.param, doubles, monkeypatch)
    yield guarded(parameters_of(DESCRIPTION, doubles, transport=request.param))
    doubles.control.clear_faults()
    doubles.control.release_hangs()
    record = doubles.control.record()
    assert record["reservations"] == {}
    assert record["tasks"] == []
    assert not any(record["levels"].values())


def guarded(parameters, timeout_s=TIMEOUT_S, lines=("port2/line4", "port2/line5", "port2/line6")):
    watchdog = WatchdogWiring(board_serial=f"{SERIAL:08X}", lines=lines, timeout_s=timeout_s)
    return replace(parameters, watchdog=watchdog)


def key(shot_index=0, position="C"):
    return ShotKey(position=position, set_index=4, shot_index=shot_index)


def assert_sound(parameters, acquired, which):
    assert (acquired.waveform.counts == counts_of_the_twin(DESCRIPTION, parameters, which)).all()


def watchdog_task(doubles):
    (task,) = [task for task in doubles.control.record()["tasks"] if task["kind"] == "watchdog"]
    return task


def causes(record):
    return [event["cause"] for event in record["lines"]]


@pytest.mark.parametrize("parameters", ["library", "grpc"], indirect=True)
def test_a_strike_leaves_the_watchdog_stopped_and_unexpired(doubles, parameters):
    with open_daqmx(parameters) as rig:
        for position in "CDE":
            take(rig, doubles, key(0, position))
            doubles.control.clear_record()
            assert_sound(parameters, take(rig, doubles, key(1, position)), key(1, position))
            record = doubles.control.record()
            assert [name for name in functions_of(record) if name != "GetReadAttribute"] == [
                "StartTask", "StartTask", "StartTask", "WaitUntilTaskDone", "StopTask",
                "GetWatchdogAttribute", "StopTask", "ReadBinaryI16", "StopTask",
            ]  # fmt: skip
            assert causes(record) == ["pulse", "pulse"]
            # Stopped, and kept for the next strike of this turn.
            assert watchdog_task(doubles)["state"] == "committed"
            assert f"{SERIAL}/watchdog" in record["reservations"]
    record = doubles.control.record()
    assert (record["tasks"], record["reservations"]) == ([], {})


def test_a_host_that_hangs_while_the_counter_runs_leaves_the_pulse_to_the_counter(doubles, parameters):
    parameters = guarded(parameters, SHORT_TIMEOUT_S)
    with open_daqmx(parameters) as rig:
        rig.digitizer.arm(key(0))
        doubles.control.inject("DAQmxWaitUntilTaskDone", "hang", seconds=1.2 * SHORT_TIMEOUT_S)
        with pytest.raises(AcquisitionTimeoutError, match=r"watchdog.*expired.*watchdog\.timeout_s"):
            rig.striker.strike(key(0))
        record = doubles.control.record()
        assert causes(record) == ["pulse", "pulse"]
        # The counter's time base is 100 MHz: the pulse is as long as asked to the nanosecond.
        assert coil_pulses_s(record) == [parameters.pulse_s]
        assert_sound(parameters, take(rig, doubles, key(1)), key(1))
        assert causes(doubles.control.record()) == ["pulse"] * 4


def test_a_pulse_that_begins_late_is_cut_at_the_watchdog_s_own_time(doubles, parameters):
    late = replace(parameters, pulse_s=LONG_PULSE_S)
    with open_daqmx(late) as rig:
        rig.digitizer.arm(key(0))
        doubles.control.clear_record()
        doubles.control.inject("DAQmxStartTask", "hang", nth=2, seconds=LATE_S)
        with pytest.raises(AcquisitionTimeoutError, match=r"watchdog.*PXIe-6386.*watchdog\.timeout_s"):
            rig.striker.strike(key(0))
        record = doubles.control.record()
        (pulse_s,) = coil_pulses_s(record)
        rises, falls = record["lines"]
        assert (falls["line"], falls["level"], falls["cause"]) == (LINE, 0, "watchdog")
        armed = next(call for call in record["calls"] if call["function"] == "DAQmxStartTask")
        # The timer began while the call that starts it was under way.
        assert armed["begin_ns"] <= falls["ns"] - round(TIMEOUT_S * 1e9) <= armed["end_ns"]
        assert rises["cause"] == "pulse"
        assert pulse_s < LONG_PULSE_S
        assert functions_of(record).count("ControlWatchdogTask") == 1
        assert [task for task in record["tasks"] if task["state"] == "running"] == []
        assert_sound(late, take(rig, doubles, key(1)), key(1))
    assert causes(doubles.control.record())[2:] == ["pulse", "pulse"]


def test_a_counter_that_starts_after_expiry_is_refused_by_the_board(doubles, parameters):
    parameters = guarded(parameters, SHORT_TIMEOUT_S)
    with open_daqmx(parameters) as rig:
        rig.digitizer.arm(key(0))
        doubles.control.inject("DAQmxStartTask", "hang", nth=2, seconds=1.2 * SHORT_TIMEOUT_S)
        with pytest.raises(ConnectionLostError, match="-201434"):
            rig.striker.strike(key(0))
        assert doubles.control.record()["lines"] == []
        assert_sound(parameters, take(rig, doubles, key(1)), key(1))


def test_a_board_that_reports_a_false_expiry_costs_one_strike(doubles, parameters):
    with open_daqmx(parameters) as rig:
        rig.digitizer.arm(key(0))
        doubles.control.inject("DAQmxGetWatchdogAttribute:Watchdog.HasExpired", "lie")
        with pytest.raises(AcquisitionTimeoutError, match=r"watchdog\.timeout_s"):
            rig.striker.strike(key(0))
        assert_sound(parameters, take(rig, doubles, key(1)), key(1))


def test_a_board_without_a_watchdog_is_refused_when_the_rig_opens(doubles, parameters):
    wiring = replace(parameters.transducers["C"], striker_serial=f"{S_SERIES:08X}", output_terminal="Ctr0Out")
    watchdog = replace(parameters.watchdog, board_serial=f"{S_SERIES:08X}")
    unguarded = replace(parameters, transducers={"C": wiring}, watchdog=watchdog)
    with pytest.raises(ConfigurationError, match=r"PXI1Slot4 \(PXI-6115\).*-200662"):
        open_daqmx(unguarded).__enter__()
    with open_daqmx(replace(unguarded, watchdog=None)):
        pass
    assert doubles.control.record()["lines"] == []


def test_a_line_the_board_does_not_have_is_refused_when_the_rig_opens(parameters):
    wrong = guarded(parameters, lines=("port2/line4", "port2/line8"))
    with pytest.raises(ConfigurationError, match=r"port2/line8.*-200170"):
        open_daqmx(wrong).__enter__()


def test_a_watchdog_of_another_process_is_busy_and_nothing_moves(doubles, parameters):
    with open_daqmx(parameters) as rig:
        doubles.control.occupy(f"{SERIAL}/watchdog", "LabVIEW on BENCH-7")
        try:
            with pytest.raises(BusyError, match=r"owner: .*LabVIEW on BENCH-7"):
                rig.digitizer.arm(key(0))
        finally:
            doubles.control.vacate("LabVIEW on BENCH-7")
        assert doubles.control.record()["lines"] == []
        assert_sound(parameters, take(rig, doubles, key(1)), key(1))


def test_the_watchdog_is_reserved_before_any_other_task(doubles, parameters):
    """NI's -201477 asks for that on some boards: stop and unreserve all other tasks first."""
    with open_daqmx(parameters) as rig:
        doubles.control.clear_record()
        rig.digitizer.arm(key(0))
        names = functions_of(doubles.control.record())
    assert names.index("CfgWatchdogDOExpirStates") < names.index("TaskControl")
    assert names.index("TaskControl") < names.index("CreateCOPulseChanTime")
    assert names.index("CreateCOPulseChanTime") < names.index("CreateAIVoltageChan")
