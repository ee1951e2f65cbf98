"""A fault at each driver call in turn: error, hang, lie, death, by library and by gRPC.

The list of calls is the double's own record of a shot without faults, so a call that is added to the
driver is covered without editing a test. After every fault: each error raised is one of the four classes
and the right one, each record is the twin's bit for bit, the coil is low and no pulse was longer than
asked, nothing is held, and the next shot is taken; after a configuration error the rig ends cleanly and
a new one takes the next shot.

The default run takes every entry point by library with a lost connection and with a lie, the first call of
every phase with every other fault, and over gRPC, some ten times slower, a death and a hang of the first and
of the last call (`test_daqmx_faults` has those between); every call is `slow`. In the library nothing ends a
call that hangs: there the client is a process of its own that is killed, as the supervisor would, and the
next process takes the shot.
"""

from __future__ import annotations

import gc
import warnings
from contextlib import ExitStack
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from nidaqmx.errors import DaqResourceWarning
from support.daqmx_models import RunningBrain, in_a_process, running_brain
from support.daqmx_rig import (
    HOUR_H,
    QUICK_PULSE_S,
    Forwarder,
    board,
    coil_pulses_s,
    counts_of_the_twin,
    meet,
    parameters_of,
    quick_description,
    take,
    why_no,
)
from support.waiting import happened

from hardware_drivers.daqmx.chassis import LADDER
from hardware_drivers.daqmx.instruments import open_daqmx
from hardware_drivers.daqmx.parameters import DaqmxParameters, WatchdogWiring
from hardware_drivers.errors import (
    AcquisitionTimeoutError,
    BusyError,
    ConfigurationError,
    ConnectionLostError,
    InstrumentError,
)
from hardware_drivers.instruments import Acquired
from hardware_drivers.measurement import ShotKey
from simulator.doubles.errors import DoublesProcessError

DESCRIPTION = quick_description(board(), positions="C")
READ_TIMEOUT_S = 0.3
"""Of a line with a fault in it, which may have to wait it out."""
SOUND_READ_TIMEOUT_S = 20.0
"""Of a line without: a machine that is slow is no missed strike."""
HOLDOFF_S = 5e-3
"""A third of the fall from 1 mm."""
PHASES = ("opening", "arming", "striking", "reading", "calibrating", "closing")

LOST, BUSY, CONFIGURATION, MISSED = -88710, -50103, -200077, -200284
CLASS_OF = {
    LOST: ConnectionLostError,
    BUSY: BusyError,
    CONFIGURATION: ConfigurationError,
    MISSED: AcquisitionTimeoutError,
}
CANNOT_BE_CLEARED = {"DAQmxCreateTask", "DAQmxCreateWatchdogTimerTaskEx", "DAQmxClearTask"}
"""A lie about a new task's handle, a refusal to clear: an empty task stays in the driver, holding nothing."""


@dataclass(frozen=True)
class Call:
    """One distinct call of the fault-free shot: phase, entry point and subject."""

    phase: str
    function: str
    attribute: str

    @property
    def name(self):
        return f"{self.function}:{self.attribute}" if self.attribute else self.function


@dataclass
class Laboratory:
    """Double, the driver's parameters for it, and a replacement for a dead double."""

    brain: RunningBrain
    parameters: DaqmxParameters
    forwarder: Forwarder | None
    stack: ExitStack
    patch: pytest.MonkeyPatch

    def is_alive(self):
        try:
            self.brain.control.wait_until_hanging(0.0)
        except DoublesProcessError:
            return False
        return True

    def replace_dead_brain(self):
        if self.is_alive():
            return
        self.brain = self.stack.enter_context(running_brain(DESCRIPTION))
        self.meet()

    def meet(self):
        if self.forwarder is None:
            meet(self.brain, self.patch)
        else:
            self.forwarder.target = self.brain.grpc


@dataclass
class Outcome:
    """Result of a line of shots."""

    errors: list[InstrumentError] = field(default_factory=list)
    records: list[tuple[ShotKey, Acquired]] = field(default_factory=list)


