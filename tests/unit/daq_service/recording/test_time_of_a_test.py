"""A test in real time on a computer whose clock is set, drifts, or starts in 2010."""

import threading
from itertools import pairwise

import pytest
from support.machine import NS_PER_H, NS_PER_S, Machine
from support.memory_line import SETS, KilledError, Line, healthy, memory_settings

from daq_service.clock import parse_utc, wall
from daq_service.errors import UsageError
from daq_service.processes.heartbeat import Heartbeat, read_heartbeat
from daq_service.recording.resumed_time import EARLIEST_UTC, compute_hour_0_ns, read_previous_time
from daq_service.recording.storage_alarms import OVERSLEPT
from hardware_drivers.measurement import ShotKey

IN_2010_NS = parse_utc("2010-01-01T00:00:00Z")
INTERVAL_H = 0.5
DOWN = "the recorder was down"


class Laboratory:
    """Line in memory on a machine's clock; each run is another process."""

    def __init__(self, line, machine):
        self.line, self.machine = line, machine
        self.clock = machine.clock()

    def run(self, *, cause=DOWN, stop=None):
        """Start a recorder as `session.record_test` does."""
        with self.line.catalogue(writer=True) as catalogue:
            self.line.epoch_ns(catalogue)
            before = read_previous_time(
                catalogue,
                read_heartbeat(self.line.folder),
                boot=self.machine.boot,
                elapsed_ns=self.machine.elapsed_ns,
                doubt_after_h=72.0,
            )
        clock = self.clock = self.machine.clock(before)
        self.line.heartbeat = Heartbeat(
            self.line.folder, deadline_s=60.0, machine=self.machine.machine_clock(), time_line=clock.line
        )
        self.machine.after(30.0, lambda: pytest.fail(f"still {self.doing}"))
        return self.line.run(cause=cause, clock=clock, stop=stop)

    def killed_after(self, hours):
        """Run a recorder that is killed after some hours."""

        def kill():
            raise KilledError

        self.machine.after(hours, kill)
        with pytest.raises(KilledError):
            self.run()

    def event_payloads(self, kind):
        """Return the payloads of the events of a kind, in order."""
        return [row.payload for row in self.line.rows("events") if row.kind == kind]

    @property
    def doing(self):
        beat = read_heartbeat(self.line.folder)
        return beat.doing


@pytest.fixture
def laboratory(tmp_path, monkeypatch):
    monkeypatch.setattr(wall, "IDLE_INTERVAL_S", 60.0)
    settings = memory_settings(clock={"kind": "wall"})
    line = Line(tmp_path, settings=settings)
    return Laboratory(line, Machine(parse_utc(settings.clock.epoch)))


def assert_every_set_once_in_order(laboratory, *, missed=()):
    """Check that each set has its rows once and started when due, or as late as given."""
    for position in "ABCD":
        rows = laboratory.line.rows("sets", position)
        assert [row.set_index for row in rows] == list(range(SETS))
        assert [row.set_index for row in rows if row.state != "done"] == list(missed)
        for row in rows:
            assert row.state in ("done", "missed")
            if row.state == "done":
                assert 0 <= row.started_utc_ns - row.due_utc_ns < INTERVAL_H * NS_PER_H
    shots = laboratory.line.rows("shots")
    assert [shot.sequence for shot in shots] == list(range(1, len(shots) + 1))
    assert [(shot.set_index, shot.utc_ns) for shot in shots] == sorted(
        (shot.set_index, shot.utc_ns) for shot in shots
    )
    events = laboratory.line.rows("events")
    assert all(before.utc_ns <= after.utc_ns for before, after in pairwise(events))


def assert_struck_at(laboratory, hours):
    """Check the elapsed time at the start of each set from the first one, which clock steps do not change."""
    first = {shot.set_index: shot for shot in reversed(laboratory.line.rows("shots"))}
    struck_h = [(first[index].mono_ns - first[min(first)].mono_ns) / NS_PER_H for index in sorted(first)]
    assert struck_h == pytest.approx(hours, abs=1e-6)  # the slewing of 6 h at most 1 s: none here


