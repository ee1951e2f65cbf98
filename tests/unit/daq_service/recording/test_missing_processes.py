"""Reaction of a recorder to a stalled web service, and to the alarm raised in its absence."""

from __future__ import annotations

import pytest
from support.memory_line import Line

from daq_service.alarms.process_trouble import RECORDER_NOT_RUNNING, build_reason_condition
from daq_service.alarms.states import Moment, update_alarm
from daq_service.catalogue import SetCommit
from daq_service.catalogue.rows import AlarmRow, EventRow
from daq_service.clock import MachineClock, boot_name
from daq_service.processes.heartbeat import (
    WEB_ANSWERS_WITHIN_S,
    WEB_DEADLINE_S,
    WEB_FILE,
    WEB_STARTS_WITHIN_S,
    Heartbeat,
    WebWatch,
)
from hardware_drivers.nanoseconds import NS_PER_S


class Web:
    """Heartbeat file of a web service on a manual monotonic clock."""

    def __init__(self, folder):
        self.folder, self.now_s = folder, 1000.0

    def mono_ns(self):
        return round(self.now_s * NS_PER_S)

    def beat(self, stage="", boot: str | None = boot_name()):
        heartbeat = Heartbeat(
            self.folder,
            deadline_s=WEB_DEADLINE_S,
            file=WEB_FILE,
            machine=MachineClock(mono_ns=self.mono_ns, boot_name=lambda: boot),
        )
        heartbeat.stage = stage
        heartbeat.beat("serving")

    def watch(self):
        return WebWatch(self.folder, machine=MachineClock(mono_ns=self.mono_ns))

    def looks(self, watch, seconds):
        for _ in range(round(seconds)):
            self.now_s += 1.0
            yield watch.is_missing()


@pytest.fixture
def web(tmp_path):
    return Web(tmp_path)


def test_a_service_that_stalls_is_missing_until_it_responds(web):
    watch = web.watch()
    web.beat()
    assert set(web.looks(watch, WEB_DEADLINE_S)) == {False}
    later = list(web.looks(watch, 2.0 * WEB_ANSWERS_WITHIN_S))
    assert (later[0], later[-1]) == (None, True)
    web.beat()
    assert next(web.looks(watch, 1.0)) is False


def test_a_service_never_started_or_ended_in_order_is_not_missing(web):
    watch = web.watch()
    assert set(web.looks(watch, 2.0 * WEB_STARTS_WITHIN_S)) == {False}
    web.beat()
    web.beat("ended")
    assert set(web.looks(watch, 2.0 * WEB_STARTS_WITHIN_S)) == {False}


@pytest.mark.parametrize("boot", [boot_name(), "another boot"])
def test_a_service_older_than_the_recorder_has_time_to_return(web, boot):
    web.beat(boot=boot)
    web.now_s += 10.0 * WEB_DEADLINE_S
    watch = web.watch()
    assert set(web.looks(watch, WEB_STARTS_WITHIN_S - 1.0)) == {None}
    assert list(web.looks(watch, 2.0))[-1] is True


def test_a_wake_up_of_the_computer_reports_no_missing_service(web):
    watch = web.watch()
    web.beat()
    assert next(web.looks(watch, 1.0)) is False
    web.now_s += 8 * 3600.0
    assert next(web.looks(watch, 1.0)) is None
    web.beat()
    assert next(web.looks(watch, 1.0)) is False


class ScriptedWatch(WebWatch):
    """Callable that returns the items of a list, then always the last item."""

    def __init__(self, folder, *answers):
        super().__init__(folder)
        self.answers = list(answers)

    def is_missing(self):
        return self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]


def events(line):
    with line.catalogue() as catalogue:
        rows = catalogue.rows(EventRow, topic="alarms")
    return [
        (row.payload["kind"], row.kind) for row in rows if row.payload.get("kind", "").endswith(("ing", "ng"))
    ]


def test_the_recorder_raises_and_clears_the_alarm_of_the_web_service(tmp_path):
    line = Line(tmp_path, listen_every_s=0.0)  # a test in memory ends before the next look
    assert line.run(web=ScriptedWatch(tmp_path, False, None, True, True, None, False, False))
    kind = "web_not_responding"
    assert events(line) == [(kind, "alarm_raised"), (kind, "alarm_cleared")]
    with line.catalogue() as catalogue:
        (row,) = catalogue.rows(AlarmRow, kind=kind)
    assert (row.priority, row.alarm_class) == ("medium", "diagnostic")
    assert row.message.startswith("Dashboard not responding. No heartbeat (hour ")
    assert row.message.endswith("Read `logs/`, then restart `solimon serve`.")


def raise_in_its_absence(line):
    with line.catalogue(writer=True) as catalogue:
        line.epoch_ns(catalogue)
        moment = Moment(utc_ns=0, due_h=0.0, set_index=None)
        condition = build_reason_condition(RECORDER_NOT_RUNNING, "3 restarts in 10 min")
        change = update_alarm(None, condition, moment)
        catalogue.commit_set(SetCommit(alarms=[change.row]))


@pytest.mark.parametrize("when", ["before it starts", "while it runs"])
def test_a_stored_set_clears_the_alarm_that_another_process_raised(tmp_path, when):
    line = Line(tmp_path)
    if when == "before it starts":
        raise_in_its_absence(line)

    def report(event, **values):
        if when == "while it runs" and event == "begun":
            raise_in_its_absence(line)

    assert line.run(notify=report)
    assert events(line) == [("recorder_not_running", "alarm_cleared")]
    with line.catalogue() as catalogue:
        (row,) = catalogue.rows(AlarmRow, kind="recorder_not_running")
    assert row.state == "returned_unacknowledged"


def test_a_command_applies_to_the_alarm_of_another_process(tmp_path):
    line = Line(tmp_path, script=lambda key: None)  # no set has records: the alarm stays

    def report(event, **values):
        if event == "begun":
            raise_in_its_absence(line)

    line.order("acknowledge_alarm", alarm_id=1, note="seen")
    line.run(notify=report)
    with line.catalogue() as catalogue:
        (row,) = catalogue.rows(AlarmRow, kind="recorder_not_running")
    assert (row.id, row.state, row.acknowledged_by) == (1, "acknowledged", "Ada")
