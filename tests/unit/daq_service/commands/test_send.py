"""Orders from the command line: written, answered, refused, or left for later."""

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from support.new_experiment import add_events, new_catalogue

from daq_service.catalogue import RecorderCatalogue
from daq_service.catalogue.errors import NoDataYetError
from daq_service.commands.send import send_command
from daq_service.errors import BusyError, UsageError
from daq_service.processes.data_folder import own_data_folder
from daq_service.processes.heartbeat import FILE_NAME, Heartbeat, Stage


def beat(folder: Path, stage: Stage = "") -> None:
    heartbeat = Heartbeat(folder, deadline_s=3600.0)
    heartbeat.stage = stage
    heartbeat.beat("waiting")


class Recorder:
    """Answers what waits each time the person looks again."""

    def __init__(self, folder: Path, catalogue: RecorderCatalogue, ownership: ExitStack) -> None:
        self.ownership = ownership
        self.folder, self.catalogue = folder, catalogue
        self.answer = ("done", "")
        self.seen: list[tuple[str, str, dict[str, Any]]] = []
        add_events(catalogue, "recorder_started")
        beat(folder)

    def look(self, seconds: float) -> None:
        for row in self.catalogue.open_commands():
            self.seen.append((row.kind, row.author, row.arguments))
            self.catalogue.finish_command(row.id, *self.answer)

    def given(self, kind: str, **options: Any) -> int:
        options = {"note": "", "author": "ann", "as_json": False, "wait": self.look, **options}
        return send_command(kind, config=None, data_dir=self.folder, **options)


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[Recorder]:
    with new_catalogue(tmp_path) as catalogue, ExitStack() as ownership:
        ownership.enter_context(own_data_folder(tmp_path))
        yield Recorder(tmp_path, catalogue, ownership)


def test_an_order_is_written_and_its_answer_printed(
    recorder: Recorder, capsys: pytest.CaptureFixture[str]
) -> None:
    recorder.answer = ("done", "on hold: nothing strikes")
    assert recorder.given("hold", note="door open") == 0
    assert recorder.seen == [("hold", "ann", {"note": "door open"})]
    assert capsys.readouterr().out == "on hold: nothing strikes\n"


def test_a_position_goes_with_the_order_and_json_is_one_object(
    recorder: Recorder, capsys: pytest.CaptureFixture[str]
) -> None:
    recorder.answer = ("done", "B strikes no more")
    recorder.given("retire", position="B", note="coil is hot", as_json=True)
    assert json.loads(capsys.readouterr().out) == {
        "id": 1,
        "kind": "retire",
        "author": "ann",
        "arguments": {"note": "coil is hot", "position": "B"},
        "state": "done",
        "result": "B strikes no more",
    }


def test_what_is_not_given_is_left_out(recorder: Recorder) -> None:
    recorder.given("supply_on", voltage_v=5.0, current_limit_a=None)
    assert recorder.seen[0][2] == {"note": "", "voltage_v": 5.0}


@pytest.mark.parametrize("as_json", [False, True])
def test_a_refusal_is_an_error_with_the_recorders_reason(
    recorder: Recorder, capsys: pytest.CaptureFixture[str], as_json: bool
) -> None:
    recorder.answer = ("refused", "B is not retired")
    with pytest.raises(UsageError, match="refused to reinstate: B is not retired") as refusal:
        recorder.given("reinstate", position="B", as_json=as_json)
    assert refusal.value.exit_code == 2
    said = capsys.readouterr().out
    assert (json.loads(said)["state"] if as_json else said) == ("refused" if as_json else "")


def test_arguments_that_no_recorder_would_take_are_not_written(recorder: Recorder) -> None:
    with pytest.raises(UsageError, match=r"arguments\.voltage_v"):
        recorder.given("supply_on", voltage_v=-5.0)
    assert recorder.catalogue.open_commands() == recorder.seen == []


