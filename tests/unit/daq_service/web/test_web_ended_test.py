"""A test without a recorder: the service acknowledges alarms and rejects other commands."""

import errno
import os
import time
from pathlib import Path

import pytest
from support.filled_folder import filled_folder
from support.served_web import served

from daq_service.catalogue.rows import CommandRow
from daq_service.commands.audit import read_audit_log
from daq_service.processes.data_folder import LOCK_FILE
from daq_service.settings.tree import Settings
from daq_service.web.tables.formats import FORMATS
from hardware_drivers.nanoseconds import NS_PER_H


@pytest.fixture
def ended(tmp_path):
    with filled_folder(tmp_path, Settings(clock={"pace_h_per_s": 5.0}), sets=2) as filled:
        filled.add_alarm("B", 1)
        filled.say("schedule_done", filled.due[1].due_utc_ns)
    with served(filled.settings, tmp_path) as service, service.client() as api:
        yield filled, api


def ordered(api, kind, author="Ada", **arguments):
    return api.post("/api/v1/commands", json={"kind": kind, "author": author, "arguments": arguments})


def test_an_acknowledgement_is_done_within_its_request(ended):
    filled, api = ended
    answer = api.post("/api/v1/alarms/1/acknowledge", json={"author": "Ada", "note": "seen"})
    assert (answer.status_code, answer.json()["state"], answer.json()["result"]) == (
        202,
        "done",
        "acknowledged",
    )
    alarm = api.get("/api/v1/alarms/1").json()
    assert (alarm["state"], alarm["acknowledged_by"]) == ("acknowledged", "Ada")
    ((_, deed), *_) = read_audit_log(filled.folder, limit=1)[0]
    assert (deed.what, deed.result, deed.command_id) == ("acknowledge_alarm", "done", 1)
    again = api.post("/api/v1/alarms/1/acknowledge", json={})
    assert (again.status_code, again.json()["detail"]) == (
        409,
        "Alarm 1 is acknowledged: there is nothing to acknowledge.",
    )
    assert api.post("/api/v1/alarms/9/acknowledge", json={}).status_code == 404
    # The lock is free again: a recorder may come.
    with filled_folder(filled.folder, filled.settings, exists=True) as again:
        assert [row.state for row in again.catalogue.rows(CommandRow)] == ["done"]


def test_a_finished_recorder_that_still_runs_gets_the_command(ended):
    filled, api = ended
    with filled_folder(filled.folder, filled.settings, exists=True) as lingering:
        lingering.say("schedule_done")
        assert api.post("/api/v1/alarms/1/acknowledge", json={}).json()["state"] == "pending"


def test_a_read_only_folder_is_served_and_rejects_commands(ended, monkeypatch):
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


def shelve(api, **body):
    return ordered(api, "shelve_alarm", **{"alarm_id": 1, "for_h": 8.0, "reason": "known", **body})


def test_a_shelved_alarm_is_counted_separately_with_its_expiry(ended):
    _, api = ended
    assert shelve(api).json()["state"] == "done"
    alarm = api.get("/api/v1/alarms/1").json()
    state = (alarm["state"], alarm["suppressed"], alarm["suppressed_by"])
    assert state == ("unacknowledged", "shelved", "Ada")
    assert alarm["shelved_until_utc"] == "2024-01-01T09:00:00Z"
    place = api.get("/api/v1/transducers/B").json()
    assert (place["active_alarms"], place["suppressed_alarms"], place["state"]) == (0, 1, "shelved")
    assert place["shelved_until_utc"] == "2024-01-01T09:00:00Z"
    assert 'state="unacknowledged",suppressed="shelved"} 1' in api.get("/metrics").text
    assert api.post("/api/v1/alarms/1/acknowledge", json={}).json()["state"] == "done"
    answer = ordered(api, "unshelve_alarm", "ben", alarm_id=1, note="mended")
    assert answer.json()["state"] == "done"
    assert api.get("/api/v1/transducers/B").json()["active_alarms"] == 1
    history = api.get("/api/v1/alarms/1/history").json()["items"]
    assert [(row["kind"], row["author"], row["reason"]) for row in history[1:]] == [
        ("alarm_shelved", "Ada", "known"),
        ("alarm_acknowledged", "operator", ""),
        ("alarm_unshelved", "ben", "mended"),
    ]


