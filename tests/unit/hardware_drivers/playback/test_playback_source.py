"""Shots are found by their key, unchanged, and loaded when they are asked for."""

import pytest
from support.archived_sets import SET_INDEX, make_echo, make_set, make_shot, other_set
from support.shots_in_memory import shots_in_memory

from hardware_drivers.errors import AcquisitionTimeoutError, ConfigurationError
from hardware_drivers.measurement import ShotKey
from hardware_drivers.playback.clock import RecordedClock
from hardware_drivers.playback.instruments import build_instruments
from hardware_drivers.playback.source import ShotsBySet, ShotSource, convert_stored_record
from simulator.clock import SimulatedClock

S = 1_000_000_000
START_NS = 1_704_067_200 * S


class Reader:
    """Reader of two recorded sets that logs which were read."""

    def __init__(self):
        self.asked = []

    def __call__(self, set_key):
        self.asked.append(set_key.set_index)
        if set_key.set_index >= SET_INDEX + 10:
            return ()
        return other_set(make_set(), set_key.set_index).records


def play(instruments, key):
    instruments.digitizer.arm(key)
    instruments.striker.strike(key)
    return instruments.digitizer.read(1.0)


def test_an_attempt_that_was_not_recorded_is_a_missed_strike_and_the_next_one_is_played():
    shot = make_shot("B", 1, 43, attempt=1)
    instruments = build_instruments(shots_in_memory([shot]))
    first = ShotKey(position="B", set_index=SET_INDEX, shot_index=1)
    with pytest.raises(
        AcquisitionTimeoutError, match="the recording has no attempt 0 at shot 1 of set 7 at 'B'"
    ):
        play(instruments, first)
    assert play(instruments, shot.key).waveform is shot.waveform


def test_the_recording_states_the_last_attempt():
    instruments = build_instruments(shots_in_memory([make_shot("B", 0, 1), make_shot("B", 1, 2, attempt=1)]))

    def key(shot_index, attempt):
        return ShotKey(position="B", set_index=SET_INDEX, shot_index=shot_index, attempt=attempt)

    assert play(instruments, key(0, 0)).last_attempt
    with pytest.raises(AcquisitionTimeoutError) as missed:
        play(instruments, key(1, 0))
    assert not missed.value.last_attempt
    assert play(instruments, key(1, 1)).last_attempt
    with pytest.raises(AcquisitionTimeoutError) as missed:
        play(instruments, key(2, 0))
    assert missed.value.last_attempt


def test_a_strike_elsewhere_or_a_second_one_plays_nothing_else():
    shots = [make_shot("B", 0, 1), make_shot("B", 1, 2), make_shot("C", 0, 3)]
    instruments = build_instruments(shots_in_memory(shots))
    instruments.digitizer.arm(shots[0].key)
    instruments.striker.strike(shots[2].key)
    with pytest.raises(AcquisitionTimeoutError, match="no strike at 'B'"):
        instruments.digitizer.read(1.0)
    instruments.digitizer.arm(shots[0].key)
    instruments.striker.strike(shots[0].key)
    instruments.striker.strike(shots[1].key)
    assert instruments.digitizer.read(1.0).waveform is shots[0].waveform


def test_the_strike_selects_the_shot():
    shots = [make_shot("B", 0, 1), make_shot("B", 1, 2)]
    instruments = build_instruments(shots_in_memory(shots))
    instruments.digitizer.arm(shots[0].key)
    instruments.striker.strike(shots[1].key)
    assert instruments.digitizer.read(1.0).waveform is shots[1].waveform


def test_wanted_positions_are_looked_for_at_once_by_name_and_method():
    source = shots_in_memory([make_shot("B", 0, 1), make_shot("C", 0, 2), make_echo(40)])
    assert isinstance(source, ShotSource)
    build_instruments(source, wanted={"A": "pulse_echo", "B": "solitary_wave"})
    with pytest.raises(ConfigurationError, match="no solitary_wave position 'D'; it has: B, C; take"):
        build_instruments(source, wanted={"D": "solitary_wave"})
    with pytest.raises(ConfigurationError, match="no pulse_echo position 'B'; it has: A; take"):
        build_instruments(source, wanted={"B": "pulse_echo"})
    with pytest.raises(ConfigurationError, match="no pulse_echo position 'A'; it has: none"):
        build_instruments(shots_in_memory([]), wanted={"A": "pulse_echo"})


