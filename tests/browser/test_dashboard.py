"""The dashboard in a headless browser: it draws the data of the API without a reload."""

import itertools
import re
import shutil
from dataclasses import replace
from urllib.parse import urlsplit

import numpy as np
import pytest
from support.browser_pages import dashboard, expect, query, watched_pages
from support.filled_folder import LIMIT_CHART, FilledFolder, filled_folder, frozen_baseline
from support.invented_rows import event_row
from support.served_web import served, served_app
from support.waiting import until

from daq_service.catalogue import SetCommit
from daq_service.corrosion_drive.charge import DriveState
from daq_service.corrosion_drive.supply_state import stamp_state, write_stored_state
from daq_service.processes.data_folder import DRIVE_FILE, hold_recorder_lock
from daq_service.processes.heartbeat import Heartbeat
from daq_service.settings.tree import Settings
from daq_service.web.app import create_app

pytestmark = pytest.mark.browser

N_SETS = 60
SENT = re.compile(r"Sent, expires in \d+ s")
SETTINGS = Settings(clock={"pace_h_per_s": 5.0})


@pytest.fixture(scope="module")
def history(tmp_path_factory):
    """Return a folder that tests only read."""
    with filled_folder(tmp_path_factory.mktemp("history"), SETTINGS) as folder:
        for index in range(N_SETS):
            folder.add_set(index, stored=False, shown=index == N_SETS - 1)
        # The limit of the chart is the baseline's.
        folder.catalogue.commit_set(SetCommit(baselines=[frozen_baseline(position) for position in "BCD"]))
    return folder.folder


@pytest.fixture
def filled(history, tmp_path):
    """Return a copy of it that a recorder continues."""
    shutil.copytree(history, tmp_path, dirs_exist_ok=True)
    with filled_folder(tmp_path, SETTINGS, exists=True) as folder:
        yield folder


@pytest.fixture(scope="module")
def historian(history):
    with hold_recorder_lock(history), served(SETTINGS, history) as running:
        yield running


@pytest.fixture
def service(filled):
    with served(filled.settings, filled.folder) as running:
        yield running


@pytest.fixture(scope="module")
def ordered(history, tmp_path_factory):
    """Return another copy, of which no test takes a set."""
    place = tmp_path_factory.mktemp("ordered") / "data"
    shutil.copytree(history, place)
    with filled_folder(place, SETTINGS, exists=True) as folder, served(SETTINGS, place) as running:
        yield folder, running


@pytest.fixture(scope="module")
def ordering(ordered, browser):
    """Yield its folder and one page for all commands that leave nothing behind."""
    folder, running = ordered
    with watched_pages(browser) as open_:
        page = open_(running.url)
        wait_for_sets(page, N_SETS)
        yield folder, page


def shown(page):
    return dashboard(page, "charts")


def wait_for_sets(page, count):
    """Wait until every chart has that many points and its fit is drawn."""
    for name in ("distance", "tof", "amplitude-ratio", "thickness"):
        expect(page.locator(f"#{name}")).to_have_attribute("data-points", str(count))
    expect(page.locator("#tof")).to_contain_text("R²")


def assert_drawn_is_the_api(page, service, position="B"):
    """Check that drawn numbers equal those of the API, scaled to the unit of the axis."""
    with service.client() as api:
        trend = api.get(f"/api/v1/trends/{position}").json()["columns"]
        wall = api.get("/api/v1/trends/A").json()["columns"]
    charts = shown(page)
    assert all(chart["drawn"] for chart in charts.values())
    for name in ("distance", "tof", "amplitudeRatio"):
        assert charts[name]["x"] == trend["due_h"]
    assert charts["distance"]["y"]["distance_squared"] == trend["distance_squared"]
    assert charts["distance"]["y"]["limit_f_predictive"] == trend["limit_f_predictive"]
    assert charts["distance"]["y"]["limit_mean_3sd"] == trend["limit_mean_3sd"]
    assert charts["chart"]["y"]["mewma_statistic"] == trend["mewma_statistic"]
    if any(value is not None for value in trend["mewma_statistic"]):
        assert set(charts["chart"]["y"]["mewma_limit"]) == {LIMIT_CHART}
    assert charts["amplitudeRatio"]["y"]["amplitude_ratio"] == trend["amplitude_ratio"]
    # The page multiplies by the same double as here: equal to the last bit.
    assert charts["tof"]["y"]["tof_pp_us"] == [value * 1e6 for value in trend["tof_pp_s"]]
    assert charts["thickness"]["x"] == wall["due_h"]
    assert charts["thickness"]["y"]["thickness_mm"] == [value * 1e3 for value in wall["thickness_m"]]
    assert charts["thickness"]["low"] == [value * 1e3 for value in wall["interval_low_m"]]


