"""A fault at each call of the NI-SCOPE driver: a typed error, nothing left open, the next record taken.

The list of calls is not written down: it is what the double recorded while the driver opened the board,
took a record, calibrated itself and closed. A call that the driver makes tomorrow is struck tomorrow.
"""

import math
import os
import signal
import socket
from collections import Counter
from contextlib import contextmanager

import numpy as np
import pytest
import support.niscope_rig as rig
from support.daqmx_models import in_a_process
from support.waiting import happened, until

from hardware_drivers.errors import (
    AcquisitionTimeoutError,
    BusyError,
    ConnectionLostError,
    InstrumentError,
    UnknownStatusError,
)
from hardware_drivers.niscope.pulse_echo import open_niscope
from hardware_drivers.niscope.vendor_errors import CLASS_OF_CODE
from simulator.doubles.device_model import Brain

pytestmark = rig.needs_niscope

DESCRIBED = rig.description(repetition_hz=20e3)
"""A pulser without waiting time."""

HARDWARE_FAILURE = -1074118654
ATTEMPTS = 4
"""The ladder has three rungs; a lie about the end of one acquisition costs the next one too."""

PHASES = ("open", "acquire", "calibrate", "close")


def recorded_calls():
    """Return the functions called in each phase without faults, in order."""
    if rig.why_no_niscope():
        return {}
    with rig.met_brain(DESCRIBED) as brain:
        marks = [0]

        def mark():
            marks.append(len(brain.record()["calls"]))

        with open_niscope(rig.parameters()) as unit:
            mark()
            unit.acquire(rig.key(), rig.TIMEOUT_S)
            mark()
            unit.self_calibrate()
            mark()
        mark()
        called = rig.functions_of(brain.record())
    return {phase: called[marks[i] : marks[i + 1]] for i, phase in enumerate(PHASES)}


def cases(*wanted):
    """Return each function of each phase at its first call; in an acquisition at every call."""
    found = []
    for phase, called in recorded_calls().items():
        if phase not in wanted:
            continue
        seen = Counter()
        for function in called:
            # The package says once a process who it is.
            if function == "niScope_SetRuntimeEnvironment":
                continue
            seen[function] += 1
            if seen[function] == 1 or phase == "acquire":
                found.append((phase, function, seen[function]))
    return found


ALL = cases(*PHASES)
ids = [f"{phase}-{function.removeprefix('niScope_')}-{nth}" for phase, function, nth in ALL]
each_call = pytest.mark.parametrize(("phase", "function", "nth"), ALL, ids=ids)
FIRST_OF_PHASE = {phase: (phase, *rest) for phase, *rest in reversed(ALL)}
"""The first call of each phase: enough by default of what the others only repeat."""


def test_the_list_of_calls_covers_the_driver_s_life():
    called = recorded_calls()
    assert set(called) == set(PHASES)
    assert {"niScope_InitWithOptions", "niScope_Commit"} <= set(called["open"])
    assert {"niScope_InitiateAcquisition", "niScope_FetchBinary16", "niScope_Abort"} <= set(called["acquire"])
    assert "niScope_CalSelfCalibrate" in called["calibrate"]
    assert "niScope_close" in called["close"]


def is_right(echo, described):
    """Return whether counts and volts of a record equal those of the twin."""
    codes = rig.codes_of_the_twin(described, rig.key())
    right_counts = np.array_equal(echo.waveform.counts, 64 * codes.astype(np.int32))
    return right_counts and np.array_equal(
        echo.waveform.volts(), rig.SCOPE.calibration(1.0, 0.0).volts(codes)
    )


def take(unit, brain):
    brain.announce(rig.key(), rig.HOUR_H)
    return unit.acquire(rig.key(), rig.TIMEOUT_S)


def live(brain, phase, struck):
    """Run the driver up to a phase; `struck` injects the fault at the start of the phase.

    Returns the unit's error in that phase, or None, and every record taken after it, errors in between
    counted.
    """
    error, after, lost = None, [], 0

    @contextmanager
    def catching():
        nonlocal error
        try:
            yield
        except InstrumentError as caught:
            error = caught

    def go_on(unit):
        nonlocal lost
        for _ in range(ATTEMPTS):
            try:
                after.append(take(unit, brain))
            except ConnectionLostError:
                lost += 1
            else:
                return

    if phase == "open":
        struck()
    with catching(), open_niscope(rig.parameters()) as unit:
        if phase == "acquire":
            struck()
            with catching():
                after.append(take(unit, brain))
        if phase == "calibrate":
            struck()
            with catching():
                unit.self_calibrate()
        go_on(unit)
        if phase == "close":
            struck()
    return error, after, lost


@pytest.fixture
def brain():
    with rig.met_brain(DESCRIBED) as brain:
        yield brain


def works_again(brain):
    """Check that nothing is left open and a new driver takes the right record."""
    brain.faults.clear()
    assert brain.record()["sessions"] == []
    with open_niscope(rig.parameters()) as unit:
        assert is_right(take(unit, brain), DESCRIBED)
    assert brain.record()["sessions"] == []
    return True


@each_call
def test_an_error_is_typed_and_costs_one_record_at_most(brain, phase, function, nth):
    error, after, lost = live(
        brain, phase, lambda: brain.faults.inject(function, "error", code=HARDWARE_FAILURE, nth=nth)
    )
    if phase == "close":
        assert error is None
    else:
        assert isinstance(error, ConnectionLostError)
        assert error.__cause__ is not None
    if phase != "open":
        assert after
        assert lost == 0
    assert all(is_right(echo, DESCRIBED) for echo in after)
    assert works_again(brain)