def test_a_shot_in_place_of_an_echo_is_reported():
    shot = make_shot("A", 0, 1)
    source = ShotsBySet({"A": "pulse_echo"}, lambda set_index: [shot])
    with pytest.raises(ConfigurationError, match="has a Acquired at the pulse_echo position 'A'"):
        build_instruments(source).pulse_echo.acquire(shot.key, 1.0)


def test_sets_are_read_when_asked_for_and_few_are_kept():
    reader = Reader()
    source = ShotsBySet({"A": "pulse_echo", "B": "solitary_wave", "C": "solitary_wave"}, reader)
    assert reader.asked == []

    def ask(set_index):
        key = ShotKey(position="B", set_index=set_index, shot_index=0)
        found = source.find(key)
        assert found is not None
        wanted = other_set(make_set(), set_index).shots[0]
        assert found.waveform.counts.tobytes() == wanted.waveform.counts.tobytes()

    for set_index in (7, 7, 8, 7, 9, 7, 8):
        ask(set_index)
    # Set 8 was the one asked for least lately when set 9 came, and was read again.
    assert reader.asked == [7, 8, 9, 8]


def test_a_set_that_was_not_recorded_has_no_shots_and_is_read_once():
    reader = Reader()
    source = ShotsBySet({"B": "solitary_wave"}, reader)
    for shot_index in range(3):
        assert source.find(ShotKey(position="B", set_index=99, shot_index=shot_index)) is None
    assert reader.asked == [99]


def test_settings_of_a_record_pass():
    shot = make_shot("B", 0, 1)
    assert convert_stored_record(shot).settings is shot.settings


# Clock ---------------------------------------------------------------------------------------------


def recorded_clock(*moments_s, tolerance_s=2.0):
    moments = [START_NS + round(moment * S) for moment in moments_s]
    return RecordedClock(
        SimulatedClock(START_NS),
        lambda after: next((moment for moment in moments if moment > after), None),
        tolerance_s=tolerance_s,
    )


def times_s(clock, *targets_s):
    found = []
    for target in targets_s:
        assert clock.wait_until(START_NS + round(target * S), lambda: True)
        found.append((clock.utc_ns() - START_NS) / S)
    return found


def test_each_planned_time_meets_its_recorded_moment():
    # Start of a set, its echo, three strikes: each a little late, as on a wall clock.
    clock = recorded_clock(10.001, 10.002, 10.101, 14.003, 18.002)
    assert times_s(clock, 10.0, 10.001, 10.001, 14.001, 18.001) == [10.001, 10.002, 10.101, 14.003, 18.002]


def test_a_time_equal_to_the_scheduled_time_is_matched():
    assert times_s(recorded_clock(10.0, 10.1), 10.0, 10.0) == [10.0, 10.1]


def test_a_missed_strike_does_not_borrow_the_time_of_the_next():
    clock = recorded_clock(10.001, 18.002)
    assert times_s(clock, 10.0, 14.0, 18.0) == [10.001, 14.0, 18.002]


def test_a_strike_late_after_a_timeout_has_its_own_time():
    # The strike due at 14 s timed out at 19 s; that of 18 s was late, that of 22 s was not.
    clock = recorded_clock(10.0, 19.1, 22.1)
    assert times_s(clock, 10.0, 14.0, 18.0, 22.0) == [10.0, 14.0, 19.1, 22.1]


def test_a_recording_without_times_runs_on_the_planned_ones():
    assert times_s(recorded_clock(), 10.0, 14.0) == [10.0, 14.0]


def test_a_negative_tolerance_is_refused():
    with pytest.raises(ValueError, match="tolerance_s is -1"):
        recorded_clock(tolerance_s=-1.0)
