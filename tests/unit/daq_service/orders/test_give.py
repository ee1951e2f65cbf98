"""Orders from the command line: written, answered, refused, or left for later."""

import json
import threading
import time
from contextlib import contextmanager

import pytest
from support.filled_folder import FilledFolder

import daq_service.orders.give
from daq_service.catalogue.errors import NoDataYetError
from daq_service.errors import BusyError, UsageError
from daq_service.orders.give import give_order
from daq_service.processes.heartbeat import FILE_NAME
from daq_service.settings.tree import Settings

DEADLINE_S = 10.0
"""Far beyond what an answer takes; a hanging test ends here."""


@pytest.fixture
def filled(tmp_path, monkeypatch):
    monkeypatch.setattr(daq_service.orders.give, "LOOK_EVERY_S", 0.005)
    (tmp_path / "data").mkdir()
    folder = FilledFolder(tmp_path / "data", Settings())
    folder.add_set(0, stored=False)
    yield folder
    folder.close()


@contextmanager
def a_recorder_that(filled, state, result):
    """Answer the next order as a recorder does; gives the list of the orders it saw."""
    seen, given_up = [], threading.Event()

    def obey():
        deadline = time.monotonic() + DEADLINE_S
        while not given_up.wait(0.005) and time.monotonic() < deadline:
            for command in filled.catalogue.pending_commands():
                filled.catalogue.finish_command(command["id"], state, result)
                seen.append(command)
                return

    thread = threading.Thread(target=obey)
    thread.start()
    try:
        yield seen
    finally:
        given_up.set()
        thread.join()


def give(filled, kind, **options):
    given = {"note": "", "author": "ann", "as_json": False, **options}
    return give_order(kind, config=None, data_dir=filled.folder, **given)


def test_an_order_is_written_and_its_answer_printed(filled, capsys):
    with a_recorder_that(filled, "done", "on hold: nothing strikes") as seen:
        assert give(filled, "hold", note="door open") == 0
    assert [(row["kind"], row["author"], row["arguments"]) for row in seen] == [
        ("hold", "ann", {"note": "door open"})
    ]
    assert capsys.readouterr().out == "on hold: nothing strikes\n"


def test_a_position_goes_with_the_order_and_json_is_one_object(filled, capsys):
    with a_recorder_that(filled, "done", "B strikes no more"):
        give(filled, "retire", arguments={"position": "B"}, note="coil is hot", as_json=True)
    assert json.loads(capsys.readouterr().out) == {
        "id": 1,
        "kind": "retire",
        "author": "ann",
        "arguments": {"note": "coil is hot", "position": "B"},
        "state": "done",
        "result": "B strikes no more",
    }


@pytest.mark.parametrize("as_json", [False, True])
def test_a_refusal_is_an_error_with_the_recorders_reason(filled, capsys, as_json):
    with (
        a_recorder_that(filled, "refused", "B is not retired"),
        pytest.raises(UsageError, match="refused to reinstate: B is not retired") as refusal,
    ):
        give(filled, "reinstate", arguments={"position": "B"}, as_json=as_json)
    assert refusal.value.exit_code == 2
    said = capsys.readouterr().out
    assert (json.loads(said)["state"] if as_json else said) == ("refused" if as_json else "")


def test_an_order_without_an_answer_stays(filled, capsys):
    with pytest.raises(BusyError, match=r"order 1 \(release\) stays") as silence:
        give(filled, "release", within_s=0.05, as_json=True)
    assert silence.value.exit_code == 5
    assert json.loads(capsys.readouterr().out)["state"] == "pending"
    assert [row["kind"] for row in filled.catalogue.pending_commands()] == ["release"]


@pytest.mark.parametrize("why", ["never ran", "overdue", "was stopped"])
def test_without_a_recorder_nothing_is_written(filled, why):
    if why == "never ran":
        (filled.folder / FILE_NAME).unlink()
    elif why == "overdue":
        beat = json.loads((filled.folder / FILE_NAME).read_text(encoding="utf-8"))
        beat["mono_ns"] -= 10**9 * round(beat["deadline_s"] + 1)
        (filled.folder / FILE_NAME).write_text(json.dumps(beat), encoding="utf-8")
    else:
        filled.say("recorder_stopped", filled.due[0].due_utc_ns)
    with pytest.raises(BusyError, match=r"no recorder runs on .*data"):
        give(filled, "hold")
    assert filled.catalogue.pending_commands() == []


@pytest.mark.parametrize("told", [["schedule_done"], ["recorder_stopped", "recorder_started"]])
def test_a_recorder_that_lingers_or_was_started_again_listens(filled, told):
    for kind in told:
        filled.say(kind, filled.due[0].due_utc_ns)
    with a_recorder_that(filled, "done", "done"):
        assert give(filled, "hold") == 0


def test_a_folder_without_data_has_nobody_to_order(tmp_path):
    with pytest.raises(NoDataYetError, match="no data yet"):
        give_order("hold", config=None, data_dir=tmp_path, note="", author=None, as_json=False)


def test_the_author_is_this_user_unless_named(filled, monkeypatch):
    monkeypatch.setattr("getpass.getuser", lambda: "u" * 100)
    with a_recorder_that(filled, "done", "") as seen:
        give(filled, "hold", author=None)
    assert seen[0]["author"] == "u" * 80
