"""Execution of commands by the recorder: done or rejected, one at a time."""

import threading
from types import SimpleNamespace
from typing import Any, cast

import pytest
from support.filled_folder import frozen_baseline
from support.invented_rows import condition
from support.new_experiment import new_catalogue

from daq_service.alarms.states import Moment
from daq_service.alarms.transitions import build_transition
from daq_service.archive import FolderArchive
from daq_service.catalogue import SetCommit
from daq_service.catalogue.errors import CatalogueBusyError, CatalogueWriteError
from daq_service.catalogue.rows import AlarmRow, AnnotationRow, BaselineRow, EventRow
from daq_service.clock import WallClock
from daq_service.commands.execution import CommandExecutor
from daq_service.commands.running_test import RunningTest
from daq_service.recording.set_assessor import SetAssessor
from daq_service.settings.tree import Settings
from hardware_drivers.instruments import Rig
from hardware_drivers.measurement import DueSet
from hardware_drivers.nanoseconds import NS_PER_H
from simulator.clock import SimulatedClock

HOUR = 3.5


class SupplyDouble:
    """Corrosion supply double that records its commands and rejects more than 10 V."""

    def __init__(self):
        self.done: list[tuple[Any, ...]] = []

    def supply_on(self, author, hour, *, voltage_v, current_limit_a):
        if voltage_v is not None and voltage_v > 10.0:
            raise ValueError("beyond the cap")
        self.done.append(("on", author, hour, voltage_v, current_limit_a))
        return "the supply is on"

    def supply_off(self, author, hour):
        self.done.append(("off", author, hour))
        return "the supply is off"


class Bench:
    """Running test without its line: set assessor, catalogue and listener on a manual clock."""

    def __init__(self, folder, clock, switch):
        self.folder, self.clock, self.switch = folder, clock, switch
        self.catalogue = new_catalogue(folder)
        self.stop, self.left_s = threading.Event(), 60.0
        self.next_set = 10
        self.restart()

    def confirmation(self, position, author, reason):
        """Return what the recorder would store if the set assessor allows it."""
        after = DueSet(set_index=0, due_h=0.5, due_utc_ns=round(0.5 * NS_PER_H))
        moment = Moment(utc_ns=self.clock.utc_ns(), due_h=HOUR, set_index=None)
        return self.ledger.order_confirmation(after, position, author, reason, moment)

    def restart(self, *, begin=True):
        """Open the folder as a new recorder process does."""
        rig = cast(Rig, SimpleNamespace(dry_run=False, supply=None, climate=None))
        self.ledger = SetAssessor(Settings(), FolderArchive(self.folder), self.catalogue, rig)
        test = RunningTest(
            clock=self.clock,
            moment=lambda: Moment(utc_ns=self.clock.utc_ns(), due_h=HOUR, set_index=None),
            stop=self.stop,
            alarms=self.ledger.alarms,
            annotations=lambda: self.catalogue.rows(AnnotationRow),
            store=self.ledger.commit,
            enabled=self.ledger.assessors.enable,
            confirmation=self.confirmation,
            settings=Settings(),
            next_set=lambda: self.next_set,
            baseline=self.catalogue.baseline,
            renewed=self.ledger.assessors.discard_state,
            positions=("B", "C", "D"),
            supply=self.switch,
        )
        self.listener = CommandExecutor(self.catalogue, test, left_s=lambda row: self.left_s)
        if begin:
            self.listener.close_earlier_commands()

    def write(self, kind, **arguments):
        return self.catalogue.add_command("ann", kind, arguments)

    def answer(self, order_id):
        row = self.catalogue.command(order_id)
        return row.state, row.result

    def execute(self, kind, **arguments):
        order_id = self.write(kind, **arguments)
        self.listener.execute_open_commands()
        return self.answer(order_id)

    def alarm(self, position):
        (row,) = self.catalogue.rows(AlarmRow, position=position, active=True)
        return row.id, row.state


@pytest.fixture
def bench(tmp_path):
    bench = Bench(tmp_path, SimulatedClock(0, pace_h_per_s=1.0), SupplyDouble())
    yield bench
    bench.catalogue.close()


@pytest.fixture
def bare(tmp_path):
    """Return a bench on the wall clock without a supply."""
    bench = Bench(tmp_path, WallClock(), None)
    yield bench
    bench.catalogue.close()


def test_finish_now_ends_the_pacing(bench):
    assert bench.execute("finish_now") == ("done", "no pacing from here on")
    # A paced clock would ask whether to go on, and sleep for years.
    assert not bench.clock.wait_until(10**18, lambda: False)
    assert bench.clock.utc_ns() == 10**18