def test_history_is_drawn_as_the_api_has_it(historian, open_page):
    page = open_page(historian.url)
    wait_for_sets(page, N_SETS)
    assert_drawn_is_the_api(page, historian)
    expect(page.locator("#experiment")).to_have_text("Localized corrosion of a steel plate")
    expect(page.locator("#rig")).to_have_text("physics twin")
    expect(page.locator("#hour")).to_have_text("Hour 30.0")
    expect(page.locator("#connection")).to_have_text("Live")
    with historian.client() as api:
        fit = api.get("/api/v1/fits/B?field=tof_pp_s").json()
    chart = shown(page)["tof"]
    expected = 1e6 * np.polynomial.polynomial.polyval(np.array(chart["x"]), fit["coefficients"])
    # Horner's scheme in two languages: rounding only.
    np.testing.assert_allclose(chart["y"]["fit"], expected, rtol=1e-12)


def see_the_supply_and_climate(filled, page):
    """Check supply and climate with their quality and age."""
    strip = page.locator("#environment")
    expect(strip).to_be_hidden()
    filled.add_environment(N_SETS - 1)
    for text in ("10.00 V", "5.00 mA", "540.0 C", "21.5 °C", "read 95 s before", "Set 59, hour 30.0"):
        expect(strip).to_contain_text(text)
    expect(strip.locator('[data-quality="good"]')).to_contain_text("Supply")
    climate = strip.locator('[data-quality="stale"]')
    expect(climate).to_contain_text("Stale")
    expect(climate).to_contain_text("Relative humidity\N{EN DASH}")
    off = DriveState(tripped="no recorder was heard for 600 s", must_switch_off=True)
    write_stored_state(filled.folder, stamp_state(off, output="off", age_s=2.0))
    filled.add_environment(N_SETS)
    now = strip.locator('[data-quality="no_communication"]')
    expect(now).to_contain_text("Supply (live)")
    expect(now).to_contain_text(
        "unknown; last reading off; switch-off pending, output may be ON; tripped: no recorder"
    )
    (filled.folder / DRIVE_FILE).unlink()


def see_the_live_record(filled, page):
    filled.show_set(5)
    sequence = 100 * 5 + 2  # position B's shot of set 5
    expect(page.locator("#waveform")).to_have_attribute("data-sequence", str(sequence))
    shown_record = dashboard(page, "waveform")
    waveform = next(record for record in filled.records(5) if record.sequence == sequence).waveform
    # Two evaluations of the same linear polynomial: rounding only.
    np.testing.assert_allclose(shown_record["volts"], waveform.volts(), rtol=0, atol=1e-12)
    np.testing.assert_allclose(shown_record["micros"], 1e6 * waveform.time_s(), rtol=1e-12, atol=1e-9)
    assert shown_record["drawn"]
    readouts = page.locator("#waveform .readouts")
    expect(readouts).to_contain_text("ISW")
    psw_us = 1e6 * shown_record["header"]["marks"]["psw_time_s"]
    expect(readouts).to_contain_text(f"{psw_us:.1f} µs")


def test_new_sets_appear_without_a_reload(filled, service, open_page):
    page = open_page(service.url)
    wait_for_sets(page, N_SETS)
    page.evaluate("window.sameDocument = true")
    see_the_supply_and_climate(filled, page)
    see_the_live_record(filled, page)
    before = page.locator("#waveform").get_attribute("data-sequence")
    for index in range(N_SETS, N_SETS + 5):
        filled.add_set(index, stored=False, shown=True)
    wait_for_sets(page, N_SETS + 5)
    expect(page.locator("#waveform")).not_to_have_attribute("data-sequence", before)
    expect(page.locator("#hour")).to_have_text("Hour 32.5")
    assert page.evaluate("window.sameDocument") is True
    assert_drawn_is_the_api(page, service)


