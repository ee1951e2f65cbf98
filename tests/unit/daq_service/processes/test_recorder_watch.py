"""Another process detects a recorder that fails repeatedly or does not run."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from support.invented_rows import set_row
from support.machine import clock_in_seconds
from support.new_experiment import add_events, new_catalogue

from daq_service.catalogue import SetCommit
from daq_service.catalogue.rows import AlarmRow, EventRow
from daq_service.processes.heartbeat import Beat, Stage
from daq_service.processes.recorder_state import RecorderStatus
from daq_service.processes.recorder_watch import MOST_INTERVALS, STARTING_S, RecorderWatch
from daq_service.settings.tree import Settings
from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S

INTERVAL_H, END_H = 0.5, 20.0
LOOK_EVERY_H = 0.05
SETTINGS = Settings(
    schedule={"phases": [{"until_h": END_H, "interval_h": INTERVAL_H}]}, clock={"kind": "wall"}
)


class Bench:
    """Test in real time whose recorder is as `recorder` states; hour 0 is the epoch of UTC."""

    def __init__(self, folder, monkeypatch):
        self.catalogue = new_catalogue(folder)
        self.hour, self.clock, self.n_sets, self.process = 0.0, "wall", 0, 1
        self.status: RecorderStatus = "running"
        self.stage: Stage = ""
        monkeypatch.setattr("daq_service.processes.recorder_watch.Freshness", lambda *_: self.fresh())
        self.watch = RecorderWatch(
            SETTINGS.schedule,
            SETTINGS.clock.kind,
            folder,
            lambda: self.catalogue,
            machine=clock_in_seconds(lambda: 3600.0 * self.hour),
        )

    def fresh(self):
        now_ns = round(self.hour * NS_PER_H)
        beat = Beat(process=self.process, mono_ns=now_ns, deadline_s=60.0, doing="waiting", stage=self.stage)
        recorder = SimpleNamespace(status=self.status, beat=beat, beat_age_s=0.0)
        return SimpleNamespace(
            recorder=recorder, clock=self.clock, epoch_utc_ns=0, now_utc_ns=now_ns, now_h=self.hour
        )

    def store(self):
        """Store the scheduled set that ended at this hour."""
        self.n_sets += 1
        row = set_row(self.n_sets, ended_utc_ns=round(self.hour * NS_PER_H), file=f"sets/{self.n_sets}")
        self.catalogue.commit_set(SetCommit(sets=[row]))

    def run(self, hours, *, restarts_every_h=1e9):
        """Advance the time; the recorder is another process after each restart."""
        end_h, restart_h = self.hour + hours, self.hour + restarts_every_h
        while self.hour < end_h:
            self.watch.check()
            self.hour += LOOK_EVERY_H
            if self.hour >= restart_h:
                self.process, restart_h = self.process + 1, restart_h + restarts_every_h
        self.watch.check()

    def alarms(self):
        """Return the kind of each event of the alarm, and its evidence."""
        rows = self.catalogue.rows(EventRow, topic="alarms")
        return [(row.kind, row.payload["message"].split(". ")[1].partition(" (")[0]) for row in rows]


@pytest.fixture
def bench(tmp_path, monkeypatch):
    made = Bench(tmp_path, monkeypatch)
    yield made
    made.catalogue.close()


RESTARTS, NO_SET = "3 restarts in 10 min", "No scheduled set stored for 2 intervals"


def test_three_restarts_in_ten_minutes_raise_one_alarm_until_a_stored_set(bench):
    bench.store()
    bench.run(0.3, restarts_every_h=LOOK_EVERY_H)
    assert bench.alarms() == [("alarm_raised", RESTARTS)]
    (row,) = bench.catalogue.rows(AlarmRow)
    assert (row.kind, row.alarm_class, row.priority) == ("recorder_not_running", "diagnostic", "high")
    assert row.message.startswith("Recorder not running, sets are missed. 3 restarts in 10 min (hour 0.2). ")
    assert row.message.endswith("Read `logs/`, then run `solimon run`.")
    bench.store()
    bench.run(0.1)
    assert [kind for kind, _ in bench.alarms()] == ["alarm_raised", "alarm_cleared"]


def test_rare_or_commanded_restarts_raise_no_alarm(bench):
    bench.store()
    bench.run(0.5, restarts_every_h=2.0 * LOOK_EVERY_H)
    bench.store()
    bench.stage = "ended"  # each of them ended in order
    bench.run(0.5, restarts_every_h=LOOK_EVERY_H)
    assert bench.alarms() == []


def test_a_recorder_that_fails_at_each_set_is_detected(bench):
    """The plug-in driver raises at the first shot of each set: one restart per interval."""
    bench.hour = 2.1
    bench.store()
    bench.run(2.0, restarts_every_h=INTERVAL_H)
    assert bench.alarms() == [("alarm_raised", NO_SET)]
    (row,) = bench.catalogue.rows(AlarmRow)
    assert row.raised_h == pytest.approx(2.1 + MOST_INTERVALS * INTERVAL_H, abs=2.0 * LOOK_EVERY_H)


@pytest.mark.parametrize("state", ["not_responding", "stopped", "not_started"])
def test_a_recorder_that_does_not_run_is_detected(bench, state):
    bench.hour = 2.1
    bench.store()
    bench.status = state
    bench.run(1.5)
    assert bench.alarms() == [("alarm_raised", NO_SET)]


def test_after_a_boot_the_recorder_has_time_to_start(bench):
    bench.hour = 0.1
    bench.store()
    bench.status, bench.hour = "not_responding", 9.0
    bench.watch = RecorderWatch(
        SETTINGS.schedule,
        SETTINGS.clock.kind,
        bench.watch._folder,
        lambda: bench.catalogue,
        machine=clock_in_seconds(lambda: 3600.0 * bench.hour),
    )
    bench.watch.check()
    assert bench.alarms() == []
    bench.hour += 1.01 * STARTING_S * NS_PER_S / NS_PER_H
    bench.watch.check()
    assert bench.alarms() == [("alarm_raised", NO_SET)]


def pause(bench):
    bench.catalogue.add_service_event(utc_ns=0, kind="pause", payload={"paused": "Ada: filling"})


def finish(bench):
    add_events(bench.catalogue, "schedule_done")
    bench.status = "finished"


def simulate(bench):
    bench.clock = "simulated"


def end(bench):
    bench.hour = END_H + 50.0


@pytest.mark.parametrize("change", [pause, finish, simulate, end])
def test_a_test_without_due_sets_raises_nothing(bench, change):
    bench.hour = 2.1
    bench.store()
    bench.status = "stopped"
    change(bench)
    bench.run(1.5)
    assert bench.alarms() == []


def test_a_waiting_recorder_raises_its_own_alarms(bench):
    bench.run(3.0)
    bench.status = "not_responding"
    bench.run(MOST_INTERVALS * INTERVAL_H - 0.1)
    assert bench.alarms() == []
    bench.run(0.2)
    assert bench.alarms() == [("alarm_raised", NO_SET)]
