"""Another process sends notifications while the web service is missing, one at a time."""

from __future__ import annotations

import os
from contextlib import ExitStack

import pytest
from support.filled_folder import filled_folder
from support.receivers import http_receiver
from support.reported_alarms import notifying
from support.served_web import served
from support.waiting import until

from daq_service.processes.data_folder import hold_lock, read_lock_owner
from daq_service.processes.heartbeat import WEB_FILE, Heartbeat, read_web_state
from daq_service.processes.notifications import service
from daq_service.processes.notifications.delivery_log import DeliveryLog
from daq_service.processes.notifications.service import notify_while_web_is_silent

ME = f"process {os.getpid()}"


@pytest.fixture
def receiver(monkeypatch):
    monkeypatch.setenv("DUTY_SECRET", "correct-horse-battery-staple")
    monkeypatch.setattr(service, "LOOK_EVERY_S", 0.01)
    with http_receiver() as running:
        yield running


@pytest.fixture
def filled(tmp_path, receiver):
    settings = notifying(
        {"duty": {"url": receiver.url, "secret_env": "DUTY_SECRET"}}, rules=[{"group_s": 0.0}]
    )
    with filled_folder(tmp_path, settings, sets=1) as folder:
        yield folder


def beat(folder, *, deadline_s):
    Heartbeat(folder, deadline_s=deadline_s, file=WEB_FILE).beat("serving")


def alarm(filled, receiver, kind):
    """Raise an alarm; return the kinds in the next message."""
    filled.add_alarm("B", 0, kind=kind, message=f"{kind} is there")
    return [item["kind"] for item in receiver.next().message["alarms"]]


def test_the_web_service_and_the_standby_process_continue_each_other(filled, receiver):
    with notify_while_web_is_silent(filled.settings, filled.folder, monitors_recorder=False):
        until(lambda: DeliveryLog(filled.folder).read_progress(["duty"]), "the receiver's line")
        with served(filled.settings, filled.folder) as web, web.client() as client:

            def sends():
                found = client.get("/api/v1/notifications").json()
                return bool(found["sending"] and found["receivers"][0]["began"])

            until(sends, "the web service's line")
            assert read_web_state(filled.folder) == "responding"
            assert alarm(filled, receiver, "no_reflection") == ["no_reflection"]
        assert read_web_state(filled.folder) == "not_expected", "it ended in order"
        assert alarm(filled, receiver, "few_valid_shots") == ["few_valid_shots"]
    assert receiver.got.empty(), "nothing is sent twice"


@pytest.mark.skipif(os.name == "nt", reason="Windows keeps the name of an open file")
def test_a_stopped_web_service_holds_no_message_back(filled, receiver):
    """Its process is alive and keeps the lock of the delivery log."""
    beat(filled.folder, deadline_s=0.0)
    with hold_lock(filled.folder, service.LOCK_FILE, ME, holder="process"), ExitStack() as stack:
        stack.enter_context(
            notify_while_web_is_silent(filled.settings, filled.folder, monitors_recorder=False)
        )
        until(lambda: DeliveryLog(filled.folder).read_progress(["duty"]), "the receiver's line")
        assert alarm(filled, receiver, "no_reflection") == ["no_reflection"]


def test_a_process_that_lost_the_lock_stops_sending(filled, receiver):
    """This is a web service that continues after it was stopped for long."""
    with served(filled.settings, filled.folder) as web, web.client() as client:
        until(lambda: client.get("/api/v1/notifications").json()["receivers"][0]["began"], "its line")
        lock = filled.folder / service.LOCK_FILE
        lock.unlink()
        with hold_lock(filled.folder, service.LOCK_FILE, "process 1", holder="process"):
            silent = until(
                lambda: client.get("/api/v1/notifications").json()["not_sending_reason"], "its look"
            )
            assert silent == "another process of this test sends"
            filled.add_alarm("B", 0, kind="no_reflection", message="hole is there")
            assert read_lock_owner(filled.folder, service.LOCK_FILE) == "process 1"
        assert [item["kind"] for item in receiver.next().message["alarms"]] == ["no_reflection"]
    assert receiver.got.empty()