def test_a_baseline_that_is_assessed_later_is_drawn_again(tmp_path, open_page):
    """Distances of the baseline's sets become known, all at once, when it is complete."""
    with filled_folder(tmp_path) as filled:
        for index in range(3):
            filled.add_set(index, stored=False, assessed=False)
        with served(filled.settings, tmp_path) as service:
            page = open_page(service.url)
            expect(page.locator("#tof")).to_have_attribute("data-points", "3")
            expect(page.locator("#distance")).to_have_attribute("data-points", "0")
            event = event_row("baseline_frozen", "assessments", position="B", set_index=2)
            assessments = [filled.assessment("B", index, filled.due[index].due_h) for index in range(3)]
            filled.catalogue.commit_set(SetCommit(assessments=assessments, events=[event]))
            expect(page.locator("#distance")).to_have_attribute("data-points", "3")
            page.close()  # it reads fits, too


def test_an_alarm_appears_and_its_acknowledgement_becomes_a_command(filled, service, open_page):
    page = open_page(service.url)
    wait_for_sets(page, N_SETS)
    alarms = page.locator("#alarms")
    expect(alarms).to_contain_text("No alarm has been raised")
    alarm_id = filled.add_alarm("B", N_SETS - 1)
    expect(alarms).to_contain_text("B: signal change, cause undetermined")
    expect(alarms).to_contain_text("hour 30.0")
    expect(page.locator('.tile[data-position="B"]')).to_have_attribute("data-state", "alarm")
    expect(page.locator('.tile[data-position="A"]')).to_contain_text(
        re.compile(r"mm \(95 %, probe delay assumed\)")
    )
    alarms.get_by_role("button", name="Acknowledge:").click()
    acknowledging = alarms.locator('[data-focus^="ack-"]')
    expect(acknowledging).to_have_text(SENT)
    (command,) = filled.catalogue.list_open_commands()
    assert (command.kind, command.arguments["alarm_id"]) == ("acknowledge_alarm", alarm_id)
    filled.acknowledge(alarm_id, command)
    expect(alarms).to_contain_text("damage alarm, acknowledged by dashboard")
    expect(acknowledging).to_have_count(0)
    # A new set comes into the chart of the open evidence.
    alarms.get_by_role("button", name="Evidence").click()
    last = f"document.getElementById('evidence-chart-{alarm_id}')?.snapshot()?.opens.at(-1)"
    until(lambda: page.evaluate(last) == N_SETS - 1, "the sets so far are drawn")
    filled.add_set(N_SETS, stored=False)
    until(lambda: page.evaluate(last) == N_SETS, "the new one, too")


def test_an_unverified_clock_is_trusted_from_its_alarm(ordering):
    filled, page = ordering
    filled.add_alarm(None, N_SETS - 1, kind="clock_unverified")
    alarms = page.locator("#alarms")
    expect(alarms).to_contain_text("Computer clock unverified")
    alarms.get_by_role("button", name="Trust clock").click()
    expect(alarms.get_by_role("button", name="Sent")).to_be_visible()
    filled.add_alarm("B", N_SETS - 1)
    expect(alarms).to_contain_text("B: signal change")
    expect(alarms.get_by_role("button", name="Sent")).to_be_disabled()
    answer(filled, "trust_clock", {"note": ""}, state="rejected", result="nobody doubts the system's clock")
    expect(page.locator("body")).to_contain_text("nobody doubts the system's clock")
    expect(alarms.get_by_role("button", name="Trust clock")).to_be_enabled()


def test_finish_now_becomes_a_command_or_expires_on_the_page(filled, service, open_page, monkeypatch):
    page = open_page(service.url)
    notice = page.locator("#notice")

    def order():
        page.get_by_role("button", name="Skip to end").click()
        page.get_by_role("dialog").get_by_role("button", name="Skip to end").click()

    with monkeypatch.context() as late:
        late.setattr("daq_service.commands.deadline.remaining_now_s", lambda row: 0.0)
        order()
        expect(notice).to_contain_text("finish_now expired: not executed")
        expect(page.locator("#finish")).to_have_text("Skip to end")
    order()
    expect(page.locator("#finish")).to_have_text(SENT)
    # No recorder has closed the one before.
    assert [row.kind for row in filled.catalogue.list_open_commands()] == ["finish_now"] * 2
    filled.say("schedule_done", filled.due[-1].due_utc_ns)
    expect(page.locator("#connection")).to_have_text("Test finished")
    expect(page.locator("#finish")).to_be_hidden()


def answer(filled, kind, arguments, state="done", result=""):
    """Answer the one waiting command as the recorder does."""
    (command,) = filled.catalogue.list_open_commands()
    assert (command.kind, command.author, command.arguments) == (kind, "dashboard", arguments)
    filled.catalogue.finish_command(command.id, state, result)