@pytest.mark.parametrize("by_h", [1.0, -1.0])
def test_a_step_moves_no_set_and_is_one_event(laboratory, by_h):
    laboratory.machine.after(2.2, lambda: laboratory.machine.set_clock(by_h))
    assert laboratory.run()
    assert_every_set_once_in_order(laboratory)
    assert_struck_at(laboratory, [INTERVAL_H * index for index in range(SETS)])
    (step,) = laboratory.event_payloads("clock_step")
    assert step["step_s"] == by_h * 3600.0
    assert step["system_utc_ns"] - step["experiment_utc_ns"] == by_h * NS_PER_H


@pytest.mark.parametrize("by_h", [1.0, -1.0, 400.0])
def test_a_step_while_no_recorder_ran_is_found_by_the_next_one(laboratory, by_h):
    laboratory.killed_after(2.2)
    laboratory.machine.sleep(600.0)
    laboratory.machine.set_clock(by_h)
    laboratory.killed_after(1.0)  # and not reported again by the next one
    assert laboratory.run()
    assert_every_set_once_in_order(laboratory)
    assert_struck_at(laboratory, [INTERVAL_H * index for index in range(SETS)])
    assert [step["step_s"] for step in laboratory.event_payloads("clock_step")] == [by_h * 3600.0]


def test_a_boot_in_2010_waits_for_a_set_clock_and_loses_nothing(laboratory):
    laboratory.killed_after(2.2)
    set_to_ns = laboratory.machine.utc_ns + 2 * 60 * NS_PER_S
    laboratory.machine.start_again(IN_2010_NS)
    waited = []

    def look():
        waited.append(laboratory.doing)
        assert [row.state for row in laboratory.line.alarms()] == ["unacknowledged"]
        laboratory.machine.utc_ns = set_to_ns

    laboratory.machine.after(1.0 / 60.0, look)
    assert laboratory.run()
    assert_every_set_once_in_order(laboratory)
    assert waited[0].startswith("waiting for a set clock: the computer clock is 2010-01-01T00:0")
    (alarm,) = laboratory.line.alarms()
    assert (alarm.kind, alarm.alarm_class, alarm.state) == (
        "clock_unverified",
        "diagnostic",
        "returned_unacknowledged",
    )
    assert "is before what was stored last (2024-01-01T0" in alarm.evidence["reason"]
    assert laboratory.event_payloads("clock_step") == []
    assert [payload["ahead_s"] for payload in laboratory.event_payloads("clock_believed")] == [0.0]


def test_sets_missed_with_an_unverified_clock_have_that_cause(laboratory):
    laboratory.killed_after(2.2)
    true_ns = laboratory.machine.utc_ns + NS_PER_H  # off for an hour: two sets
    laboratory.machine.start_again(IN_2010_NS)

    def set_right():
        laboratory.machine.utc_ns = true_ns + NS_PER_H

    laboratory.machine.after(1.0, set_right)  # an hour of waiting: two more
    assert laboratory.run()
    assert_every_set_once_in_order(laboratory, missed=[4, 5, 6])
    causes = [row.reason for row in laboratory.line.rows("sets", "B")][4:7]
    assert causes[:2] == [DOWN] * 2
    assert causes[2].startswith("the recorder waited for a set clock: the computer clock is 2010")


def test_100_h_later_an_unsynchronised_clock_is_doubted_until_it_is_synchronised(laboratory):
    laboratory.killed_after(2.2)
    laboratory.machine.start_again(laboratory.machine.utc_ns + 100 * NS_PER_H)
    rows_meanwhile = []

    def synchronise():
        rows_meanwhile.append(len(laboratory.line.rows("sets", "B")))
        laboratory.machine.set_clock(-99.9)  # it was wrong
        laboratory.machine.synchronised = True

    laboratory.machine.after(0.02, synchronise)
    assert laboratory.run()
    assert rows_meanwhile == [4], "no gap row while it is doubted"
    assert_every_set_once_in_order(laboratory)
    (alarm,) = laboratory.line.alarms()
    assert "100 h after what was stored last" in alarm.evidence["reason"]
    assert "clock.doubt_after_h = 72 h" in alarm.evidence["reason"]
    assert alarm.state == "returned_unacknowledged"