def test_an_order_that_nobody_begins_in_time_expires(
    recorder: Recorder, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(
        BusyError, match=r"order 1 \(release\) expired: not carried out, and nobody"
    ) as silence:
        recorder.given("release", within_s=0.0, as_json=True)
    assert silence.value.exit_code == 5
    assert json.loads(capsys.readouterr().out)["state"] == "expired"
    assert recorder.seen == []


def test_an_order_that_was_begun_is_waited_for_and_then_told_as_unknown(recorder: Recorder) -> None:
    with pytest.raises(
        BusyError, match=r"began order 1 \(hold\) .* look before you give it again"
    ) as silence:
        recorder.given(
            "hold",
            note="why",
            carried_out_within_s=0.0,
            wait=lambda seconds: recorder.catalogue.start_command(1),
        )
    assert silence.value.exit_code == 5


def test_an_order_that_its_recorder_died_over_is_told_as_failed(recorder: Recorder) -> None:
    recorder.answer = ("failed", "the recorder ended while carrying it out")
    with pytest.raises(BusyError, match=r"order 1 \(hold\) failed: the recorder ended"):
        recorder.given("hold", note="why")


def killed(recorder: Recorder) -> None:
    recorder.ownership.close()


def killed_and_its_heartbeat_lost(recorder: Recorder) -> None:
    recorder.ownership.close()
    (recorder.folder / FILE_NAME).unlink()


def overdue(recorder: Recorder) -> None:
    _change(recorder, lambda beat: beat["mono_ns"] - 10**9 * round(beat["deadline_s"] + 1))


def reboot(recorder: Recorder) -> None:
    recorder.ownership.close()
    beat = json.loads((recorder.folder / FILE_NAME).read_text(encoding="utf-8"))
    del beat["crc32"]
    (recorder.folder / FILE_NAME).write_text(json.dumps(beat | {"boot": "another"}), encoding="utf-8")


def power_cut(recorder: Recorder) -> None:
    recorder.ownership.close()
    (recorder.folder / FILE_NAME).write_text("", encoding="utf-8")


def stopped(recorder: Recorder) -> None:
    add_events(recorder.catalogue, "recorder_stopped")
    beat(recorder.folder, "ended")


def _change(recorder: Recorder, mono_ns: Callable[[dict[str, Any]], int]) -> None:
    beat = json.loads((recorder.folder / FILE_NAME).read_text(encoding="utf-8"))
    del beat["crc32"]
    text = json.dumps(beat | {"mono_ns": mono_ns(beat)})
    (recorder.folder / FILE_NAME).write_text(text, encoding="utf-8")


@pytest.mark.parametrize("end", [killed, killed_and_its_heartbeat_lost, overdue, reboot, power_cut, stopped])
def test_without_a_recorder_nothing_is_written(recorder: Recorder, end: Callable[[Recorder], None]) -> None:
    end(recorder)
    with pytest.raises(BusyError, match=r"no recorder runs on "):
        recorder.given("hold", note="why")
    assert recorder.catalogue.open_commands() == []


@pytest.mark.parametrize("told", ["schedule_done", "recorder_stopped"])
def test_a_recorder_that_opens_its_rig_is_not_denied_and_gets_no_order(recorder: Recorder, told: str) -> None:
    add_events(recorder.catalogue, told)
    beat(recorder.folder, "opening")
    with pytest.raises(BusyError, match=r"the recorder of .* is waiting: nothing strikes, .*its rig is open"):
        recorder.given("hold", note="why")
    assert recorder.catalogue.open_commands() == []


@pytest.mark.parametrize(
    ("told", "stage"), [(["schedule_done"], "ended"), (["recorder_stopped", "recorder_started"], "")]
)
def test_a_recorder_that_lingers_or_was_started_again_listens(
    recorder: Recorder, told: list[str], stage: Stage
) -> None:
    add_events(recorder.catalogue, *told)
    beat(recorder.folder, stage)
    assert recorder.given("hold", note="why") == 0
    assert len(recorder.seen) == 1


def test_a_folder_without_data_has_nobody_to_order(tmp_path: Path) -> None:
    with pytest.raises(NoDataYetError, match="no data yet"):
        send_command("hold", config=None, data_dir=tmp_path, note="why", author=None, as_json=False)


def test_the_author_is_this_user_unless_named(recorder: Recorder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("getpass.getuser", lambda: "u" * 100)
    recorder.given("hold", note="why", author=None)
    assert recorder.seen[0][1] == "u" * 80