def test_a_shelf_ends_in_real_time_without_a_recorder(ended, monkeypatch):
    _, api = ended
    shelve(api, for_h=8.0)
    later_ns = time.time_ns() + 9 * NS_PER_H
    monkeypatch.setattr("daq_service.processes.freshness.time.time_ns", lambda: later_ns)
    assert api.get("/api/v1/alarms/1").json()["suppressed"] is None
    assert api.get("/api/v1/transducers/B").json()["active_alarms"] == 1
    refused = ordered(api, "unshelve_alarm", alarm_id=1)
    assert (refused.status_code, refused.json()["detail"]) == (409, "Alarm 1 is not shelved.")
    assert shelve(api).json()["state"] == "done"


def test_alarms_are_filtered_by_state_severity_kind_and_hour(ended):
    filled, api = ended
    with filled_folder(filled.folder, filled.settings, exists=True) as again:
        again.add_alarm("C", 0, priority="low", kind="few_valid_shots", state="acknowledged")

    def found(query):
        return [row["id"] for row in api.get(f"/api/v1/alarms?{query}").json()["items"]]

    assert found("") == [1, 2]
    assert found("state=acknowledged") == found("priority=low") == found("kind=few_valid_shots") == [2]
    assert found("from_h=0.9") == found("priority=high&position=B") == [1]
    assert found("from_h=0.5&to_h=1.0") == [2]


@pytest.mark.parametrize(
    ("path", "is_strong"),
    [
        ("tables/features?position=B", True),
        ("tables/features?position=B&format=parquet", False),
        ("trends/B?points=9", False),
    ],
)
def test_an_ended_test_answers_304_until_something_changes(ended, path, is_strong):
    filled, api = ended
    first = api.get(f"/api/v1/{path}")
    etag = first.headers["etag"]
    assert (first.status_code, etag.startswith("W/")) == (200, not is_strong)
    same = api.get(f"/api/v1/{path}", headers={"If-None-Match": f'"other", {etag}'})
    assert (same.status_code, same.content, same.headers["etag"]) == (304, b"", etag)
    if is_strong:
        assert api.get(f"/api/v1/{path}").content == first.content
    for other in (f"{path}&from_h=1", path.replace("B", "C")):
        assert api.get(f"/api/v1/{other}", headers={"If-None-Match": etag}).status_code == 200
    assert api.post("/api/v1/alarms/1/acknowledge", json={"note": "seen"}).json()["state"] == "done"
    changed = api.get(f"/api/v1/{path}", headers={"If-None-Match": etag})
    assert (changed.status_code, changed.headers["etag"] == etag) == (200, False)
    with filled_folder(filled.folder, filled.settings, exists=True):
        running = api.get(f"/api/v1/{path}", headers={"If-None-Match": changed.headers["etag"]})
    assert (running.status_code, running.headers.get("etag")) == (200, None), "a recorder runs"


def test_the_format_by_accept_has_its_own_etag_and_alarms_have_none(ended):
    _, api = ended
    csv = api.get("/api/v1/tables/sets").headers["etag"]
    parquet = FORMATS["parquet"].media_type
    asked = {"If-None-Match": csv, "Accept": parquet}
    answer = api.get("/api/v1/tables/sets", headers=asked)
    assert (answer.status_code, answer.headers["content-type"]) == (200, parquet)
    assert "etag" not in api.get("/api/v1/tables/alarms").headers, "a shelf may expire"


def test_a_rebuilt_catalogue_has_another_etag(ended):
    filled, api = ended
    etag = api.get("/api/v1/trends/B").headers["etag"]
    path = filled.folder / "catalogue.sqlite"
    os.utime(path, ns=(0, path.stat().st_mtime_ns + 1))
    assert api.get("/api/v1/trends/B", headers={"If-None-Match": etag}).status_code == 200