def test_a_pause_needs_a_reason_can_be_cancelled_or_rejected_and_stays_visible(ordering):
    filled, page = ordering
    banner = page.locator("#paused")
    expect(banner).to_be_hidden()
    page.locator("#pause").click()
    page.get_by_role("button", name="Cancel").click()
    expect(page.get_by_role("dialog")).to_have_count(0)
    page.locator("#pause").click()
    page.get_by_label("Reason").fill("  ")
    page.get_by_role("button", name="Pause test").click()
    expect(page.get_by_role("dialog", name="Pause the test")).to_be_visible()
    assert filled.catalogue.list_open_commands() == []
    page.get_by_label("Reason").fill("once more")
    page.get_by_role("button", name="Pause test").click()
    expect(page.locator("#pause")).to_have_text(SENT)
    answer(filled, "pause", {"note": "once more"}, "rejected", "the test is already paused by ann")
    expect(page.locator("#notice")).to_have_text("the test is already paused by ann")
    refreshes = dashboard(page, "refreshes")
    filled.say("orders", filled.due[N_SETS - 1].due_utc_ns, text="anything new")
    until(lambda: dashboard(page, "refreshes") > refreshes, "another reading")
    expect(page.locator("#notice")).to_have_text("the test is already paused by ann")
    expect(page.locator("#pause")).to_have_text("Pause")
    page.get_by_role("button", name="Pause", exact=True).click()
    expect(page.get_by_label("Reason")).to_be_focused()
    page.keyboard.type("hands in the rig")
    page.keyboard.press("Enter")
    expect(page.locator("#pause")).to_have_text(SENT)
    answer(filled, "pause", {"note": "hands in the rig"})
    at = filled.due[N_SETS - 1].due_utc_ns
    filled.say("pause", at, paused="paused by dashboard: hands in the rig", author="dashboard")
    expect(banner).to_contain_text("Paused by dashboard: hands in the rig")
    expect(banner).to_contain_text("Nothing strikes until the test is resumed")
    expect(page.locator("#pause")).to_be_hidden()
    page.get_by_role("button", name="Resume", exact=True).click()
    expect(page.get_by_role("button", name="Cancel")).to_be_focused()
    page.get_by_role("button", name="Resume test").click()
    expect(page.locator("#resume")).to_have_text(SENT)
    answer(filled, "resume", {"note": ""})
    filled.say("resume", at, paused="", author="dashboard")
    expect(banner).to_be_hidden()
    expect(page.locator("#pause")).to_have_text("Pause")


def test_a_person_is_prompted_with_the_remaining_time(ordering, ordered, open_page):
    (filled, page), (_, service) = ordering, ordered
    banner = page.locator("#prompt")
    expect(banner).to_be_hidden()
    at = filled.due[N_SETS - 1].due_utc_ns
    shot = {"position": "C", "set_index": 3, "shot_index": 6, "attempt": 0, "within_s": 600.0}
    filled.say("asked", at, text="strike C now", **shot)
    expect(banner).to_contain_text("strike C now")
    expect(banner).to_contain_text("Position C, set 3, shot 6")
    expect(page.locator("#prompt-remaining")).to_have_text(re.compile(r"(10|9) min"))
    # A page opened later also prompts, with the remaining time.
    filled.say("orders", at + 580 * 10**9, text="anything new")
    expect(open_page(service.url).locator("#prompt-remaining")).to_have_text(re.compile(r"(20|1\d) s"))
    filled.say("asked_over", at + 581 * 10**9)
    expect(banner).to_be_hidden()


def test_a_disabled_transducer_is_shown_with_its_reason_and_enabled(ordering):
    filled, page = ordering
    expect(page.locator("#disabled")).to_be_hidden()
    filled.retire("C", N_SETS)
    expect(page.locator("#disabled")).to_contain_text("Position C: 10 sets running with nothing at C")
    tile = page.locator('.tile[data-position="C"]')
    expect(tile).to_have_attribute("data-state", "disabled")
    page.get_by_role("button", name="Enable: position C").click()
    expect(page.get_by_role("dialog", name="Enable position C")).to_contain_text("hands out of the rig")
    page.keyboard.press("Escape")
    assert filled.catalogue.list_open_commands() == []
    page.get_by_role("button", name="Enable: position C").click()
    page.get_by_role("button", name="Enable C").click()
    expect(page.locator("#disabled button")).to_have_text(SENT)
    answer(filled, "enable", {"position": "C", "note": ""})
    filled.enable("C")
    expect(page.locator("#disabled")).to_be_hidden()
    expect(tile).to_have_attribute("data-state", "normal")


