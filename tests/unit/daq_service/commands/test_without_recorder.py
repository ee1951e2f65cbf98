"""Commands to a test without a recorder: executed once in its place, or rejected."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.invented_rows import condition
from support.new_experiment import new_catalogue

from daq_service.alarms.states import Moment, update_alarm
from daq_service.catalogue import SetCommit, open_catalogue
from daq_service.catalogue.history import HistoryFollower, read_history
from daq_service.catalogue.rows import AlarmRow, CommandRow, EventRow
from daq_service.commands.kinds import CommandRejectedError, Facts, StoredCommand
from daq_service.commands.registry import parse_command
from daq_service.commands.without_recorder import execute_without_recorder
from daq_service.errors import BusyError
from daq_service.processes.data_folder import hold_recorder_lock

NOW = Moment(utc_ns=9_000, due_h=9.0, set_index=None)
HOLE = condition(kind="no_reflection", latched=True)


def ended_test(folder):
    """Fill a folder with one unacknowledged alarm and no recorder; return the id of the alarm."""
    with new_catalogue(folder) as catalogue:
        raised, transaction = Moment(utc_ns=5, due_h=5.0, set_index=1), SetCommit()
        change = update_alarm(None, HOLE, raised)
        transaction.add_alarm(change.row, change.event(raised))
        (alarm_id,) = catalogue.commit_set(transaction).alarm_ids
        HistoryFollower(folder, catalogue).begin()
    return alarm_id


def facts(catalogue):
    return Facts(
        recorder="finished",
        recorded=False,
        can_skip_time=False,
        paused="",
        positions=("B",),
        has_supply=False,
        alarms=catalogue.rows(AlarmRow),
    )


def acknowledge(folder, alarm_id=1):
    order = parse_command("acknowledge_alarm", "ann", {"alarm_id": alarm_id, "note": "seen"})
    assert isinstance(order, StoredCommand)
    return execute_without_recorder(folder, order, facts=facts, moment=lambda: NOW)


def test_an_acknowledgement_is_stored_with_command_event_and_history(tmp_path):
    order_id = acknowledge(tmp_path, ended_test(tmp_path))
    with open_catalogue(tmp_path) as catalogue:
        (alarm,), (order,) = catalogue.rows(AlarmRow), catalogue.rows(CommandRow)
        events = catalogue.rows(EventRow)
    assert (alarm.state, alarm.acknowledged_by, alarm.note) == ("acknowledged", "ann", "seen")
    assert alarm.acknowledged_utc_ns == NOW.utc_ns
    assert (order.id, order.state, order.result, order.author) == (order_id, "done", "acknowledged", "ann")
    assert [row.kind for row in events] == ["alarm_raised", "alarm_acknowledged"]
    history = read_history(tmp_path)
    assert history.events == {row.id: row for row in events}
    assert history.commands == {order_id: order}


def test_a_forbidden_command_stores_nothing(tmp_path):
    alarm_id = ended_test(tmp_path)
    acknowledge(tmp_path, alarm_id)
    before = read_history(tmp_path).last_number
    with pytest.raises(CommandRejectedError, match="nothing to acknowledge"):
        acknowledge(tmp_path, alarm_id)
    with pytest.raises(CommandRejectedError, match="no current alarm 7"):
        acknowledge(tmp_path, 7)
    with open_catalogue(tmp_path) as catalogue:
        assert len(catalogue.rows(CommandRow)) == 1
    assert read_history(tmp_path).last_number == before


def test_a_recorder_started_meanwhile_is_not_disturbed(tmp_path, monkeypatch):
    alarm_id = ended_test(tmp_path)
    monkeypatch.setattr(
        "daq_service.commands.without_recorder.hold_recorder_lock",
        lambda folder: hold_recorder_lock(folder, patience_s=0.0),
    )
    with hold_recorder_lock(tmp_path), pytest.raises(BusyError, match="owns"):
        acknowledge(tmp_path, alarm_id)
    with open_catalogue(tmp_path) as catalogue:
        assert catalogue.rows(CommandRow) == []


KILLED = """
import os
import sys
from pathlib import Path
import daq_service.catalogue.writer as writer
from unit.daq_service.commands.test_without_recorder import acknowledge

def dies(owner, name, *, after):
    real = getattr(owner, name)
    def dying(*arguments, **named):
        if after:
            real(*arguments, **named)
        os._exit(9)
    setattr(owner, name, dying)

match sys.argv[2]:
    case "in the transaction": dies(writer, "store_command", after=True)
    case "before the history": dies(writer.RecorderCatalogue, "commit_set", after=True)
acknowledge(Path(sys.argv[1]))
"""
"""No clean-up and no exception: what a SIGKILL leaves, on Windows too."""


@pytest.mark.parametrize(("point", "done"), [("in the transaction", False), ("before the history", True)])
def test_a_killed_process_has_stored_all_changes_or_none(tmp_path, point, done):
    alarm_id = ended_test(tmp_path)
    tests = str(Path(__file__).parents[3])
    path = os.pathsep.join(filter(None, [tests, os.environ.get("PYTHONPATH")]))
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, str(tmp_path), point],
        env={**os.environ, "PYTHONPATH": path},
        check=False,
        capture_output=True,
        text=True,
    )
    assert killed.returncode == 9, killed.stderr
    with open_catalogue(tmp_path) as catalogue:
        (alarm,), orders = catalogue.rows(AlarmRow), catalogue.rows(CommandRow)
        events = catalogue.rows(EventRow)
    assert alarm.state == ("acknowledged" if done else "unacknowledged")
    assert [row.state for row in orders] == (["done"] if done else [])
    assert len(events) == 1 + done
    # A repeated command is done once, and the history has every line.
    if done:
        with pytest.raises(CommandRejectedError, match="nothing to acknowledge"):
            acknowledge(tmp_path, alarm_id)
    else:
        acknowledge(tmp_path, alarm_id)
    with open_catalogue(tmp_path) as catalogue:
        assert [row.kind for row in catalogue.rows(EventRow)] == ["alarm_raised", "alarm_acknowledged"]
        assert read_history(tmp_path).events.keys() == {1, 2}
        assert len(read_history(tmp_path).commands) == len(catalogue.rows(CommandRow)) == 1
