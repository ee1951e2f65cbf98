"""A recorder that waits for its rig is running and raises an alarm; reasons of earlier missed sets."""

import threading
from dataclasses import replace

import pytest
from support.new_experiment import add_events, new_catalogue

from daq_service.alarms.states import Moment
from daq_service.catalogue import SetCommit
from daq_service.catalogue.history import HistoryFollower
from daq_service.catalogue.rows import AlarmRow
from daq_service.processes.data_folder import hold_recorder_lock
from daq_service.processes.heartbeat import Beat, Heartbeat
from daq_service.processes.recorder_state import read_recorder_state
from daq_service.recording.opening import OpeningAlarm, open_rig_with_retries
from daq_service.recording.session import _find_downtime_reason, _store_stop
from hardware_drivers.errors import ConnectionLostError
from hardware_drivers.nanoseconds import NS_PER_H

GONE = ConnectionLostError("the chassis is gone; switch it on")
MOMENT = Moment(utc_ns=2 * NS_PER_H, due_h=2.0, set_index=None)
WHY = (
    f"Instruments not responding, sets are missed. {str(GONE).capitalize()} (hour 2.0). "
    "Check power, cables and other programs; run `solimon doctor`."
)


class Opener:
    """Recorder whose rig is missing a number of times, and its reports."""

    def __init__(self, folder, catalogue):
        self.folder, self.catalogue = folder, catalogue
        self.reports: list[tuple[str, str]] = []
        self.heartbeat = Heartbeat(folder, deadline_s=60.0)
        self.stop = threading.Event()

    def report_message(self, event, **values):
        self.reports.append((event, values.get("reason") or values["change"]))

    def open(self, refusals, look=lambda: None):
        left = [GONE] * refusals

        def open_once():
            look()
            if left:
                raise left.pop()
            return "the rig"

        history = HistoryFollower(self.folder, self.catalogue)
        alarm = OpeningAlarm(self.catalogue, history, lambda: MOMENT, self.report_message)
        return open_rig_with_retries(
            open_once,
            resuming=True,
            restarted=False,
            heartbeat=self.heartbeat,
            stop=self.stop,
            waits_s=(0.01,),
            alarm=alarm,
        )

    @property
    def alarms(self):
        return self.catalogue.rows(AlarmRow, kind="instruments_unavailable")


@pytest.fixture
def opener(tmp_path):
    with new_catalogue(tmp_path) as catalogue, hold_recorder_lock(tmp_path):
        add_events(catalogue, "recorder_started", "recorder_stopped")
        yield Opener(tmp_path, catalogue)


def test_waiting_for_the_rig_is_running_and_raises_an_alarm_until_it_opens(opener):
    seen: list[tuple[str, bool, int]] = []

    def look():
        state = read_recorder_state(opener.folder, ["recorder_stopped"])
        seen.append((state.status, state.listens, len(opener.alarms)))

    rig, did = opener.open(3, look)
    assert (rig, did) == ("the rig", f"the recorder waited for the rig: {GONE}")
    assert seen == [("running", False, 0), *[("running", False, 1)] * 3]
    (row,) = opener.alarms
    assert (row.message, row.evidence) == (WHY, {"error": "ConnectionLostError", "error_message": str(GONE)})
    assert row.state == "returned_unacknowledged"
    assert opener.reports == [("alarm", "alarm_raised"), ("alarm", "alarm_cleared")]
    assert opener.heartbeat.stage == ""


def test_an_active_alarm_is_not_raised_again_but_reported(opener):
    opener.stop.set()
    assert opener.open(9) == (None, f"the recorder waited for the rig: {GONE}")
    opener.stop.clear()
    opener.reports.clear()
    opener.open(2)
    assert opener.reports == [("waits", WHY), ("alarm", "alarm_cleared")]
    assert len(opener.alarms) == 1


def test_an_opened_rig_does_not_clear_the_alarm_of_a_set(opener):
    opener.stop.set()
    opener.open(1)
    (row,) = opener.alarms
    opener.catalogue.commit_set(SetCommit(alarms=[replace(row, evidence={"set_index": 3, "error": "x"})]))
    opener.stop.clear()
    opener.open(0)
    assert [row.state for row in opener.alarms] == ["unacknowledged"]


def beat(stage, doing="taking set 1"):
    return Beat(process=1, mono_ns=0, deadline_s=65.0, doing=doing, stage=stage)


STOPPED = "the recorder was stopped by its operator"


@pytest.mark.parametrize(
    ("kinds", "found", "cause"),
    [
        (["recorder_started", "recorder_stopped"], beat("ended"), STOPPED),
        (["recorder_started", "recorder_stopped"], None, STOPPED),
        (["recorder_stopped"], beat("opening", "opening the rig"), "down; it was last seen opening the rig"),
        (["recorder_started"], beat(""), "the recorder was down; it was last seen taking set 1"),
        (["recorder_started"], None, "the recorder was down; it was last seen at hour 0.00"),
        ([], None, "the recorder was starting"),
    ],
)
def test_missed_sets_have_the_known_cause(tmp_path, kinds, found, cause):
    with new_catalogue(tmp_path) as catalogue:
        add_events(catalogue, *kinds)
        assert cause in _find_downtime_reason(catalogue, found, "")
        assert _find_downtime_reason(catalogue, found, "was killed") == "the recorder was killed"


def test_a_stop_while_waiting_for_the_rig_is_an_orderly_end(opener):
    add_events(opener.catalogue, "recorder_started")
    _store_stop(
        opener.catalogue,
        HistoryFollower(opener.folder, opener.catalogue),
        opener.heartbeat,
        MOMENT,
        threading.Event(),
    )
    event = opener.catalogue.read_last_service_event("recorder_started", "recorder_stopped")
    assert read_recorder_state(opener.folder, [event.kind]).status == "stopped"
