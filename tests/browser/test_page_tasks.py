"""Tasks of users on the page, from the opened page to the answer in three clicks at most."""

import csv
import math
import tomllib
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from urllib.parse import urlencode

import numpy as np
import pytest
from support.browser_pages import at_hour, dashboard, expect, query, watched_pages
from support.filled_folder import filled_folder
from support.receivers import http_receiver
from support.reported_alarms import notifying
from support.served_web import served
from support.waiting import until

from daq_service.clock import parse_utc
from daq_service.commands.audit import Audit
from hardware_drivers.nanoseconds import NS_PER_H

pytestmark = pytest.mark.browser

MOST_CLICKS = 3
N_SETS, N_BASELINE, SHOTS = 52, 48, 2
LAST, OUTLIERS = N_SETS - 1, (49, 50)
OF_B, OF_C = 1, 2
"""Alarms."""
CAUSES = {"wall": 0.972, "sensor": 0.02, "coupling": 0.008}
EVIDENCE = {
    "B": {
        "diagnosis": "wall",
        "diagnosis_probability": CAUSES["wall"],
        "diagnosis_details": {"probabilities": CAUSES},
    },
    "C": None,
}
COUNT_PRESSES = """
addEventListener("pointerdown", (event) => setTimeout(() => {
  if (event.isTrusted && !event.defaultPrevented) sessionStorage.presses = Number(sessionStorage.presses) + 1;
}), true)
"""
"""Kept by the tab; Playwright prevents a press that misses because the page moved, and repeats it."""


GO_TO = """view => {
  for (const dialog of document.querySelectorAll("dialog[open]")) dialog.close();
  history.pushState(null, "", location.pathname + view);
  dispatchEvent(new PopStateEvent("popstate"));
  sessionStorage.presses = 0;
}"""


@pytest.fixture(scope="module")
def receiver():
    with pytest.MonkeyPatch.context() as patch, http_receiver() as receiver:
        patch.setenv("DUTY_SECRET", "correct-horse-battery-staple")
        yield receiver


@pytest.fixture(scope="module")
def filled(receiver, tmp_path_factory):
    settings = notifying({"duty": {"url": receiver.url, "secret_env": "DUTY_SECRET"}})
    with filled_folder(tmp_path_factory.mktemp("tasks"), settings, shots_per_set=SHOTS) as folder:
        make_assessment = folder.assessment

        def with_outliers_at_c(position, index, hour):
            row = make_assessment(position, index, hour)
            outlier = position == "C" and index in OUTLIERS
            expected_outlier = outlier if index >= N_BASELINE else None
            return replace(row, distance_squared=400.0 if outlier else 5.0, outlier=expected_outlier)

        folder.assessment = with_outliers_at_c
        for index in range(N_SETS):
            # Next to C's set the page draws one of the baseline: the first, where all have one distance.
            folder.add_set(index, stored=index == 0 or index > 40)
        for number, position in ((OF_B, "B"), (OF_C, "C")):
            assert folder.add_alarm(position, LAST - 1, evidence=EVIDENCE[position]) == number
        folder.say("schedule_done", folder.due[LAST].due_utc_ns)
        folder.recorder_ends()
        yield folder


@pytest.fixture(scope="module")
def service(filled):
    with served(filled.settings, filled.folder) as running:
        audit, noon = Audit(filled.folder), datetime.now().astimezone().replace(hour=12)
        for who, what, days in (("old", "pause", 2), ("cleo", "pause", 1), ("ben", "log_in", 1)):
            entry = {
                "author": who,
                "what": what,
                "role": "operator",
                "source": "10.0.0.7",
                "result": "accepted",
            }
            at = noon - timedelta(days=days)
            audit.add(**entry, arguments={"note": "new sensor"}, utc_ns=int(at.timestamp()) * 10**9)
        yield running


@pytest.fixture(scope="module")
def api(service):
    with service.client() as client:
        yield lambda path: client.get(f"/api/v1{path}").raise_for_status()


@pytest.fixture(scope="module")
def page(service, browser):
    """Yield one page for all tasks."""
    with watched_pages(browser) as open_:
        page = open_(service.url, name="ann", permissions=["clipboard-read", "clipboard-write"])
        page.context.add_init_script(COUNT_PRESSES)
        page.evaluate(COUNT_PRESSES)
        until(lambda: dashboard(page, "charts.tof.x"), "the trend is drawn")
        yield page