def test_a_person_may_trust_a_doubted_clock(laboratory):
    laboratory.line.listen_every_s = 0.0
    laboratory.killed_after(2.2)
    laboratory.machine.start_again(laboratory.machine.utc_ns + 100 * NS_PER_H)
    laboratory.machine.after(0.01, lambda: laboratory.line.order("trust_clock"))
    assert laboratory.run()
    assert_every_set_once_in_order(laboratory, missed=range(4, SETS))
    with laboratory.line.catalogue() as catalogue:
        order = catalogue.command(1)
    assert order.state == "done"
    assert order.result.startswith("the system's clock is trusted")
    assert [row.state for row in laboratory.line.alarms()] == ["returned_unacknowledged"]


def test_a_trusted_clock_before_the_last_row_continues_after_that_row(laboratory):
    laboratory.line.listen_every_s = 0.0
    laboratory.killed_after(2.2)
    laboratory.machine.start_again(IN_2010_NS)
    laboratory.machine.after(0.01, lambda: laboratory.line.order("trust_clock"))
    laboratory.killed_after(1.1)
    laboratory.machine.sleep(60.0)
    assert laboratory.run()
    assert_every_set_once_in_order(laboratory)
    assert laboratory.event_payloads("clock_step") == []
    (believed,) = laboratory.event_payloads("clock_believed")
    assert believed["ahead_s"] == pytest.approx(-14 * 365.25 * 86400, rel=0.01)


def test_a_recorder_killed_with_an_unverified_clock_stores_no_time(laboratory):
    laboratory.killed_after(2.2)
    true_ns = laboratory.machine.utc_ns
    laboratory.machine.start_again(IN_2010_NS)
    laboratory.killed_after(0.05)
    laboratory.machine.utc_ns = true_ns + 6 * 60 * NS_PER_S
    assert laboratory.run()
    assert_every_set_once_in_order(laboratory)
    assert laboratory.event_payloads("clock_step") == laboratory.event_payloads("clock_believed") == []
    assert [row.state for row in laboratory.line.alarms()] == ["returned_unacknowledged"]


def test_a_stop_while_the_clock_is_doubted_leaves_every_set_due(laboratory):
    laboratory.killed_after(2.2)
    true_ns = laboratory.machine.utc_ns
    laboratory.machine.start_again(true_ns + 100 * NS_PER_H)
    stop = threading.Event()
    laboratory.machine.after(0.02, stop.set)
    assert not laboratory.run(stop=stop)
    assert len(laboratory.line.rows("sets", "B")) == 4
    assert [row.state for row in laboratory.line.alarms()] == ["unacknowledged"]
    laboratory.machine.utc_ns = true_ns + 6 * 60 * NS_PER_S
    assert laboratory.run()
    assert_every_set_once_in_order(laboratory)


def test_sets_missed_during_sleep_have_that_cause(laboratory):
    laboratory.machine.after(2.2, lambda: laboratory.machine.sleep(1.2 * 3600.0))
    assert laboratory.run()
    assert_every_set_once_in_order(laboratory, missed=[4])
    assert laboratory.line.rows("sets", "B")[4].reason == OVERSLEPT
    assert laboratory.event_payloads("clock_step") == []


def test_a_clock_step_within_a_set_moves_no_strike(laboratory):
    key = ShotKey(position="C", set_index=3, shot_index=2)
    times_h = iter([1.0, -2.0, 400.0])

    def script(key_of_shot):
        if key_of_shot == key:
            laboratory.machine.set_clock(next(times_h, 0.0))
        return healthy(key_of_shot)

    laboratory.line.script = script
    assert laboratory.run()
    assert_every_set_once_in_order(laboratory)
    shots = [row for row in laboratory.line.rows("shots") if row.set_index == 3 and row.position != "A"]
    interval_ns = round(laboratory.line.settings.schedule.shot_interval_s * NS_PER_S)
    assert {b.mono_ns - a.mono_ns for a, b in pairwise(shots)} == {interval_ns}


def test_a_test_does_not_begin_on_a_clock_that_was_never_set():
    with pytest.raises(UsageError, match=r"the computer clock is 2010-01-01T00:00:00Z.*set it"):
        compute_hour_0_ns(IN_2010_NS)
    assert compute_hour_0_ns(parse_utc(EARLIEST_UTC)) == parse_utc(EARLIEST_UTC)
