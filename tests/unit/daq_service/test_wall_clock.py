"""Time of a real test: it follows the elapsed time and the drift, and no step moves it."""

import ctypes
import time
from itertools import pairwise

import pytest
from support.machine import NS_PER_H, NS_PER_S, Machine

from daq_service.clock import Before, MachineClock, TimeLine, WallClock, parse_utc
from daq_service.clock.machine import is_synchronised, select_elapsed_clock

NOW_NS = parse_utc("2026-06-01T12:00:00Z")


@pytest.fixture
def machine():
    return Machine(NOW_NS)


def always():
    return True


@pytest.mark.parametrize("by_h", [1.0, -1.0, 400.0, -140_000.0])
def test_a_clock_step_does_not_move_the_test_time_and_is_reported_once(machine, by_h):
    clock = machine.clock()
    assert clock.wait_until(NOW_NS + NS_PER_H, always)
    machine.set_clock(by_h)
    assert clock.wait_until(NOW_NS + 2 * NS_PER_H, always)
    assert clock.utc_ns() == NOW_NS + 2 * NS_PER_H
    assert machine.elapsed_ns == (500 + 7200) * NS_PER_S
    (step,) = clock.steps()
    assert (step.step_s, step.ahead_s, step.boot) == (by_h * 3600.0, by_h * 3600.0, "boot 1")
    assert step.system_utc_ns - step.experiment_utc_ns == by_h * NS_PER_H
    assert f"was set by {by_h * 3600.0:+.3f} s to " in step.message
    assert clock.steps() == []


def test_a_clock_that_is_stepped_there_and_back_is_followed_again(machine):
    clock = machine.clock()
    machine.set_clock(400.0)
    clock.wait_until(NOW_NS + 6 * NS_PER_S, always)
    machine.utc_ns -= 400 * NS_PER_H - 700_000_000  # back, with an offset of 0.7 s
    clock.wait_until(NOW_NS + NS_PER_H, always)
    ahead_s = [step.ahead_s for step in clock.steps()]
    assert ahead_s == [400 * 3600.0, 0.0]
    assert clock.utc_ns() == machine.utc_ns


def test_small_clock_steps_accumulate_to_a_reported_one(machine):
    clock = machine.clock()
    for _ in range(4):
        machine.utc_ns += 400_000_000
        machine.sleep(1.0)
        clock.utc_ns()
    (step,) = clock.steps()
    assert step.step_s == pytest.approx(1.2, abs=0.002)  # less what was followed, 500 ppm of 3 s


@pytest.mark.parametrize("drift_ppm", [100, -100, 499])
def test_a_drift_is_followed_over_350_h(drift_ppm):
    machine = Machine(NOW_NS, drift_ppm=drift_ppm)
    clock, before_ns = machine.clock(), NOW_NS
    for _ in range(350 * 60):
        machine.sleep(60.0)
        now_ns = clock.utc_ns()
        assert now_ns > before_ns
        before_ns = now_ns
    assert clock.steps() == []
    assert clock.utc_ns() == machine.utc_ns
    assert abs(machine.utc_ns - NOW_NS - 350 * NS_PER_H) > 100 * NS_PER_S


def test_time_is_never_set_back_by_following(machine):
    clock = machine.clock()
    machine.utc_ns -= 900_000_000
    times_ns = []
    for _ in range(2000):
        machine.sleep(1.0)
        times_ns.append(clock.utc_ns())
    slowest_ns = min(after - before for before, after in pairwise(times_ns))
    assert slowest_ns == 999_500_000
    assert times_ns[-1] == machine.utc_ns
    assert clock.steps() == []


def test_the_sleep_of_the_machine_is_time_that_passed(machine):
    clock = machine.clock()
    machine.sleep(8 * 3600.0)
    machine.utc_ns += 3 * NS_PER_S  # a coarse clock kept the time meanwhile
    assert clock.utc_ns() == machine.utc_ns
    assert clock.steps() == []


def test_two_looks_that_were_torn_apart_are_no_step(machine):
    slept_s = [0.0]

    def system_ns():
        utc_ns = machine.utc_ns
        machine.sleep(slept_s.pop() if slept_s else 0.0)
        return utc_ns

    clock = WallClock(machine=MachineClock(utc_ns=system_ns, elapsed_ns=lambda: machine.elapsed_ns))
    slept_s.append(0.0)
    clock.utc_ns()
    slept_s.append(3600.0)
    assert clock.utc_ns() == machine.utc_ns
    assert clock.steps() == []


def test_a_recorder_on_the_same_boot_takes_the_time_up(machine):
    first = machine.clock()
    machine.sleep(60.0)
    line = first.line()
    assert line is not None
    machine.sleep(3600.0)
    machine.set_clock(-5.0)
    second = machine.clock(Before(last_utc_ns=NOW_NS, line=line))
    assert second.utc_ns() == NOW_NS + 3660 * NS_PER_S
    assert [step.step_s for step in second.steps()] == [-5 * 3600.0]