def do(page, verb, what):
    """Click on an element, on the point of a chart at an hour, or type keys without a click."""
    if verb == "click":
        page.locator(what).click()
    elif verb == "press":
        page.keyboard.press(what)
    elif verb == "point":
        chart, hour = what.split()
        page.locator(f"#{chart} .plot").scroll_into_view_if_needed()
        page.mouse.click(*at_hour(page, chart, float(hour)))
    else:
        page.keyboard.type(what)


# ---- answers, compared with the service's --------------------------------------------------------


def is_the_most_urgent_alarm_with_its_hour(page, api, filled):
    (alarm,) = [one for one in api("/alarms").json()["items"] if one["id"] == OF_B]
    assert "probable wall thinning (model: 97 %)" in alarm["headline"]
    text = f"{alarm['headline']}, detected at hour {alarm['raised_h']:.1f}. {alarm['action']}"
    expect(page.locator("#headline")).to_contain_text(text)
    expect(page.locator("#headline")).to_contain_text("1 more active alarm")


def are_the_probabilities_of_all_diagnoses(page, api, filled):
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("WALL 97 %, SENSOR 2 %, COUPLING < 1 %")


def is_the_thickness_with_its_interval(page, api, filled):
    wall = api("/thickness?limit=1000").json()["items"][-1]
    assert wall["set_index"] == LAST
    tile = page.locator('#tiles [data-position="A"]')
    expect(tile).to_contain_text(f"{1e3 * wall['thickness_m']:.2f} mm")
    interval = f"{1e3 * wall['interval_low_m']:.2f} to {1e3 * wall['interval_high_m']:.2f} mm (95 %, "
    expect(tile).to_contain_text(interval)
    expect(tile).to_contain_text(wall["quality"])


def is_accepted_by_the_receiver(page, api, filled):
    expect(page.locator("#notifications")).to_contain_text("Test message accepted after")
    log = api("/notifications").json()["receivers"]
    assert [one["name"] for one in log] == ["duty"]


def are_three_compared_with_a_note(page, api, filled):
    assert query(page)["compare"] == "C,D"
    assert {"tof_pp_us", "tof_pp_us C", "tof_pp_us D"} <= set(dashboard(page, "charts.tof.y"))
    expect(page.locator("#notes [data-note]").first).to_contain_text("B is slower than C and D")
    assert api("/annotations").json()["items"][-1]["text"] == "B is slower than C and D"


def is_the_shot_of_the_first_outlier(page, api, filled):
    assessments = api("/assessments?position=C&limit=1000").json()["items"]
    first = min(row["set_index"] for row in assessments if row["outlier"])
    expect(page.locator("#set")).to_have_attribute("data-set", f"C {first}")
    assert query(page) == {"position": "C", "set": str(first), "shot": "0"}
    shown = until(lambda: dashboard(page, "set"), "its records are drawn")
    volts = dict(zip(shown["labels"], shown["volts"], strict=True))["shot 0"]
    (shot,) = [one for one in filled.records(first) if (one.key.position, one.key.shot_index) == ("C", 0)]
    # The same linear polynomial, evaluated twice: rounding only.
    np.testing.assert_allclose(volts, shot.waveform.volts(), rtol=0, atol=1e-12)
    pressed = page.locator('#set tr:has([aria-pressed="true"])')
    expect(pressed.locator("td").last).to_have_text(str(shot.sequence))


def are_b_and_d_on_one_axis(page, api, filled):
    lines = dashboard(page, "charts.tof.y")
    for key, position in (("tof_pp_us", "B"), ("tof_pp_us D", "D")):
        times = api(f"/trends/{position}?fields=tof_pp_s").json()["columns"]["tof_pp_s"]
        # The page multiplies by the same double as here: equal to the last bit.
        assert lines[key] == [1e6 * time for time in times]
    for position in "BD":
        expect(page.locator("#tof .legend")).to_contain_text(f"time of flight {position}")


def is_shelved_for_eight_hours(page, api, filled):
    alarm = page.locator(f'[data-alarm="{OF_C}"]')
    expect(alarm).to_contain_text("shelved until")
    shelved = api(f"/alarms/{OF_C}/history").json()["items"][-1]
    assert (shelved["suppressed"], shelved["author"], shelved["reason"]) == ("shelved", "ann", "known leak")
    ends = shelved["shelved_until_utc"]
    assert parse_utc(ends) - parse_utc(shelved["utc"]) == 8 * NS_PER_H
    expect(alarm).to_contain_text(f"shelved until {ends[:10]} {ends[11:16]} UTC by ann: known leak")
    expect(page.locator("#alarms")).to_contain_text("1 shelved or out of service")
    expect(page.locator('#tiles [data-position="C"]')).to_contain_text("1 shelved or out of service, until")