@pytest.fixture(params=["library", "grpc"], scope="module")
def laboratory(request):
    if reason := why_no(request.param):
        pytest.skip(reason)
    with ExitStack() as stack:
        brain = stack.enter_context(running_brain(DESCRIPTION))
        forwarder = None
        changes = {}
        if request.param == "grpc":
            forwarder = stack.enter_context(Forwarder(brain.grpc))
            changes = {"transport": "grpc", "grpc_address": forwarder.address, "call_timeout_s": 0.4}
        made = Laboratory(
            brain=brain,
            parameters=guarded(parameters_of(DESCRIPTION, brain, fall_margin_s=5e-3, **changes)),
            forwarder=forwarder,
            stack=stack,
            patch=stack.enter_context(pytest.MonkeyPatch.context()),
        )
        made.meet()
        yield made


def guarded(parameters):
    """Enable watchdog and holdoff, so that their calls get faults too."""
    serial = parameters.transducers["C"].coil_serial
    watchdog = WatchdogWiring(board_serial=serial, lines=("port2/line4",))
    return replace(parameters, watchdog=watchdog, holdoff_s=HOLDOFF_S)


@pytest.fixture(scope="module")
def calls(laboratory):
    """Return every distinct call of a fault-free line, by its phase."""
    control = laboratory.brain.control
    found = []

    def note(phase):
        for call in control.record()["calls"]:
            entry = Call(phase, call["function"], call["attribute"])
            if entry not in found:
                found.append(entry)
        control.clear_record()

    control.clear_record()
    ended = iter(PHASES)
    outcome = line(
        laboratory,
        before=lambda phase: None if phase == "opening" else note(next(ended)),
        read_timeout_s=SOUND_READ_TIMEOUT_S,
    )
    note("closing")
    assert not outcome.errors
    assert {call.phase for call in found} == set(PHASES)
    # As a local entry of the C library this one never reaches the double; and it is called once a process.
    return [call for call in found if call.function != "DAQmxSetRuntimeEnvironment"]


def line(laboratory, before=lambda _: None, *, read_timeout_s=READ_TIMEOUT_S):
    """Open, take a shot, self-calibrate, close; make the rig safe after an error and continue."""
    outcome = Outcome()
    stack = ExitStack()
    before("opening")
    try:
        rig = stack.enter_context(open_daqmx(laboratory.parameters))
    except InstrumentError as error:
        outcome.errors.append(error)
        return outcome
    try:
        _go_on(rig, laboratory, outcome, before, read_timeout_s)
    finally:
        before("closing")
        stack.close()
    return outcome


def _go_on(rig, laboratory, outcome, before, read_timeout_s):
    key = ShotKey(position="C", set_index=2, shot_index=0)
    try:
        laboratory.replace_dead_brain()
        laboratory.brain.control.announce(key, HOUR_H)
        before("arming")
        rig.digitizer.arm(key)
        before("striking")
        rig.striker.strike(key)
        before("reading")
        outcome.records.append((key, rig.digitizer.read(read_timeout_s)))
    except InstrumentError as error:
        outcome.errors.append(error)
        make_safe(rig, outcome)
    before("calibrating")
    try:
        rig.self_calibrating.self_calibrate()
    except InstrumentError as error:
        outcome.errors.append(error)
    if not any(isinstance(error, ConfigurationError) for error in outcome.errors):
        take_next(rig, laboratory, outcome, read_timeout_s)


def make_safe(rig, outcome):
    """Make coil, then digitizer safe, as a rig does."""
    try:
        rig.striker.make_safe()
    except InstrumentError as error:
        outcome.errors.append(error)
    finally:
        rig.digitizer.disarm()


def take_next(rig, laboratory, outcome, read_timeout_s):
    """Take the next shot within the recovery steps and one busy turn after any fault."""
    for shot in range(1, len(LADDER) + 3):
        key = ShotKey(position="C", set_index=2, shot_index=shot)
        try:
            laboratory.replace_dead_brain()
            outcome.records.append((key, take(rig, laboratory.brain, key, read_timeout_s=read_timeout_s)))
        except InstrumentError as error:
            outcome.errors.append(error)
            make_safe(rig, outcome)
            if isinstance(error, ConfigurationError):
                return
        else:
            return
    raise AssertionError(f"no shot was taken after the fault: {outcome.errors}")


def faulty_line(laboratory, call, kind, code):
    """Take a line of shots with one fault in it."""

    def before(phase):
        laboratory.replace_dead_brain()
        if phase == call.phase:
            laboratory.brain.control.inject(call.name, kind, code=code)

    return line(laboratory, before)