def baselines(bench):
    return [
        (row.name, row.state, row.first_set_index, row.last_set_index)
        for row in bench.catalogue.rows(BaselineRow)
    ]


def test_a_baseline_is_approved_once_and_retired_with_author_time_and_reason(bench):
    proposed = frozen_baseline("B", state="proposed", approval="by_a_person", id=2)
    bench.catalogue.commit_set(SetCommit(baselines=[proposed]))
    assert bench.execute("approve_baseline", position="B") == ("done", "B-baseline-1 is approved")
    (row,) = bench.catalogue.rows(BaselineRow)
    assert (row.state, row.approval, row.approved_utc_ns) == ("approved", "ann", bench.clock.utc_ns())
    assert (row.mean, row.limits) == (proposed.mean, proposed.limits), "only its life goes on"
    again = bench.execute("approve_baseline", position="B")
    assert again == ("rejected", "the baseline of B is approved: there is nothing to sign")
    result = (
        "B-baseline-1 is retired; B-baseline-2 collects sets 10 to 57, and no set of B is assessed until then"
    )
    assert bench.execute("renew_baseline", position="B", note=" coupled anew ") == ("done", result)
    assert baselines(bench) == [("B-baseline-1", "retired", 0, 47), ("B-baseline-2", "collecting", 10, 57)]
    first, second = bench.catalogue.rows(BaselineRow)
    assert (first.retired_by, first.retired_reason) == ("ann", "coupled anew")
    assert (first.retired_utc_ns, second.created_utc_ns) == (bench.clock.utc_ns(),) * 2
    kinds = [event.kind for event in bench.catalogue.rows(EventRow, topic="assessments")]
    assert kinds == ["baseline_approved", "baseline_retired", "baseline_collecting"]


def test_a_baseline_is_renewed_only_with_a_reason_and_with_sets_left(bench):
    state, answer = bench.execute("renew_baseline", position="B", note=" ")
    assert (state, "give the reason for retiring the baseline" in answer) == ("rejected", True)
    bench.next_set = 378
    state, answer = bench.execute("renew_baseline", position="B", note="a new sensor")
    expected = "the plan has 47 sets left, another baseline takes 48 (baseline.hours), as the first one: "
    assert (state, answer.startswith(expected), "schedule.end_h" in answer) == ("rejected", True, True), (
        answer
    )
    bench.next_set = 377
    assert bench.execute("renew_baseline", position="B", note="a new sensor")[0] == "done"
    # It was still being recorded: its history has no gap.
    assert baselines(bench) == [("B-baseline-1", "retired", 0, 47), ("B-baseline-2", "collecting", 377, 424)]


def test_a_retired_baseline_resets_its_change_alarms_with_the_same_author(bench):
    """The condition has not returned to normal: the reference of the assessment is retired."""
    moment = Moment(utc_ns=0, due_h=HOUR, set_index=7)
    for position, kind in [("B", "wall_change"), ("B", "not_assessed"), ("C", "wall_change")]:
        bench.ledger.update_alarm(condition(position=position, kind=kind), moment)
    seen = bench.catalogue.add_command("bob", "acknowledge_alarm", {"alarm_id": 2, "note": "a worn sensor"})
    bench.listener.execute_open_commands()
    assert bench.answer(seen)[0] == "done"
    assert bench.execute("renew_baseline", position="B", note="coupled anew")[0] == "done"
    assert [row.state for row in bench.catalogue.rows(AlarmRow)] == ["normal", "normal", "unacknowledged"]
    ended = bench.catalogue.rows(EventRow, topic="alarms")[-2:]
    reason = "its baseline was retired: coupled anew"
    for change in map(build_transition, ended):
        assert (change["kind"], change["author"], change["reason"]) == ("alarm_reset", "ann", reason)
    assert [event.payload["acknowledged_by"] for event in ended] == ["ann", "bob"], "who saw it first"
    bench.restart()
    assert bench.ledger.alarms[("B", "wall_change")].state == "normal"


def test_stop_sets_the_recorders_stop(bench):
    assert bench.execute("stop") == ("done", "stopping after the shot being taken")
    assert bench.stop.is_set()


def test_a_command_without_a_stored_result_is_executed_once(bench, monkeypatch):
    """The interlock may have tripped meanwhile: a repetition would switch the supply on again."""
    order_id = bench.write("supply_on")

    def refused(*answer):
        raise CatalogueBusyError("database is locked")

    with monkeypatch.context() as locked:
        locked.setattr(bench.catalogue, "finish_command", refused)
        for _ in range(2):
            with pytest.raises(CatalogueBusyError):
                bench.listener.execute_open_commands()
    bench.listener.execute_open_commands()
    assert bench.answer(order_id) == ("done", "the supply is on")
    assert [what for what, *_ in bench.switch.done] == ["on"]