def test_positions_are_chosen_by_keyboard_and_charts_read_by_it_and_as_a_table(historian, open_page):
    page = open_page(historian.url)
    wait_for_sets(page, N_SETS)
    page.locator('.tile[data-position="B"]').focus()
    page.keyboard.press("ArrowRight")
    expect(page.locator('.tile[data-position="C"]')).to_have_attribute("aria-checked", "true")
    expect(page.locator("#tof")).to_contain_text("Position C")
    expect(page.locator("#waveform-title")).to_have_text("Live waveform · C")
    assert_drawn_is_the_api(page, historian, "C")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowLeft")
    expect(page.locator("#waveform-title")).to_have_text("Live waveform · A")
    # An ultrasonic position has no solitary-wave trend: the charts stay with the last one that has.
    expect(page.locator("#tof")).to_contain_text("Position B")

    page.locator("#tof .plot").focus()
    page.keyboard.press("Home")
    expect(page.locator("#tof .readout")).to_contain_text("hour 0.5")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#tof .readout")).to_contain_text("hour 1.0")
    page.get_by_role("button", name="Table of: Time of flight").click()
    rows = page.locator("#tof tbody tr")
    expect(rows).to_have_count(N_SETS)
    with historian.client() as api:
        last = api.get("/api/v1/trends/B").json()["columns"]["tof_pp_s"][-1]
    expect(rows.first).to_contain_text(f"{1e6 * last:.3f}")


def test_a_page_that_was_opened_first_asks_for_the_first_shot_and_fills_itself(tmp_path, open_page):
    with served(Settings(), tmp_path) as service:
        page = open_page(service.url)
        expect(page.locator("#notice")).to_contain_text("Waiting for the first waveform")
        expect(page.locator("#connection")).to_have_text("Recorder not started")
        with hold_recorder_lock(tmp_path):
            Heartbeat(tmp_path, deadline_s=60.0).beat("preparing the twin: part 1 of 3, 7 s")
            expect(page.locator("#notice")).to_contain_text("Recorder: preparing the twin: part 1 of 3, 7 s.")
            expect(page.locator("#connection")).to_have_text("Live")
        filled = FilledFolder(tmp_path, Settings())
        filled.say("asked", text="strike B now", within_s=600.0)
        expect(page.locator("#prompt")).to_contain_text("strike B now")
        expect(page.locator("#notice")).to_contain_text("Recorder: waiting. The first set fills this page.")
        filled.add_set(0, stored=False, shown=True)
        expect(page.locator("#tof")).to_have_attribute("data-points", "1")
        expect(page.locator("#notice")).to_be_hidden()
        page.close()
        filled.close()


def test_tiles_are_drawn_before_other_scripts_and_answers_are_asked_for(filled, service, open_page):
    page = open_page("about:blank", name=None)
    asked, held = [], []
    page.on("request", lambda request: asked.append(urlsplit(request.url).path))

    def hold(route):  # Playwright takes no method of a list
        held.append(route)

    page.route("**/static/main.js", hold)
    with page.expect_request("**/static/main.js"):
        page.goto(f"{service.url}?position=B&set=3", wait_until="commit")
    expect(page.locator('.tile[data-position="B"] .figure')).to_have_text(re.compile(r"\d"))
    expect(page.locator('.tile[data-position="B"]')).to_contain_text(
        re.compile(r"(control chart|D²) [\d.]+, limit 59")
    )
    page.locator('.tile[data-position="C"]').click()
    before = asked.index("/static/main.js")
    assert not [path for path in asked[:before] if path.startswith("/api")]
    assert len(asked[:before]) < 15, "page, styles, icon and the tiles' own scripts"
    with page.expect_request("**/api/v1/trends/C*"):
        held[0].continue_()
    expect(page.locator('.tile[data-position="C"]')).to_have_attribute("aria-checked", "true")
    assert query(page) == {"position": "C"}
    assert "/api/v1/session" not in asked
    assert "/healthz" not in asked