def wrong_results(laboratory, outcome, allowed):
    """Yield errors of a wrong class and records that differ from the twin."""
    for error in outcome.errors:
        if not isinstance(error, allowed):
            yield f"{type(error).__name__} is the wrong class: {error}"
    for key, acquired in outcome.records:
        waveform = acquired.waveform
        expected = counts_of_the_twin(DESCRIPTION, laboratory.parameters, key)
        if not np.array_equal(waveform.counts, expected):
            yield f"the record of {key} is not the twin's"
        if not np.array_equal(waveform.calibration.coefficients_v, polynomial_v()):
            yield f"the scaling of {key} is not the board's"
        if (waveform.sample_rate_hz, waveform.pretrigger_samples) != (10e6, 1000):
            yield f"rate or pre-trigger of {key} is wrong"


def left_wrongly(laboratory, call):
    """Yield a coil left on, a pulse too long, and tasks or reservations left behind."""
    record = laboratory.brain.control.record()
    if record["reservations"]:
        yield f"still held: {record['reservations']}"
    if record["tasks"] and call.function not in CANNOT_BE_CLEARED:
        yield f"left behind: {record['tasks']}"
    if any(task["state"] not in ("unverified", "verified") for task in record["tasks"]):
        yield f"left behind holding something: {record['tasks']}"
    yield from coil_wrongly(laboratory)


def coil_wrongly(laboratory):
    """Yield faults of the coil's line in the record of the double."""
    try:
        pulses_s = coil_pulses_s(laboratory.brain.control.record())
    except AssertionError as error:
        yield str(error)
        return
    if not all(0.0 < pulse_s <= QUICK_PULSE_S for pulse_s in pulses_s):
        yield f"pulses of {pulses_s} s"


def polynomial_v():
    mine = DESCRIPTION.boards[0]
    from simulator.electronics.transduction import make_adc_calibration
    from simulator.parameters.electronics import AdcParameters

    return make_adc_calibration(mine.adc(AdcParameters())).coefficients_v


def next_run_is_sound(laboratory, call):
    """Check that a new rig runs the line without an error and leaves nothing."""
    control = laboratory.brain.control
    control.clear_faults()
    control.release_hangs()
    # A striker that the fault left in the air would ring in the new rig's record: a person's restart takes
    # longer than its fall.
    happened(control.wait_until_quiet, "the striker landed")
    control.clear_record()
    outcome = line(laboratory, read_timeout_s=SOUND_READ_TIMEOUT_S)
    if outcome.errors:
        yield f"the next run failed: {outcome.errors}"
    texts = [*wrong_results(laboratory, outcome, ()), *left_wrongly(laboratory, call)]
    yield from (f"the next run: {text}" for text in texts)
    # What the driver would not clear would gather over the cases.
    if laboratory.brain.control.record()["tasks"]:
        laboratory.brain.process.kill()
        laboratory.replace_dead_brain()


def each_in_turn(laboratory, chosen, kind, allowed, code=None):
    with warnings.catch_warnings():
        # NI's objects warn when they are collected and the driver had refused to clear them. Whether
        # anything was left is asked of the double.
        warnings.simplefilter("ignore", DaqResourceWarning)
        wrong = [
            f"{kind} at {call.name} while {call.phase}: {text}"
            for call in chosen
            for text in after_a_fault(laboratory, call, kind, allowed, code)
        ]
        gc.collect()
    assert not wrong, "\n".join(wrong)


def after_a_fault(laboratory, call, kind, allowed, code):
    """Return every fault found after one injected fault."""
    laboratory.brain.control.clear_record()
    texts = []
    try:
        outcome = faulty_line(laboratory, call, kind, code)
        laboratory.replace_dead_brain()
        texts += wrong_results(laboratory, outcome, allowed)
        if kind == "hang":  # what hung is carried out when it is released; the next run clears it
            laboratory.brain.control.release_hangs()
            texts += coil_wrongly(laboratory)
        else:
            texts += left_wrongly(laboratory, call)
        texts += next_run_is_sound(laboratory, call)
    except Exception as error:  # noqa: BLE001 # whatever else came through is the finding
        texts.append(f"{type(error).__name__} came through: {error}")
        laboratory.brain.process.kill()
        laboratory.replace_dead_brain()
    return texts


def one_of_each(calls):
    """Return the first call of every entry point."""
    first = {}
    for call in calls:
        first.setdefault(call.function, call)
    return list(first.values())


