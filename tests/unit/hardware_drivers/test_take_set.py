"""Order of the strikes of a set, effects of faults, and agreement with the plan."""

from itertools import count, islice

import numpy as np
import pytest

from daq_service.acquisition.strikes_ahead import build_strike_predictor
from hardware_drivers.errors import (
    AcquisitionTimeoutError,
    ConfigurationError,
    ConnectionLostError,
    InstrumentError,
)
from hardware_drivers.instruments import Acquired, Echo, Rig
from hardware_drivers.measurement import Calibration, DueSet, MissedShot, ShotKey, Waveform
from hardware_drivers.take_set import SetPlan, take_set

NS_PER_S = 1_000_000_000
INTERVAL_S = 2.5
SETS = [DueSet(set_index=k, due_h=0.5 + k, due_utc_ns=(1_800 + 3_600 * k) * NS_PER_S) for k in range(4)]


class Clock:
    """Simulated time."""

    def __init__(self):
        self.now_ns = 0

    def utc_ns(self):
        return self.now_ns

    mono_ns = utc_ns

    def wait_until(self, utc_ns, idle):
        self.now_ns = max(self.now_ns, utc_ns)
        return idle()


class RecordingInstruments:
    """Striker and digitizer double that records each strike and returns no data."""

    def __init__(self, clock):
        self.clock = clock
        self.strikes = []

    def arm(self, key):
        self.armed = key

    def strike(self, key):
        assert key == self.armed
        self.strikes.append((key, self.clock.utc_ns()))

    def read(self, timeout_s):
        raise AcquisitionTimeoutError("nothing came")

    def disarm(self):
        self.armed = None

    def make_safe(self):
        self.armed = None


def strikes_of_all_sets(positions, shots_per_set, now_ns=0):
    """Return the strikes that `take_set` makes in every set."""
    clock = Clock()
    clock.now_ns = now_ns
    deaf = RecordingInstruments(clock)
    rig = Rig(kind="simulated", clock=clock, striker=deaf, digitizer=deaf)
    for due in SETS:
        plan = SetPlan(
            due=due,
            positions=dict.fromkeys(positions, "solitary_wave"),
            shots_per_set=shots_per_set,
            shot_interval_s=INTERVAL_S,
            read_timeout_s=1.0,
        )
        list(take_set(rig, plan, first_sequence=1, boot_id="test", idle=lambda: True))
    return deaf.strikes


def planned(positions, shots_per_set):
    return build_strike_predictor(SETS, positions, shots_per_set=shots_per_set, shot_interval_s=INTERVAL_S)


@pytest.mark.parametrize("number", [0, 3, 4, 12, 31])
def test_the_plan_is_what_take_set_strikes(number):
    strikes = strikes_of_all_sets(("B", "C"), 4)
    assert len(strikes) == len(SETS) * 2 * 4
    assert list(planned(("B", "C"), 4)(*strikes[number])) == strikes[number + 1 :]


def test_a_late_set_is_struck_at_the_same_intervals():
    late_ns = SETS[0].due_utc_ns + 600 * NS_PER_S
    times = [at_ns for _, at_ns in strikes_of_all_sets(("B",), 4, late_ns)[:4]]
    assert np.diff([late_ns, *times]).tolist() == [0, *[round(INTERVAL_S * NS_PER_S)] * 3]


def test_a_shot_outside_the_schedule_is_followed_by_nothing():
    plan = planned(("B",), 4)
    assert list(plan(ShotKey(position="X", set_index=0, shot_index=0), 0)) == []
    assert list(plan(ShotKey(position="B", set_index=0, shot_index=4), 0)) == []


def test_a_repetition_is_followed_by_what_its_first_attempt_is_followed_by():
    plan = planned(("B", "C"), 4)
    first = ShotKey(position="B", set_index=1, shot_index=2)
    again = ShotKey(position="B", set_index=1, shot_index=2, attempt=1)
    later_ns = 1_000 * NS_PER_S
    keys = [key for key, _ in plan(first, later_ns)]
    assert [key for key, _ in plan(again, later_ns)] == keys
    # One interval after the repetition, not after the first attempt.
    assert next(islice(plan(again, later_ns), 1))[1] == later_ns + round(INTERVAL_S * NS_PER_S)


class ScriptedInstruments(RecordingInstruments):
    """Instrument double whose reads follow a list of records and errors."""

    def __init__(self, clock, answers):
        super().__init__(clock)
        self.answers = iter(answers)
        self.calls = []

    def _answer(self):
        answer = next(self.answers, ACQUIRED)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def read(self, timeout_s):
        self.calls.append("read")
        return self._answer()

    def acquire(self, key, timeout_s):
        self.calls.append(f"echo {key.position}")
        answer = self._answer()
        return Echo(waveform=answer.waveform, gain_db=0.0, offset_v=0.0, averages=1)

    def make_safe(self):
        self.calls.append("safe")