def test_a_restart_of_service_and_recorder_is_shown_and_loses_no_event(filled, open_page):
    app = create_app(filled.settings, filled.folder)
    with served_app(app) as first:
        port = int(first.netloc.rpartition(":")[2])
        page = open_page(first.url, forgiven="ERR_|WebSocket")
        wait_for_sets(page, N_SETS)
    expect(page.locator("#connection")).to_have_text("Connection lost, retrying")
    expect(page.locator('.tile[data-position="B"]')).to_have_attribute("data-stale", "true")
    # No service runs: the page gets these events afterwards, the recorder's restart too.
    filled.add_set(N_SETS, stored=False)
    filled.recorder_ends()
    with filled_folder(filled.folder, SETTINGS, exists=True) as again:
        again.say("recorder_started", filled.due[N_SETS].due_utc_ns)
        again.add_alarm("B", N_SETS)
        with served(filled.settings, filled.folder, port=port):
            expect(page.locator("#connection")).to_have_text("Live")
            wait_for_sets(page, N_SETS + 1)
            until(lambda: dashboard(page, "alarms"), "the alarm of meanwhile is told")
            again.add_set(N_SETS + 1, stored=False)
            wait_for_sets(page, N_SETS + 2)
            newest = again.catalogue.last_event_id()
            until(lambda: dashboard(page, "lastEventId") == newest, "it has heard all events")
            expect(page.locator('.tile[data-position="B"]')).to_have_attribute("data-stale", "false")


WRITTEN = """() => {
  const fill = CanvasRenderingContext2D.prototype.fillText;
  window.written = [];
  CanvasRenderingContext2D.prototype.fillText = function (text, x, y, ...rest) {
    const width = this.measureText(text).width;
    const left = x - { left: 0, start: 0, center: width / 2, right: width, end: width }[this.textAlign];
    window.written.push({ text, left, right: left + width, y, chart: this.canvas.closest("[id]")?.id });
    return fill.call(this, text, x, y, ...rest);
  };
}"""


def test_labels_on_a_chart_start_at_their_hour_and_do_not_overlap(ordering):
    filled, page = ordering
    for hour, text in ((10.0, "couplant renewed"), (10.5, "door open"), (11.0, "bath refilled")):
        filled.annotate(hour, text)
    notes = "charts.tof.ranges.filter((range) => range.tone === 'note').length"
    until(lambda: dashboard(page, notes) == 3, "all notes are drawn")
    page.evaluate(WRITTEN)
    page.set_viewport_size({"width": 1300, "height": 900})  # everything is drawn again
    names = ("baseline", "couplant renewed", "door open", "bath refilled")
    seen = until(
        lambda: (
            (
                found := {
                    one["text"]: one
                    for one in page.evaluate("window.written")
                    if one["chart"] == "tof" and one["text"] in names
                }
            ).keys()
            == set(names)
            and found
        ),
        "all words are drawn",
    )
    canvas, over = (page.locator(f"#tof {part}").bounding_box() for part in ("canvas", ".u-over"))
    low, high = dashboard(page, "charts.tof.span")
    for name, hour in zip(names, (0.0, 10.0, 10.5, 11.0), strict=True):
        line = over["x"] - canvas["x"] + over["width"] * (hour - low) / (high - low)
        # Four pixels aside; lines stand on whole ones.
        assert seen[name]["left"] == pytest.approx(line + 4.0, abs=1.0)
    for a, b in itertools.combinations((seen[name] for name in names[1:]), 2):
        assert a["right"] < b["left"] or abs(a["y"] - b["y"]) > 10.0


def test_a_diagnosed_wall_is_shown_on_its_tile_with_the_chart_and_its_limit(ordering):
    filled, page = ordering
    assessment = filled.assessment("C", N_SETS - 1, 30.0)
    named = {
        "mewma_statistic": 4.0 * LIMIT_CHART,
        "mewma_alarm": True,
        "diagnosis": "wall",
        "diagnosis_probability": 0.972,
    }
    filled.catalogue.commit_set(SetCommit(assessments=[replace(assessment, set_index=N_SETS, **named)]))
    filled.add_alarm("C", N_SETS - 1)
    tile, sound = (page.locator(f'#tiles [data-position="{position}"]') for position in "CD")
    expect(tile).to_have_attribute("data-state", "alarm")
    for text in ("wall (97 %)", f"{4.0 * LIMIT_CHART:.3g}, limit {LIMIT_CHART:.3g}"):
        expect(tile).to_contain_text(text)
    expect(sound).to_have_attribute("data-state", "normal")
    expect(sound).not_to_contain_text("wall (")
    expect(sound).to_contain_text(f"limit {LIMIT_CHART:.3g}")
