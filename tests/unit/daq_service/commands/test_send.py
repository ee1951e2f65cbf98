"""Commands from the command line: stored, answered, rejected, or left pending."""

import json
from contextlib import ExitStack
from typing import Any

import pytest
from support.new_experiment import add_events, new_catalogue

from daq_service.catalogue.errors import NoDataYetError
from daq_service.clock import MachineClock
from daq_service.commands.send import send_command
from daq_service.errors import BusyError, UsageError
from daq_service.processes.data_folder import hold_recorder_lock
from daq_service.processes.heartbeat import Heartbeat


def beat(folder, stage=""):
    heartbeat = Heartbeat(folder, deadline_s=3600.0)
    heartbeat.stage = stage
    heartbeat.beat("waiting")


class RecorderDouble:
    """Recorder double that answers pending commands at each poll."""

    def __init__(self, folder, catalogue, ownership):
        self.ownership = ownership
        self.folder, self.catalogue = folder, catalogue
        self.answer = ("done", "")
        self.seen: list[tuple[str, str, dict[str, Any]]] = []
        add_events(catalogue, "recorder_started")
        beat(folder)

    def look(self, seconds):
        for row in self.catalogue.list_open_commands():
            self.seen.append((row.kind, row.author, row.arguments))
            self.catalogue.finish_command(row.id, *self.answer)

    def send(self, kind, **options):
        options = {
            "note": "",
            "author": "ann",
            "as_json": False,
            "machine": MachineClock(sleep=self.look),
            **options,
        }
        return send_command(kind, config=None, data_dir=self.folder, **options)


@pytest.fixture
def recorder(tmp_path):
    with new_catalogue(tmp_path) as catalogue, ExitStack() as ownership:
        ownership.enter_context(hold_recorder_lock(tmp_path))
        yield RecorderDouble(tmp_path, catalogue, ownership)


def test_a_command_is_stored_and_its_result_printed(recorder, capsys):
    recorder.answer = ("done", "paused: nothing strikes")
    assert recorder.send("pause", note="door open") == 0
    assert recorder.seen == [("pause", "ann", {"note": "door open"})]
    assert capsys.readouterr().out == "paused: nothing strikes\n"


def test_a_command_has_its_position_and_json_is_one_object(recorder, capsys):
    recorder.answer = ("done", "B is disabled")
    recorder.send("disable", position="B", note="coil is hot", as_json=True)
    assert json.loads(capsys.readouterr().out) == {
        "id": 1,
        "kind": "disable",
        "author": "ann",
        "arguments": {"note": "coil is hot", "position": "B"},
        "state": "done",
        "result": "B is disabled",
    }


def test_arguments_that_are_not_given_are_left_out(recorder):
    recorder.send("supply_on", voltage_v=5.0, current_limit_a=None)
    assert recorder.seen[0][2] == {"note": "", "voltage_v": 5.0}


@pytest.mark.parametrize("as_json", [False, True])
def test_a_rejected_command_is_an_error_with_the_recorders_reason(recorder, capsys, as_json):
    recorder.answer = ("rejected", "B is not disabled")
    with pytest.raises(UsageError, match="rejected enable: B is not disabled") as refusal:
        recorder.send("enable", position="B", as_json=as_json)
    assert refusal.value.exit_code == 2
    printed = capsys.readouterr().out
    assert (json.loads(printed)["state"] if as_json else printed) == ("rejected" if as_json else "")


def test_invalid_arguments_are_not_stored(recorder):
    with pytest.raises(UsageError, match=r"arguments\.voltage_v"):
        recorder.send("supply_on", voltage_v=-5.0)
    assert recorder.catalogue.list_open_commands() == recorder.seen == []


def test_a_command_that_is_not_started_in_time_expires(recorder, capsys):
    with pytest.raises(BusyError, match=r"command 1 \(resume\) expired: not executed") as silence:
        recorder.send("resume", within_s=0.0, as_json=True)
    assert silence.value.exit_code == 5
    assert json.loads(capsys.readouterr().out)["state"] == "expired"
    assert recorder.seen == []


def test_a_started_command_without_a_result_is_reported_as_unknown(recorder):
    with pytest.raises(
        BusyError, match=r"started command 1 \(pause\) .* before you send it again"
    ) as silence:
        recorder.send(
            "pause",
            note="why",
            carried_out_within_s=0.0,
            machine=MachineClock(sleep=lambda seconds: recorder.catalogue.start_command(1)),
        )
    assert silence.value.exit_code == 5


def test_a_command_whose_recorder_ended_is_reported_as_failed(recorder):
    recorder.answer = ("failed", "the recorder ended while carrying it out")
    with pytest.raises(BusyError, match=r"command 1 \(pause\) failed: the recorder ended"):
        recorder.send("pause", note="why")


def killed(recorder):
    recorder.ownership.close()


def stopped(recorder):
    add_events(recorder.catalogue, "recorder_stopped")
    beat(recorder.folder, "ended")


@pytest.mark.parametrize("end", [killed, stopped])
def test_without_a_recorder_no_command_is_stored(recorder, end):
    end(recorder)
    with pytest.raises(BusyError, match=r"no recorder runs on "):
        recorder.send("pause", note="why")
    assert recorder.catalogue.list_open_commands() == []


@pytest.mark.parametrize("kind", ["schedule_done", "recorder_stopped"])
def test_a_recorder_that_opens_its_rig_gets_no_command(recorder, kind):
    add_events(recorder.catalogue, kind)
    beat(recorder.folder, "opening")
    with pytest.raises(BusyError, match=r"the recorder of .* is waiting: nothing strikes, .*its rig is open"):
        recorder.send("pause", note="why")
    assert recorder.catalogue.list_open_commands() == []


@pytest.mark.parametrize(
    ("kinds", "stage"), [(["schedule_done"], "ended"), (["recorder_stopped", "recorder_started"], "")]
)
def test_a_finished_or_restarted_recorder_accepts_commands(recorder, kinds, stage):
    add_events(recorder.catalogue, *kinds)
    beat(recorder.folder, stage)
    assert recorder.send("pause", note="why") == 0
    assert len(recorder.seen) == 1


def test_a_folder_without_data_rejects_commands(tmp_path):
    with pytest.raises(NoDataYetError, match="no data yet"):
        send_command("pause", config=None, data_dir=tmp_path, note="why", author=None, as_json=False)


def test_the_author_is_this_user_unless_named(recorder, monkeypatch):
    monkeypatch.setattr("getpass.getuser", lambda: "u" * 100)
    recorder.send("pause", note="why", author=None)
    assert recorder.seen[0][1] == "u" * 80