ACQUIRED = Acquired(
    waveform=Waveform(
        counts=np.zeros(4, dtype=np.int16),
        sample_rate_hz=1e7,
        pretrigger_samples=1,
        calibration=Calibration(coefficients_v=np.array([0.0, 1e-3]), resolution_bits=16, range_v=5.0),
    )
)
SILENCE = AcquisitionTimeoutError("nothing came")
LOST = ConnectionLostError("the chassis is gone")


def take(answers, positions=None, shots_per_set=2, **hooks):
    """Return the measurements of one set, the error that ended it, and the instruments."""
    clock = Clock()
    instruments = ScriptedInstruments(clock, answers)
    rig = Rig(
        kind="simulated", clock=clock, striker=instruments, digitizer=instruments, pulse_echo=instruments
    )
    plan = SetPlan(
        due=SETS[0],
        positions=positions or {"B": "solitary_wave", "A": "pulse_echo", "C": "solitary_wave"},
        shots_per_set=shots_per_set,
        shot_interval_s=INTERVAL_S,
        read_timeout_s=1.0,
    )
    found, error = [], None
    try:
        for measurement in take_set(
            rig, plan, first_sequence=7, boot_id="test", **{"idle": lambda: True, **hooks}
        ):
            found.append(measurement)
    except InstrumentError as raised:
        error = raised
    return found, error, instruments


def test_echoes_are_taken_before_the_transducers_in_order():
    found, _, _ = take([])
    assert [(item.key.position, item.key.shot_index) for item in found] == [
        ("A", 0),
        ("B", 0),
        ("B", 1),
        ("C", 0),
        ("C", 1),
    ]
    assert [item.sequence for item in found] == [7, 8, 9, 10, 11]
    strikes_s = [(item.stamp.utc_ns - SETS[0].due_utc_ns) / NS_PER_S for item in found[1:]]
    assert strikes_s == [0.0, INTERVAL_S, 2 * INTERVAL_S, 3 * INTERVAL_S]


def test_a_strike_without_a_trigger_is_missed_and_leaves_the_coil_safe():
    found, error, instruments = take([ACQUIRED, SILENCE])
    assert error is None
    assert isinstance(found[1], MissedShot)
    assert (found[1].reason, found[1].cause) == ("no_trigger", "nothing came")
    assert instruments.calls[:3] == ["echo A", "read", "safe"]
    assert [item.sequence for item in found if not isinstance(item, MissedShot)] == [7, 8, 9, 10]


def test_a_lost_connection_in_three_consecutive_records_ends_the_set():
    found, error, _ = take([ACQUIRED, LOST, LOST, ACQUIRED, LOST, LOST, LOST], shots_per_set=4)
    assert error is LOST
    reasons = [item.reason if isinstance(item, MissedShot) else "" for item in found]
    assert reasons == ["", *["connection_lost"] * 2, "", *["connection_lost"] * 3]


def test_a_permanent_error_ends_the_set_immediately_and_safely():
    wrong = ConfigurationError("no such channel")
    found, error, instruments = take([ACQUIRED, ACQUIRED, wrong])
    assert error is wrong
    assert len(found) == 2
    assert instruments.calls[-1] == "safe"


def test_a_wanted_repetition_takes_the_next_slot_and_counts_its_attempt():
    found, _, _ = take([], {"B": "solitary_wave"}, wants_restrike=lambda shot: shot.key.attempt < 2)
    assert [(item.key.shot_index, item.key.attempt) for item in found] == [
        (0, 0),
        (0, 1),
        (0, 2),
        (1, 0),
        (1, 1),
        (1, 2),
    ]
    assert found[-1].stamp.utc_ns - found[0].stamp.utc_ns == round(5 * INTERVAL_S * NS_PER_S)


def test_no_repetition_is_requested_after_a_lost_connection():
    requested_shots = []
    take(
        [ACQUIRED, LOST],
        {"A": "pulse_echo", "B": "solitary_wave"},
        wants_restrike=requested_shots.append,
    )
    assert [shot.key.shot_index for shot in requested_shots] == [1]


def test_a_transducer_disabled_by_a_command_is_not_struck_again():
    allowed = {"B", "C"}
    found, _, _ = take(
        [], wants_restrike=lambda shot: allowed.discard("B"), may_strike=lambda position: position in allowed
    )
    assert [item.key.position for item in found] == ["A", "B", "C", "C"]


def test_a_pending_strike_is_dropped_when_its_transducer_is_disabled():
    allowed, polls = {"B", "C"}, count()

    def idle():
        if next(polls) == 2:  # A's echo, B's first strike, and now its second one waits
            allowed.discard("B")
        return True

    found, _, _ = take([], idle=idle, may_strike=lambda position: position in allowed)
    assert [item.key.position for item in found] == ["A", "B", "C", "C"]


def test_the_set_ends_when_idle_returns_false():
    answers = iter([True, True, True, False])
    found, error, _ = take([], idle=lambda: next(answers))
    assert error is None
    assert [item.key.position for item in found] == ["A", "B", "B"]
