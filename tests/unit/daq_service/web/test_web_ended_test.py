"""A test that nobody records: acknowledged by the service itself, and given no other orders."""

import errno
import os
from pathlib import Path

import pytest
from support.filled_folder import FilledFolder
from support.served_web import served

from daq_service.catalogue.rows import CommandRow
from daq_service.orders.audit import read_audit
from daq_service.processes.data_folder import LOCK_FILE
from daq_service.settings.tree import Settings


@pytest.fixture
def ended(tmp_path):
    filled = FilledFolder(tmp_path, Settings(clock={"pace_h_per_s": 5.0}))
    for index in range(2):
        filled.add_set(index, stored=False)
    filled.add_alarm("B", 1)
    filled.say("schedule_done", filled.due[1].due_utc_ns)
    filled.close()
    with served(filled.settings, tmp_path) as service, service.client() as api:
        yield filled, api


def ordered(api, kind, **arguments):
    return api.post("/api/v1/commands", json={"kind": kind, "author": "Ada", "arguments": arguments})


def test_an_acknowledgement_is_done_when_the_answer_comes(ended):
    filled, api = ended
    answer = api.post("/api/v1/alarms/1/acknowledge", json={"author": "Ada", "note": "seen"})
    assert (answer.status_code, answer.json()["state"], answer.json()["result"]) == (
        202,
        "done",
        "acknowledged",
    )
    alarm = api.get("/api/v1/alarms/1").json()
    assert (alarm["state"], alarm["acknowledged_by"]) == ("acknowledged", "Ada")
    ((_, deed), *_) = read_audit(filled.folder, limit=1)[0]
    assert (deed.what, deed.result, deed.command_id) == ("acknowledge_alarm", "done", 1)
    again = api.post("/api/v1/alarms/1/acknowledge", json={})
    assert (again.status_code, again.json()["detail"]) == (
        409,
        "Alarm 1 is acknowledged: there is nothing to acknowledge.",
    )
    assert api.post("/api/v1/alarms/9/acknowledge", json={}).status_code == 404
    # The lock is free again: a recorder may come.
    again = FilledFolder(filled.folder, filled.settings, begun=True)
    assert [row.state for row in again.catalogue.rows(CommandRow)] == ["done"]
    again.close()


@pytest.mark.parametrize("said", [True, False])
def test_other_orders_are_refused_with_what_would_help(ended, said):
    filled, api = ended
    if not said:  # killed: nothing tells that it has ended but the lock
        again = FilledFolder(filled.folder, filled.settings, begun=True)
        again.say("recorder_started")
        again.close()
    body = ordered(api, "hold", note="door open").json()
    why = "The recorder has finished" if said else "Nobody records this test"
    assert (body["status"], body["detail"]) == (409, f"{why}: nobody would carry this out.")
    assert "solimon run" in body["hint"]
    assert api.get("/api/v1/commands/1").status_code == 404


def test_a_recorder_that_lingers_is_given_the_order(ended):
    filled, api = ended
    lingering = FilledFolder(filled.folder, filled.settings, begun=True)
    lingering.say("schedule_done")
    assert api.post("/api/v1/alarms/1/acknowledge", json={}).json()["state"] == "pending"
    lingering.close()


def test_a_folder_that_cannot_be_written_is_served_and_says_so(ended, monkeypatch):
    filled, api = ended
    opened = Path.open

    def read_only(path, mode="r", **named):
        if path.parent == filled.folder and set(mode) & set("wa+"):
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))
        return opened(path, mode, **named)

    monkeypatch.setattr(Path, "open", read_only)
    refused = api.post("/api/v1/alarms/1/acknowledge", json={})
    assert (refused.status_code, refused.headers["content-type"]) == (503, "application/problem+json")
    assert LOCK_FILE in refused.json()["detail"]
    assert api.get("/api/v1/alarms/1").json()["state"] == "unacknowledged"
