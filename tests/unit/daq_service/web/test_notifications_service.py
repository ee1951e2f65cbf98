"""Notifications of a running service: during requests, its end, a crash and a second service."""

from contextlib import ExitStack

import pytest
from support.filled_folder import FilledFolder, filled_folder
from support.receivers import http_receiver
from support.reported_alarms import notifying
from support.served_web import served
from support.waiting import WAIT_S, ended, until

from daq_service.processes.data_folder import BACKUP_FILE
from daq_service.processes.notifications import webhook
from daq_service.processes.notifications.delivery_log import LOG_FILE

SECRET = "correct-horse-battery-staple"
STATE = "/api/v1/notifications"


@pytest.fixture
def receiver(monkeypatch):
    monkeypatch.setenv("DUTY_SECRET", SECRET)
    with http_receiver() as running:
        yield running


def immediate_settings(receiver, **options):
    duty = {"url": f"{receiver.url}/T0K3N", "secret_env": "DUTY_SECRET", **options}
    return notifying({"duty": duty}, rules=[{"group_s": 0.0}])


@pytest.fixture
def filled(tmp_path, receiver):
    with filled_folder(tmp_path, immediate_settings(receiver), sets=1) as folder:
        yield folder


def raise_alarm(folder, kind):
    folder.add_alarm("B", 0, kind=kind)
    return folder.catalogue.last_event_id()


def duty(client):
    (found,) = client.get(STATE).json()["receivers"]
    return found


def wait_for_start(client):
    return until(lambda: duty(client)["began"], "the receiver's line")


def events_of(message):
    return [item["event_id"] for item in message["alarms"]]


def test_an_alarm_is_sent_with_its_quality_and_the_api_lists_the_delivery(filled, receiver):
    with served(filled.settings, filled.folder) as service, service.client() as client:
        assert "starts at the present" in wait_for_start(client)
        event_id = raise_alarm(filled, "wall_change")
        message = receiver.next().message
        assert (events_of(message), message["alarms"][0]["quality"]) == ([event_id], "good")
        found = until(lambda: duty(client) if duty(client)["sent"] else None, "the note of it")
        assert (found["state"], found["waiting"], found["failed"], found["rules"]) == ("idle", 0, 0, [1])
        assert found["last_sent_age_s"] >= 0.0
        first = client.get(f"{STATE}/log", params={"limit": 1}).json()
        assert [(row["what"], row["event_ids"]) for row in first["items"]] == [("sent", [event_id])]
        before = client.get(f"{STATE}/log", params={"limit": 1, "cursor": first["next_cursor"]}).json()
        assert [row["what"] for row in before["items"]] == ["sending"]
        assert before["items"][0]["key"] == first["items"][0]["key"] == message["key"]
        metrics = client.get("/metrics").text
        assert 'solimon_notifications_sent_total{receiver="duty"} 1.0' in metrics
        assert 'solimon_notifications_waiting{receiver="duty"} 0.0' in metrics


def test_neither_secret_nor_path_is_exposed(filled, receiver, caplog):
    caplog.set_level("DEBUG", logger="daq_service")
    receiver.answers.put((500, {}))
    with served(filled.settings, filled.folder) as service, service.client() as client:
        wait_for_start(client)
        raise_alarm(filled, "no_reflection")
        until(lambda: duty(client)["failed"], "a failure")
        texts = [client.get(path).text for path in (STATE, f"{STATE}/log", "/metrics", "/api/v1/info")]
        texts.append(client.post(f"{STATE}/duty/test", json={}).text)
        texts.append(client.get("/api/v1/audit").text)
    texts += [caplog.text, (filled.folder / LOG_FILE).read_text(encoding="utf-8")]
    assert [text for text in texts if SECRET in text or "T0K3N" in text] == []
    assert duty_address(texts[0]) == receiver.url.removesuffix("/hook")


def duty_address(text):
    return text.partition('"address":"')[2].partition('"')[0]


def test_a_test_message_returns_its_result_and_only_one_runs_at_a_time(filled, receiver):
    with served(filled.settings, filled.folder) as service, service.client() as client:
        answer = client.post(f"{STATE}/duty/test", json={}).json()
        assert (answer["ok"], answer["status"], answer["result"]) == (True, 204, "taken (204)")
        assert receiver.next().message["kind"] == "test"
        receiver.answers.put((410, {}))
        assert client.post(f"{STATE}/duty/test", json={}).json()["result"] == "the receiver answers 410 Gone"
        assert client.post(f"{STATE}/night/test", json={}).json()["hint"] == "The receivers are: duty."
        line = service.app.state.context.notifications.queues["duty"]
        with line._test_lock:
            refused = client.post(f"{STATE}/duty/test", json={})
        assert (refused.status_code, refused.json()["status"]) == (409, 409)


def test_a_backup_sends_no_notifications(filled, receiver):
    """Its heartbeats would hide that the service of the test itself has ended."""
    (filled.folder / BACKUP_FILE).write_bytes(b"{}")
    with served(filled.settings, filled.folder) as service, service.client() as client:
        state = client.get(STATE).json()
        assert (state["sending"], state["receivers"][0]["began"]) == (False, "")
        assert (
            state["not_sending_reason"] == "this is a backup; notifications come from the test's own folder"
        )
    assert not (filled.folder / LOG_FILE).exists()


def test_a_receiver_that_never_answers_slows_no_other_and_no_end(tmp_path, receiver, monkeypatch):
    """Its timeout is longer than all waits of this test: any delay would fail the test."""
    for limit in ("READ_WITHIN_S", "ANSWER_WITHIN_S"):
        monkeypatch.setattr(webhook, limit, 10.0 * WAIT_S)
    with http_receiver() as deaf, ExitStack() as stack:
        deaf.silent.set()
        named = {
            name: {"url": one.url, "secret_env": "DUTY_SECRET"}
            for name, one in (("deaf", deaf), ("duty", receiver))
        }
        filled = FilledFolder(tmp_path, notifying(named, rules=[{"group_s": 0.0}]))
        stack.callback(filled.close)
        filled.add_set(0, stored=False)
        service = stack.enter_context(served(filled.settings, tmp_path))
        client = stack.enter_context(service.client())
        until(lambda: all(one["began"] for one in client.get(STATE).json()["receivers"]), "the lines")
        raise_alarm(filled, "no_reflection")
        deaf.next()
        raise_alarm(filled, "few_valid_shots")
        kinds: list[str] = []
        while len(kinds) < 2:  # one message, if both were there when its line looked
            kinds += [alarm["kind"] for alarm in receiver.next().message["alarms"]]
        assert kinds == ["no_reflection", "few_valid_shots"]
        quick = [client.get("/healthz").status_code for _ in range(20)]
        assert quick == [200] * 20
        service.stop.set()
        ended(service.thread, "the service's end")
        assert not deaf.ended.is_set()
