"""A position with a suppressed alarm is not green in page, list, `status`, metrics and report."""

import re
from contextlib import nullcontext
from pathlib import Path
from typing import get_args

import pytest
from support.filled_folder import filled_folder
from support.served_web import served, served_app
from support.small_experiment import AtOnce
from test_web_metrics import samples, value

from daq_service import web
from daq_service.alarms.operator_actions import take_out_of_service
from daq_service.alarms.states import Moment
from daq_service.assessment.position_status import PositionStatus
from daq_service.cli.status.facts import describe_status
from daq_service.settings.tree import Settings
from daq_service.web.multi_test.app import create_app_of_many
from daq_service.web.routes import report

SETS = 4


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    with filled_folder(tmp_path_factory.mktemp("data"), sets=SETS) as filled:
        filled.shelve(filled.add_alarm("A", SETS - 1, kind="thickness_low"), "a known leak", for_h=8.0)
        row = filled.catalogue.alarm(filled.add_alarm("B", SETS - 1))
        moment = Moment(utc_ns=row.raised_utc_ns, due_h=row.raised_h, set_index=None)
        filled._change(take_out_of_service(row, "ann", "its sensor is repaired", moment), moment)
        filled.shelve(filled.add_alarm("C", 0), "its time is over", for_h=0.25)
        yield filled


EXPECTED = {"A": "shelved", "B": "out_of_service", "C": "alarm", "D": "collecting_baseline"}


def test_page_metrics_and_report_show_suppressed_alarms(folder, monkeypatch):
    monkeypatch.setattr(report, "one_worker", lambda: nullcontext(AtOnce()))
    with served(folder.settings, folder.folder) as service, service.client() as api:
        items = api.get("/api/v1/transducers").json()["items"]
        found = samples(api)
        reported = api.get("/api/v1/report").text
    assert {item["position"]: item["state"] for item in items} == EXPECTED
    for position, status in EXPECTED.items():
        assert value(found, "position_state", position=position, state=status) == 1
        assert f"<td>{status.replace('_', ' ')}</td>" in reported


def test_the_list_of_tests_shows_suppressed_alarms(folder, tmp_path):
    app = create_app_of_many([folder.folder], Settings(), tmp_path)
    with served_app(app) as service, service.client() as api:
        (entry,) = api.get("/api/v1/tests").json()["items"]
    assert {place["position"]: place["state"] for place in entry["standing"]["positions"]} == EXPECTED
    assert entry["standing"]["state"] == "alarm", "the most urgent one"


def test_status_shows_suppressed_alarms(folder):
    positions = describe_status(folder.folder, folder.settings)["positions"]
    assert {name: row["state"] for name, row in positions.items()} == EXPECTED


def test_the_page_has_a_label_for_each_status():
    script = (Path(web.__file__).parent / "dashboard" / "icons.js").read_text(encoding="utf-8")
    states = script.partition("export const STATES = {")[2].partition("};")[0]
    labels = dict(re.findall(r'(\w+): \{ label: "([^"]+)"', states))
    assert labels.keys() == set(get_args(PositionStatus))
    assert (labels["shelved"], labels["out_of_service"]) == ("Shelved", "Out of service")