@each_call
def test_a_lie_never_becomes_a_wrong_record(brain, phase, function, nth):
    error, after, _ = live(brain, phase, lambda: brain.faults.inject(function, "lie", nth=nth))
    assert all(is_right(echo, DESCRIBED) for echo in after)
    if function in ("niScope_InitWithOptions", "niScope_close"):
        # A wrong handle, a board that says it is closed and is not: only the end of this process, or the
        # supervisor that ends it, gives the board back. Until then the driver says that it is in use.
        assert len(brain.record()["sessions"]) == 1
        with pytest.raises(BusyError), open_niscope(rig.parameters()):
            pytest.fail("it opened")
        return
    assert error is not None or after
    if phase != "open":
        assert after
    assert works_again(brain)


@pytest.mark.parametrize(
    ("phase", "function", "nth"),
    [pytest.param(*one, marks=() if one in FIRST_OF_PHASE.values() else pytest.mark.slow) for one in ALL],
    ids=ids,
)
def test_a_process_that_dies_is_a_lost_connection_and_a_new_one_is_found(phase, function, nth):
    with dying_brain(DESCRIBED) as brain:
        error, after, _ = live(brain, phase, lambda: brain.faults.inject(function, "death", nth=nth))
    if phase == "close":
        assert error is None
    else:
        assert isinstance(error, ConnectionLostError)
    with rig.met_brain(DESCRIBED) as brain:
        assert works_again(brain)
    assert all(is_right(echo, DESCRIBED) for echo in after)


@contextmanager
def dying_brain(described):
    """Run a double whose death closes every client connection at once."""
    connections = []

    class Mortal(rig.WireServer):
        def get_request(self):
            connection, address = super().get_request()
            connections.append(connection)
            return connection, address

    def die():
        server.socket.close()
        for connection in connections:
            # The one that asked may be closed already.
            if connection.fileno() >= 0:
                connection.shutdown(socket.SHUT_RDWR)
        raise ConnectionAbortedError("the double died on order")

    brain = Brain(described, die=die)
    with rig.met_server(Mortal(brain)) as server:
        yield brain


def live_until_it_hangs(environment):
    """Open the board, take a record and calibrate in a child; one call never returns."""
    os.environ.update(environment)
    rig.preload()
    with open_niscope(rig.parameters()) as unit:
        unit.acquire(rig.key(), rig.TIMEOUT_S)
        unit.self_calibrate()


NOT_SLOW = {"niScope_InitWithOptions", "niScope_FetchBinary16", "niScope_CalSelfCalibrate", "niScope_close"}
HANGING = [
    pytest.param(function, marks=() if function in NOT_SLOW else pytest.mark.slow)
    for function in sorted({function for _, function, _ in ALL})
]


@pytest.mark.parametrize("function", HANGING)
def test_a_hung_call_ends_with_its_process_and_leaves_the_board_free(brain, function):
    brain.faults.inject(function, "hang")
    child = in_a_process(live_until_it_hangs, dict(os.environ))
    happened(brain.faults.wait_until_hanging, "a call hung")
    child.kill()
    child.join()
    assert child.exitcode == -signal.SIGKILL, "it ended by itself"
    # First the double notices that the process is gone, then the hung call may continue without a client.
    until(lambda: not brain.record()["clients"], "the double noticed that the process is gone")
    brain.faults.release()
    assert works_again(brain)


CLASSES = {**CLASS_OF_CODE, -1074135024: UnknownStatusError}
ONE_OF_EACH = {kind: code for code, kind in CLASSES.items()}.values()


@pytest.mark.parametrize(
    "code",
    [pytest.param(code, marks=() if code in ONE_OF_EACH else pytest.mark.slow) for code in CLASSES],
    ids=str,
)
@pytest.mark.parametrize("function", ["niScope_InitiateAcquisition", "niScope_FetchBinary16"])
def test_each_code_has_its_class_and_a_way_back(brain, function, code):
    kind = CLASSES[code]
    with open_niscope(rig.parameters()) as unit:
        brain.clear_record()
        brain.faults.inject(function, "error", code=code)
        with pytest.raises(InstrumentError, match=str(code)) as raised:
            take(unit, brain)
        assert type(raised.value) is kind
        assert raised.value.__cause__.code == code
        # Only a lost connection is rebuilt: a missed trigger, a busy board or a wrong wish keep the session.
        reopened = take(unit, brain) and "niScope_InitWithOptions" in rig.functions_of(brain.record())
        assert reopened is issubclass(kind, ConnectionLostError)
    assert works_again(brain)


INVALID_VALUE = -1074135024


@pytest.mark.parametrize(
    ("function", "name", "unknown"),
    [
        ("niScope_CalFetchDate", "calibration_date", ""),
        ("niScope_CalFetchTemperature", "calibration_temperature_c", math.nan),
    ],
)
def test_a_board_without_calibration_information_is_used(brain, function, name, unknown, caplog):
    brain.faults.inject(function, "error", code=INVALID_VALUE)
    with open_niscope(rig.parameters()) as unit:
        echo = take(unit, brain)
    assert is_right(echo, DESCRIBED)
    assert "is unknown: reading" in caplog.text
    assert echo.settings[name] == pytest.approx(unknown, nan_ok=True)


def test_after_a_missed_trigger_the_board_is_idle_and_set_up(brain):
    with open_niscope(rig.parameters()) as unit:
        brain.clear_record()
        brain.faults.inject("niScope_FetchBinary16", "error", code=-1074126845)
        with pytest.raises(AcquisitionTimeoutError):
            take(unit, brain)
        assert "niScope_Abort" in rig.functions_of(brain.record())
        assert is_right(take(unit, brain), DESCRIBED)
        assert "niScope_Commit" not in rig.functions_of(brain.record())