def test_the_rows_of_a_command_are_stored_with_its_result(bench, monkeypatch):
    """A process that is killed after the command has stored its result."""
    orders = [
        bench.write("annotate", from_h=1.0, text="couplant renewed"),
        bench.write("pause", note="door open"),
        bench.write("disable", position="C"),
    ]

    def killed(*answer):
        raise AssertionError(f"a commit of its own for {answer}")

    monkeypatch.setattr(bench.catalogue, "finish_command", killed)
    bench.listener.execute_open_commands()
    assert [bench.answer(order_id)[0] for order_id in orders] == ["done"] * 3
    assert bench.listener.paused == "paused by ann: door open"


def test_a_command_past_its_deadline_expires_and_is_not_executed(bench):
    bench.left_s = 0.0
    state, message = bench.execute("supply_on")
    assert (state, message.split(":")[0]) == ("expired", "not executed")
    assert bench.switch.done == []


def test_a_command_marked_after_its_deadline_expires(bench, monkeypatch):
    """A client that read it as pending at its deadline got the result that it is not executed."""
    start = bench.catalogue.start_command

    def slow_disk(order_id):
        start(order_id)
        bench.left_s = 0.0

    monkeypatch.setattr(bench.catalogue, "start_command", slow_disk)
    assert bench.execute("supply_on")[0] == "expired"
    assert bench.switch.done == []


@pytest.mark.parametrize("begin", [True, False], ids=["at the start", "at the first look"])
def test_an_open_command_of_an_earlier_recorder_is_closed_and_never_executed(bench, begin):
    started, waiting = bench.write("supply_on"), bench.write("resume")
    rows_only = bench.write("pause", note="why")
    for order_id in (started, rows_only):
        bench.catalogue.start_command(order_id)  # ... and killed
    bench.restart(begin=begin)
    if not begin:  # the disk did not take it
        bench.listener.execute_open_commands()
    assert bench.answer(started) == (
        "failed",
        "the recorder ended while executing it; check the result before you send it again",
    )
    for order_id in (waiting, rows_only):
        state, message = bench.answer(order_id)
        assert (state, "it was sent before this recorder started" in message) == ("expired", True)
    assert bench.listener.paused == "", "what it would have stored is not there"
    assert bench.switch.done == []
    assert bench.execute("supply_on") == ("done", "the supply is on")


def test_a_command_is_marked_before_its_execution(bench, monkeypatch):
    found = []
    supply_on = bench.switch.supply_on

    def seen(*author, **set_to):
        found.append(bench.answer(1)[0])
        return supply_on(*author, **set_to)

    monkeypatch.setattr(bench.switch, "supply_on", seen)
    assert bench.execute("supply_on")[0] == "done"
    assert found == ["started"]


def test_without_a_mark_only_repeatable_commands_are_executed(bench, monkeypatch):
    def refused(order_id):
        raise CatalogueWriteError("the disk is full")

    monkeypatch.setattr(bench.catalogue, "start_command", refused)
    assert bench.execute("supply_off")[0] == "done"
    bench.write("supply_on")
    with pytest.raises(CatalogueWriteError):
        bench.listener.execute_open_commands()
    assert [what for what, *_ in bench.switch.done] == ["off"]


def test_a_command_that_is_open_at_the_end_expires(bench):
    order_id = bench.write("pause", note="why")
    bench.listener.close("the recorder has ended")
    state, message = bench.answer(order_id)
    assert (state, "the recorder has ended" in message) == ("expired", True)
    bench.restart()
    assert bench.listener.paused == ""


def test_the_recorder_ends_an_expired_shelf_without_a_new_set(bench):
    bench.execute("disable", position="C", note="coil is hot")
    (alarm_id,) = (row.id for row in bench.catalogue.rows(AlarmRow))
    assert alarm_id is not None
    done = bench.execute("shelve_alarm", alarm_id=alarm_id, for_h=8.0, reason="a new coil is on its way")
    assert done == ("done", "shelve alarm")
    again = bench.execute("shelve_alarm", alarm_id=99, for_h=8.0, reason="which?")
    assert again == ("rejected", "there is no alarm 99")
    for hour, suppressed in [(7.9, "shelved"), (8.1, None)]:
        now_ns = bench.clock.utc_ns() + round(hour * NS_PER_H)
        bench.ledger.update_alarms_by_time(Moment(utc_ns=now_ns, due_h=HOUR + hour, set_index=None))
        (row,) = bench.catalogue.rows(AlarmRow)
        assert (row.suppressed, row.state) == (suppressed, "unacknowledged")
    assert bench.catalogue.rows(EventRow)[-1].kind == "alarm_shelf_expired"
    assert bench.ledger.disabled().keys() == {"C"}, "a shelf strikes nobody's transducer"