def one_of_each_phase(calls):
    """Return the first call of every phase."""
    first = {}
    for call in calls:
        first.setdefault(call.phase, call)
    return list(first.values())


ANY_OF_THEM = (ConnectionLostError, AcquisitionTimeoutError, ConfigurationError)


def test_the_list_is_the_drivers(calls):
    functions = {call.function for call in calls}
    assert {"DAQmxCreateTask", "DAQmxStartTask", "DAQmxReadBinaryI16", "DAQmxSelfCal"} <= functions
    assert len(calls) > 60


by_library = pytest.mark.parametrize("laboratory", ["library"], indirect=True)
over_grpc = pytest.mark.parametrize("laboratory", ["grpc"], indirect=True)


@by_library
def test_an_error_at_each_entry_point(laboratory, calls):
    each_in_turn(laboratory, one_of_each(calls), "error", ConnectionLostError, LOST)


@by_library
def test_a_lie_at_each_entry_point(laboratory, calls):
    each_in_turn(laboratory, one_of_each(calls), "lie", ANY_OF_THEM)


@by_library
@pytest.mark.parametrize("code", [BUSY, CONFIGURATION, MISSED])
def test_an_error_of_each_class_in_each_phase(laboratory, calls, code):
    each_in_turn(laboratory, one_of_each_phase(calls), "error", CLASS_OF[code], code)


@by_library
def test_a_death_in_each_phase(laboratory, calls):
    each_in_turn(laboratory, one_of_each_phase(calls), "death", ConnectionLostError)


@by_library
def test_a_hang_in_each_phase(laboratory, calls):
    hang_each(laboratory, one_of_each_phase(calls))


@over_grpc
@pytest.mark.parametrize("kind", ["death", "hang"])
def test_a_fault_at_the_first_and_last_call_over_grpc(laboratory, calls, kind):
    each_in_turn(laboratory, [calls[0], calls[-1]], kind, ConnectionLostError)


@pytest.mark.slow
def test_an_error_and_a_lie_at_each_call(laboratory, calls):
    each_in_turn(laboratory, calls, "error", ConnectionLostError, LOST)
    each_in_turn(laboratory, calls, "lie", ANY_OF_THEM)


@pytest.mark.slow
@pytest.mark.parametrize("code", [BUSY, CONFIGURATION, MISSED])
def test_an_error_of_each_class_at_each_call(laboratory, calls, code):
    each_in_turn(laboratory, calls, "error", CLASS_OF[code], code)


@pytest.mark.slow
def test_a_death_at_each_call(laboratory, calls):
    each_in_turn(laboratory, calls, "death", ConnectionLostError)


@pytest.mark.slow
def test_a_hang_at_each_call(laboratory, calls):
    hang_each(laboratory, calls)


def hang_each(laboratory, chosen):
    if laboratory.forwarder is not None:
        each_in_turn(laboratory, chosen, "hang", ConnectionLostError)
        return
    wrong = []
    for call in chosen:
        wrong += [
            f"hang at {call.name} while {call.phase}: {text}" for text in hung_and_killed(laboratory, call)
        ]
    assert not wrong, "\n".join(wrong)


def hung_and_killed(laboratory, call):
    """Hang a client in its own process, kill it, and return what the double recorded."""
    control = laboratory.brain.control
    control.clear_record()
    client = in_a_process(hang, laboratory.brain.wire, control.address, laboratory.parameters, call)
    happened(control.wait_until_hanging, f"{call.name} hung")
    client.kill()
    client.join()
    # The double learns of the death as NI's driver does, from the system: a moment later.
    happened(control.wait_until_no_tasks, "the double learned of the client's death")
    yield from left_wrongly(laboratory, call)
    yield from next_run_is_sound(laboratory, call)


def hang(wire, control, parameters, call):
    """Run the line in a child with a call that never returns."""
    from simulator.doubles.transports.control import DoublesControl

    with pytest.MonkeyPatch.context() as patch, DoublesControl(control) as connected:
        brain = RunningBrain(wire=wire, grpc="", control=connected, process=None)
        meet(brain, patch)
        laboratory = Laboratory(
            brain=brain, parameters=replace(parameters), forwarder=None, stack=ExitStack(), patch=patch
        )

        def before(phase):
            if phase == call.phase:
                connected.inject(call.name, "hang")

        line(laboratory, before)