def is_who_paused_it_yesterday(page, api, filled):
    midnight = datetime.now().astimezone().replace(hour=0, minute=0, second=0, microsecond=0)
    day = {"from_utc": (midnight - timedelta(days=1)).isoformat(), "to_utc": midnight.isoformat()}
    (held,) = api(f"/audit?{urlencode({'what': 'pause', **day})}").json()["items"]
    rows = page.locator("#audit tbody tr")
    expect(rows).to_have_count(1)
    expect(rows.locator("td").nth(1)).to_have_text(held["author"])
    assert held["author"] == "cleo"


def check_link_shows_the_same_view(page, api, filled):
    expect(page.locator("#toolbar [role=status]")).to_have_text("Copied")
    before, link = what_is_drawn(page), page.evaluate("navigator.clipboard.readText()")
    assert link == page.url
    page.goto(link)
    until(lambda: what_is_drawn(page) == before, "the charts are the same")
    span, lines = before["tof"]
    assert (span, "tof_pp_us D" in lines) == ([3, 27], True)


def what_is_drawn(page):
    return {name: (chart["span"], chart["y"]) for name, chart in dashboard(page, "charts").items()}


def is_the_file_of_what_is_shown(page, api, filled):
    with page.expect_download() as getting:
        page.get_by_role("link", name="Position B as CSV").click()
    rows = list(csv.DictReader(getting.value.path().read_text(encoding="utf-8").splitlines()))
    columns = api("/trends/B?from_h=4&to_h=12&fields=tof_pp_s").json()["columns"]
    assert len(rows) == 16
    assert [float(row["due_h"]) for row in rows] == columns["due_h"]
    assert [float(row["tof_pp_s"]) for row in rows] == columns["tof_pp_s"]


def is_acknowledged_with_its_note(page, api, filled):
    expect(page.locator(f'[data-alarm="{OF_B}"]')).to_contain_text("acknowledged by ann: couplant renewed")
    (alarm,) = [one for one in api("/alarms").json()["items"] if one["id"] == OF_B]
    alarm_fields = [alarm[name] for name in ("state", "acknowledged_by", "note")]
    assert alarm_fields == ["acknowledged", "ann", "couplant renewed"]


def are_the_last_24_hours(page, api, filled):
    to_h = math.floor(api("/info").json()["as_of"]["now_h"]) + 1
    assert to_h > 24, "the test is longer"
    for chart in ("distance", "tof", "thickness"):
        assert dashboard(page, f"charts.{chart}.span") == [to_h - 24, to_h]
    expect(page.locator("#toolbar")).to_contain_text(f"hour {to_h - 24}.0 to {to_h}.0")


def is_the_waterfall_around_the_alarm(page, api, filled):
    (alarm,) = [one for one in api("/alarms").json()["items"] if one["id"] == OF_C]
    around = [alarm["raised_h"] - 5, alarm["raised_h"] + 5]
    waterfall = until(lambda: (found := dashboard(page, "waterfall"))["ready"] and found, "it is drawn")
    assert waterfall["hours"] == around
    assert waterfall["header"]["position"] == alarm["position"] == "C"
    rows = api(f"/waterfall/C?from_h={around[0]}&to_h={around[1]}&columns=2&format=json").json()
    assert waterfall["header"]["first_set"] == rows["first_set"]
    assert alarm["raised_set_index"] in rows["first_set"]
    expect(page.locator("#waterfall .plot")).to_be_in_viewport()


def is_noted_of_now(page, api, filled):
    expect(page.locator("#notes [data-note]", has_text="bath refilled")).to_be_visible()
    note = api("/annotations").json()["items"][-1]
    now_h = api("/info").json()["as_of"]["now_h"]
    note_fields = [note[name] for name in ("author", "text", "from_h", "to_h")]
    assert note_fields == ["ann", "bath refilled", now_h, now_h]


TASKS = tomllib.loads(Path(__file__).with_name("page_tasks.toml").read_text(encoding="utf-8"))["tasks"]


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task["question"])
def test_each_task_takes_three_clicks_at_most(page, api, filled, task):
    page.evaluate(GO_TO, task.get("view", ""))
    for step in task["steps"]:
        do(page, *step.split(" ", 1))
    globals()[task["seen"]](page, api, filled)
    assert int(page.evaluate("sessionStorage.presses")) == task["clicks"] <= MOST_CLICKS