def test_a_pause_has_one_reason_and_survives_a_restart(bench):
    done = "paused: nothing strikes until the test is resumed; due sets are missed"
    assert bench.execute("pause", note="door open") == ("done", done)
    assert bench.listener.paused == "paused by ann: door open"
    already = "the test is already paused by ann: door open"
    assert bench.execute("pause", note="why") == ("rejected", already)
    bench.restart()
    assert bench.listener.paused == "paused by ann: door open"
    assert bench.execute("resume", note="shut") == ("done", "resumed: the next due set is taken")
    assert bench.listener.paused == ""
    bench.restart()
    assert bench.listener.paused == ""


def test_pending_commands_are_executed_in_order(bench):
    orders = [
        *(bench.write("pause", note="why") for _ in range(2)),
        *(bench.write("resume") for _ in range(2)),
    ]
    bench.listener.execute_open_commands()
    assert [bench.answer(order)[0] for order in orders] == ["done", "rejected", "done", "rejected"]
    assert bench.listener.paused == ""


def test_a_transducer_is_disabled_and_enabled(bench):
    assert bench.execute("disable", position="B", note="coil is hot") == ("done", "B is disabled")
    assert bench.ledger.disabled() == {
        "B": "B: transducer disabled, wall not monitored. By ann: coil is hot (hour 3.5). "
        "Fix the stated cause, then run `solimon enable`."
    }
    (event,) = bench.catalogue.read_events_after(0, {"alarms"})
    assert (event.kind, event.payload["evidence"]) == (
        "alarm_raised",
        {"command_id": 1, "author": "ann", "note": "coil is hot"},
    )
    assert event.payload["raised_h"] == HOUR
    assert bench.execute("strike", position="B") == ("rejected", "B is disabled")
    bench.restart()
    assert bench.ledger.disabled() == {
        "B": "B: transducer disabled, wall not monitored. By ann: coil is hot (hour 3.5). "
        "Fix the stated cause, then run `solimon enable`."
    }
    assert bench.execute("enable", position="B") == ("done", "B strikes again from the next set")
    assert bench.ledger.disabled() == {}
    bench.execute("disable", position="C")
    assert bench.ledger.disabled() == {
        "C": "C: transducer disabled, wall not monitored. By ann: no reason given (hour 3.5). "
        "Fix the stated cause, then run `solimon enable`."
    }


def test_an_alarm_is_acknowledged_once(bench):
    bench.execute("disable", position="D")
    alarm_id, state = bench.alarm("D")
    assert state == "unacknowledged"
    assert bench.execute("acknowledge_alarm", alarm_id=alarm_id, note="seen") == ("done", "acknowledged")
    assert bench.alarm("D") == (alarm_id, "acknowledged")
    again = f"alarm {alarm_id} is acknowledged: there is nothing to acknowledge"
    assert bench.execute("acknowledge_alarm", alarm_id=alarm_id) == ("rejected", again)


def test_the_supply_is_switched_by_its_author_at_this_hour(bench):
    assert bench.execute("supply_on", voltage_v=5.0) == ("done", "the supply is on")
    assert bench.execute("supply_on", voltage_v=50.0) == ("rejected", "beyond the cap")
    assert bench.execute("supply_off", note="done") == ("done", "the supply is off")
    assert bench.switch.done == [("on", "ann", HOUR, 5.0, None), ("off", "ann", HOUR)]


@pytest.mark.parametrize(
    ("kind", "arguments", "reason"),
    [
        ("finish_now", {}, "the test runs on the wall clock, which cannot skip time"),
        ("supply_on", {}, "this test has no supply; configure [rig.supply]"),
        ("disable", {"position": "A"}, "there is no solitary-wave transducer 'A'; there are: B, C, D"),
    ],
)
def test_a_command_that_this_test_cannot_execute_is_rejected(bare, kind, arguments, reason):
    assert bare.execute(kind, **arguments) == ("rejected", reason)


def test_an_unknown_command_is_rejected_and_the_next_one_executed(bench):
    assert bench.execute("self_destruct")[0] == bench.execute("disable", positon="B")[0] == "rejected"
    assert bench.execute("pause", note="why")[0] == "done"