def test_a_reported_clock_step_is_not_reported_again(machine):
    line = TimeLine(utc_ns=NOW_NS - NS_PER_H, elapsed_ns=machine.elapsed_ns, ahead_ns=NS_PER_H)
    clock = machine.clock(Before(last_utc_ns=0, line=line))
    assert clock.utc_ns() == NOW_NS - NS_PER_H
    assert clock.steps() == []


@pytest.mark.parametrize(
    ("gap_h", "synchronised", "doubted"),
    [
        (-1e-6, True, "is before what was stored last"),
        (0.0, False, ""),
        (72.0, False, ""),
        (
            73.0,
            False,
            "73 h after what was stored last (2026-06-01T12:00:00Z): more than clock.doubt_after_h = 72 h",
        ),
        (7300.0, True, ""),
    ],
)
def test_a_clock_is_unverified_after_a_long_reboot(gap_h, synchronised, doubted):
    reason = Before(last_utc_ns=NOW_NS).find_clock_doubt(
        NOW_NS + round(gap_h * NS_PER_H), synchronised=synchronised
    )
    assert bool(reason) == bool(doubted)
    assert doubted in reason


def test_time_stops_while_the_clock_is_unverified_and_continues_when_it_is_set(machine):
    machine.start_again(parse_utc("2010-01-01T00:00:00Z"))
    clock = machine.clock(Before(last_utc_ns=NOW_NS))
    observations = []

    def idle(reason):
        observations.append((clock.utc_ns(), clock.line(), reason))
        if len(observations) == 3:
            machine.utc_ns = NOW_NS + NS_PER_H
        return True

    believed = clock.wait_while_doubted(idle)
    assert (believed.ahead_s, believed.experiment_utc_ns) == (0.0, machine.utc_ns)
    assert [(now_ns, line) for now_ns, line, _ in observations] == [(NOW_NS, None)] * 3
    assert (
        "2010-01-01T00:00:00Z, which is before what was stored last (2026-06-01T12:00:00Z)"
        in observations[0][2]
    )
    assert clock.utc_ns() == machine.utc_ns
    assert clock.steps() == []
    assert clock.wait_while_doubted(idle) is None, "nothing is doubted any more"


def test_a_trusted_clock_never_goes_back_before_stored_times(machine):
    machine.start_again(parse_utc("2010-01-01T00:00:00Z"))
    clock = machine.clock(Before(last_utc_ns=NOW_NS))
    answer = clock.accept_system_clock()
    assert "2010-01-01T00:00:00.000Z; the test goes on at 2026-06-01T12:00:00.000Z" in answer
    machine.sleep(10.0)
    assert clock.utc_ns() == NOW_NS + 10 * NS_PER_S
    assert clock.steps() == [], "the step was told by the answer"
    with pytest.raises(ValueError, match="is believed already"):
        clock.accept_system_clock()


def test_a_wait_that_is_ended_leaves_the_doubt(machine):
    machine.start_again(NOW_NS - NS_PER_H)
    clock = machine.clock(Before(last_utc_ns=NOW_NS))
    assert clock.wait_while_doubted(lambda _: False) is None
    assert clock.line() is None


@pytest.mark.parametrize(
    ("platform", "name"), [("linux", "CLOCK_BOOTTIME"), ("darwin", "CLOCK_MONOTONIC_RAW")]
)
def test_the_clock_that_counts_sleep_is_read(platform, name, monkeypatch):
    monkeypatch.setattr(time, name, 77, raising=False)
    monkeypatch.setattr(time, "clock_gettime_ns", lambda clock_id: 1000 + clock_id, raising=False)
    assert select_elapsed_clock(platform)() == 1077
    monkeypatch.delattr(time, name)
    assert select_elapsed_clock(platform) is time.monotonic_ns
    assert select_elapsed_clock("win32") is time.monotonic_ns


@pytest.mark.parametrize(
    ("answer", "maxerror_us", "synchronised"),
    [(0, 1000, True), (5, 1000, True), (5, 16_000_000, False), (-1, 0, False)],
)
def test_on_linux_the_clock_error_is_queried(answer, maxerror_us, synchronised, monkeypatch):
    class Kernel:
        def __init__(self, name):
            pass

        def adjtimex(self, buffer):
            buffer._obj.maxerror = maxerror_us  # type: ignore[attr-defined] # what byref refers to
            return answer

    monkeypatch.setattr(ctypes, "CDLL", Kernel)
    assert is_synchronised("linux") is synchronised
    assert not is_synchronised("win32")
    monkeypatch.setattr(ctypes, "CDLL", lambda name: object())
    assert not is_synchronised("linux")
