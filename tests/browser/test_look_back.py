"""Looking back: sets in depth, a zoom that stays, views as addresses, one stream for all tabs."""

import re
from dataclasses import replace
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from support.browser_pages import DESK, PHONE, at_hour, dashboard, expect, query, show, watched_pages
from support.filled_folder import LIMIT_CHART, filled_folder, frozen_baseline
from support.waiting import until

from daq_service.assessment.baseline_lifecycle import renew
from daq_service.catalogue import SetCommit
from daq_service.catalogue.rows import SetRow
from daq_service.corrosion_drive.charge import DriveState
from daq_service.corrosion_drive.supply_state import stamp_state, write_stored_state
from daq_service.settings.tree import Settings

pytestmark = pytest.mark.browser

N_SETS, SHOTS = 52, 3
STORED = {0, N_SETS - 2, N_SETS - 1}
SETTINGS = Settings(clock={"pace_h_per_s": 5.0}, ultrasound={"delay_s": 1e-6})
LAST = N_SETS - 1
OUTLIER = 49
RENEWED = 50


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """Return one test that all tests of the module extend: each adds sets and counts from there."""
    with filled_folder(tmp_path_factory.mktemp("back"), SETTINGS, shots_per_set=SHOTS) as folder:
        make_assessment = folder.assessment

        def with_an_outlier(position, index, hour):
            row = make_assessment(position, index, hour)
            if position == "D" and index >= RENEWED:
                return replace(row, in_baseline=True, mewma_statistic=None)
            if (position, index) != ("B", OUTLIER):
                return row
            return replace(row, distance_squared=400.0, outlier=True, outlier_mean_3sd=True)

        folder.assessment = with_an_outlier
        for index in range(N_SETS):
            # The ghost is some set of the baseline: all of these have their records.
            folder.add_set(index, stored=index < 48 or index in STORED, shown=index == LAST)
        folder.add_alarm("C", LAST - 1)
        folder.add_environment(LAST)
        yield folder


def wait_for(page, points=1):
    until(lambda: dashboard(page, "charts").get("tof", {"x": []})["x"][points - 1 :], "the trend is drawn")


@pytest.fixture(scope="class")
def page(service, browser):
    with watched_pages(browser) as open_:
        yield open_(service.url)


class TestSets:
    """Sets opened on one page, each from its own view."""

    def test_one_click_on_a_point_opens_its_set_with_everything_about_it(self, filled, service, page):
        show(page)
        wait_for(page)
        hour = filled.due[LAST].due_h
        page.locator("#tof .plot").scroll_into_view_if_needed()
        page.mouse.click(*at_hour(page, "tof", hour))
        panel = page.locator("#set")
        expect(panel).to_have_attribute("data-set", f"B {LAST}")
        expect(panel).to_have_attribute("data-waveforms", str(SHOTS))
        until(
            lambda: any("baseline" in label for label in dashboard(page, "set.labels")), "the ghost is drawn"
        )
        shown = dashboard(page, "set")
        waves = [record.waveform.volts() for record in filled.records(LAST) if record.key.position == "B"]
        by_label = dict(zip(shown["labels"], shown["volts"], strict=True))
        for shot, volts in enumerate(waves):
            # The same linear polynomial, evaluated twice: rounding only.
            np.testing.assert_allclose(by_label[f"shot {shot}"], volts, rtol=0, atol=1e-12)
        np.testing.assert_allclose(
            by_label["mean of the valid shots"], np.mean(waves, axis=0), rtol=0, atol=1e-12
        )
        with service.client() as api:
            (feature,) = api.get(f"/api/v1/features?position=B&set_index={LAST}").json()["items"]
            (assessment,) = api.get(f"/api/v1/assessments?position=B&set_index={LAST}").json()["items"]
        assert [mark["name"] for mark in shown["marks"]] == ["ISW", "PSW"]
        assert shown["marks"][1]["time_s"] == feature["psw_time_s"]
        assert set(shown["windows_s"]) == {"ISW", "PSW", "SSW"}
        low, high = shown["windows_s"]["PSW"]
        assert low < feature["psw_time_s"] < high
        for text in (
            f"{1e6 * feature['tof_pp_s']:.3f} µs",
            f"{assessment['distance_squared']:.3g}",
            "F limit",
            *assessment["limits"],  # every one by its name
            "21.5 °C",
            f"set_{LAST:06d}",
            "physics twin",
            "old on the test clock",
            "Quality good",
        ):
            expect(panel).to_contain_text(text)

    def test_alarms_and_rows_open_sets_and_keys_step_between_sets(self, filled, service, page):
        show(page)
        wait_for(page)
        page.get_by_role("link", name=f"Open set {LAST - 1} of position C").click()
        panel = page.locator("#set")
        expect(panel).to_have_attribute("data-set", f"C {LAST - 1}")
        expect(page.locator("#tof")).to_contain_text("Position C")
        page.keyboard.press("ArrowRight")
        expect(panel).to_have_attribute("data-set", f"C {LAST}")
        page.keyboard.press("ArrowLeft")
        expect(panel).to_have_attribute("data-set", f"C {LAST - 1}")
        page.keyboard.press("Escape")
        expect(panel).to_be_hidden()
        page.go_back()
        expect(panel).to_have_attribute("data-set", f"C {LAST - 1}")
        page.keyboard.press("Escape")
        page.get_by_role("button", name="Table of: Wall thickness").click()
        page.locator("#thickness tbody .link").first.click()
        expect(panel).to_have_attribute("data-set", f"A {LAST}")
        expect(panel).to_have_attribute("data-waveforms", "1")
        assert set(dashboard(page, "set.windows_s")) == {"first echo", "second echo"}

    def test_by_keyboard_alone_from_a_chart_into_a_set_and_back(self, filled, service, page):
        show(page)
        wait_for(page)
        page.locator("#distance .plot").focus()
        page.keyboard.press("End")
        page.keyboard.press("+")
        page.keyboard.press("+")
        low, high = dashboard(page, "charts.tof.span")
        assert high - low < 20, "zoomed by two steps, every chart"
        assert dashboard(page, "charts.distance.span") == [low, high]
        assert dashboard(page, "charts.thickness.cursor") == dashboard(page, "charts.distance.cursor")
        page.keyboard.press("Shift+ArrowLeft")
        assert dashboard(page, "charts.tof.span")[0] < low
        page.keyboard.press("0")
        assert "from_h" not in query(page)
        page.keyboard.press("End")
        page.keyboard.press("Enter")
        expect(page.locator("#set")).to_have_attribute("data-set", f"B {LAST}")
        expect(page.locator("#set-title")).to_be_focused()
        page.keyboard.press("Escape")
        expect(page.locator("#distance .plot")).to_be_focused()


def test_a_view_is_an_address_that_can_be_sent(filled, service, open_page):
    page = open_page(service.url)
    wait_for(page)
    page.get_by_role("button", name="Compare C").click()
    page.get_by_role("button", name="Relative to baseline").click()
    page.get_by_label("Time axis").select_option("utc")
    page.get_by_label("Feature of this chart").select_option("isw_fwhm_s")
    page.locator("#tof .plot").scroll_into_view_if_needed()

    def zoomed():
        # A page that still scrolls goes on scrolling: the pointer has to move after it.
        x, y = at_hour(page, "tof", 18.0)
        page.mouse.move(x - 3, y)
        page.mouse.move(x, y)
        page.mouse.wheel(0, -300)
        return "from_h" in query(page)

    until(zoomed, "the wheel has zoomed")
    page.locator("#theme").click()
    wanted = {"compare": "C", "relative": "1", "axis": "utc", "feature": "isw_fwhm_s", "theme": "light"}
    assert wanted.items() <= query(page).items()
    until(lambda: "isw_fwhm_s C" in dashboard(page, "charts.feature.y"), "the feature is drawn")
    before, sent = dashboard(page, "charts"), page.url
    # Around zero, as parts in a hundred of the baseline's mean.
    assert abs(np.mean(before["tof"]["y"]["tof_pp_us"][:48])) < 1e-9
    other = open_page(sent)
    until(lambda: dashboard(other, "charts.feature.y") == before["feature"]["y"], "it is there again")
    after = dashboard(other, "charts")
    assert after["tof"]["y"] == before["tof"]["y"]
    assert after["tof"]["span"] == before["tof"]["span"]
    expect(other.locator("#theme")).to_have_text("Theme: light")
    expect(other.locator("#tof")).to_contain_text("relative to each position's own baseline")
    page.get_by_role("button", name="Whole test").click()
    assert "from_h" not in query(page)
    page.go_back()
    assert query(page)["from_h"] == parse_qs(urlsplit(sent).query)["from_h"][0]


def test_a_zoom_outlives_twenty_new_sets(filled, service, open_page):
    page = open_page(f"{service.url}?from_h=4&to_h=12")
    wait_for(page)
    count = len(dashboard(page, "charts.tof.x"))
    for index in range(count, count + 20):
        filled.add_set(index, stored=False)
    until(lambda: len(dashboard(page, "charts.tof.x")) == count + 20, "all new sets are drawn")
    for name in ("distance", "tof", "amplitudeRatio", "thickness", "feature"):
        assert dashboard(page, f"charts.{name}.span") == [4, 12]


@pytest.mark.parametrize("tabs", [2, pytest.param(10, marks=pytest.mark.slow)])
def test_tabs_share_one_stream_and_none_freezes(filled, service, browser, tabs):
    context = browser.new_context(viewport=DESK)
    pages = [context.new_page() for _ in range(tabs)]
    for page in pages:
        page.goto(service.url)
    for page in pages:
        expect(page.locator("#connection")).to_have_text("Live")
        wait_for(page)
    with service.client() as api:
        assert api.get("/api/v1/health").json()["stream_clients"] == 1
    count = len(dashboard(pages[0], "charts.tof.x"))
    filled.add_set(count, stored=False)
    for page in pages:
        until(
            lambda page=page: len(dashboard(page, "charts.tof.x")) == count + 1, "every tab has the new set"
        )
    context.close()


def test_without_a_shared_worker_each_tab_has_its_own(filled, service, browser):
    context = browser.new_context(viewport=DESK)
    context.add_init_script("delete window.SharedWorker")
    page = context.new_page()
    page.goto(service.url)
    expect(page.locator("#connection")).to_have_text("Live")
    wait_for(page)
    count = len(dashboard(page, "charts.tof.x"))
    filled.add_set(count, stored=False)
    until(lambda: len(dashboard(page, "charts.tof.x")) == count + 1, "the new set is drawn")
    context.close()


def test_a_missing_answer_is_shown_with_the_age_of_the_data(filled, service, open_page):
    page = open_page(service.url, forgiven="ERR_")
    wait_for(page)
    page.clock.install()
    page.route(re.compile("/trends/"), lambda route: None)
    filled.add_set(len(dashboard(page, "charts.tof.x")), stored=False)
    failing = page.locator("#update-failure")
    with page.expect_request(re.compile("/trends/")):
        page.clock.run_for(1000)
    until(lambda: page.clock.run_for(1000) or failing.is_visible(), "the deadline has passed")
    expect(failing).to_contain_text("no answer within 15 s")
    expect(failing).to_contain_text(re.compile(r"were read \d+ (s|min) ago"))


def test_an_outlier_is_visible_in_its_bin_and_a_zoom_shows_single_sets(filled, service, browser):
    context = browser.new_context(viewport=DESK)
    # As a test of many sets, without recording them.
    context.route(
        re.compile("/trends/"),
        lambda route: route.continue_(url=route.request.url.replace("points=1000", "points=20")),
    )
    page = context.new_page()
    page.goto(service.url)
    until(lambda: 0 < len(dashboard(page, "charts.distance.x")) <= 20, "the test is drawn in bins")
    expect(page.locator("#tof")).to_contain_text("mean, min, max of 4 sets each")
    assert OUTLIER in dashboard(page, "charts.distance.opens")
    page.goto(f"{service.url}?from_h=23&to_h=27")
    until(
        lambda: 49 in dashboard(page, "charts.tof.opens") and 50 in dashboard(page, "charts.tof.opens"),
        "sets",
    )
    context.close()


def test_every_state_is_accessible_in_both_themes_and_fits_every_width(filled, service, open_page):
    """Retired, held, stale and lost: what is old or gone must be as readable as what is new."""
    index = 1 + filled.catalogue.rows(SetRow, position="B")[-1].set_index
    filled.retire("C", index)
    filled.add_environment(index)
    filled.say("pause", filled.due[index].due_utc_ns, paused=f"paused by ann: {'very long reason ' * 10}")
    # The experiment has gone on for hours without a set.
    filled.say("orders", filled.due[index + 40].due_utc_ns, text="anything")
    page = open_page(f"{service.url}?position=B&set={LAST}&compare=D&from_h=2&to_h=26&axis=local")
    expect(page.locator("#set")).to_have_attribute("data-waveforms", str(SHOTS))
    # The set of an address is read first: units, neighbours and baseline come after it.
    expect(page.locator("#set")).to_contain_text("Time of flight, peak to peak")
    until(lambda: any("baseline" in label for label in dashboard(page, "set.labels")), "the ghost is drawn")
    expect(page.get_by_role("button", name="Next set")).to_be_enabled()
    expect(page.locator("#paused")).to_be_visible()
    expect(page.locator("#disabled")).to_be_visible()
    expect(page.locator("#environment")).to_be_visible()
    for width in (1920, PHONE["width"]):
        page.set_viewport_size({"width": width, "height": 900})
        until(lambda width=width: page.evaluate("document.documentElement.scrollWidth") <= width, "it fits")
    for name in ("waveform", "distance", "tof", "amplitude-ratio", "thickness"):
        box = page.locator(f"#{name} canvas").bounding_box()
        assert box["width"] > 250
        assert 0 <= box["x"] <= PHONE["width"] - box["width"]
    page.set_viewport_size(DESK)
    off = DriveState(tripped="no recorder was heard")
    write_stored_state(filled.folder, stamp_state(off, output="off", age_s=2.0))
    page.reload()
    expect(page.locator("#set")).to_have_attribute("data-waveforms", str(SHOTS))
    expect(page.locator('#environment [data-quality="no_communication"]')).to_be_visible()
    expect(page.locator('#environment [data-quality="stale"]')).to_be_visible()
    expect(page.locator('.tile[data-position="B"]')).to_have_attribute("data-stale", "true")
    expect(page.locator('.tile[data-position="C"]')).to_have_attribute("data-state", "disabled")
    page.locator("#waterfall .plot").scroll_into_view_if_needed()  # what is not seen is not asked for
    until(lambda: dashboard(page, "waterfall")["ready"], "the waterfall is drawn")
    axe = Axe()
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        found = axe.run(page)
        assert found.violations_count == 0, found.generate_report()
    filled.say("resume", filled.due[index].due_utc_ns, paused="")
    filled.enable("C")


def test_the_page_is_accessible_while_it_waits_for_the_first_answer(filled, service, browser):
    context = browser.new_context(viewport=DESK)
    context.route(re.compile("/trends/"), lambda route: None)
    page = context.new_page()
    page.goto(service.url)
    expect(page.locator("#connection")).to_have_text("Live")
    expect(page.locator("#tof .plot")).to_have_attribute("aria-label", "Time of flight. Loading")
    found = Axe().run(page)
    assert found.violations_count == 0, found.generate_report()
    context.close()


def test_each_baseline_has_its_band_and_sets_are_relative_to_the_one_in_force(filled, service, open_page):
    """Position D was coupled again before set 50: its second baseline collects from there on."""
    asked = {"author": "ben", "reason": "coupled anew", "utc_ns": filled.epoch_ns}
    first = frozen_baseline("D", id=4)
    rows = renew("D", filled.settings, first, first_set=RENEWED, **asked)
    filled.catalogue.commit_set(SetCommit(baselines=[first]))
    filled.catalogue.commit_set(SetCommit(baselines=rows))
    page = open_page(f"{service.url}?position=D&relative=1")
    count = len(filled.catalogue.rows(SetRow, position="D"))
    wait_for(page, count)
    hours = [filled.due[index].due_h for index in (RENEWED, RENEWED + 47)]
    bands = [one for one in dashboard(page, "charts.tof.ranges") if one["tone"] == "good"]
    assert [(one["label"], one["from_h"], one["to_h"]) for one in bands] == [
        ("baseline 1", 0, 24.0),
        ("baseline 2", *hours),
    ]
    shown = np.array(dashboard(page, "charts.tof.y")["tof_pp_us"])
    values = np.array([filled.features("D", k, filled.due[k].due_h)["tof_pp_s"] for k in range(count)])
    # Each set by the mean of the baseline that it belongs to or is assessed by, up to rounding.
    old, new = values[:48].mean(), values[RENEWED:].mean()
    np.testing.assert_allclose(shown[:RENEWED], 100.0 * (values[:RENEWED] / old - 1.0), rtol=0, atol=1e-9)
    np.testing.assert_allclose(shown[RENEWED:], 100.0 * (values[RENEWED:] / new - 1.0), rtol=0, atol=1e-9)
    limit = dashboard(page, "charts.chart.y")["mewma_limit"]
    assert limit == [LIMIT_CHART] * RENEWED + [None] * (count - RENEWED)
    card = page.locator("#baseline")
    card.locator("summary").press("Enter")
    expect(card).to_contain_text(f"{count - RENEWED} of 48 ({RENEWED} to {RENEWED + 47})")
    expect(card).to_contain_text(f"Completehour {hours[1]:.1f}, ")


def test_disabled_and_paused_intervals_are_marked(filled, service, open_page):
    page = open_page(service.url)
    wait_for(page)
    index = len(dashboard(page, "charts.tof.x"))
    filled.retire("D", index)
    page.locator('.tile[data-position="D"]').click()
    hour = filled.due[index].due_h
    mark = {"from_h": hour, "to_h": hour, "label": "disabled", "tone": "alarm"}
    until(lambda: mark in dashboard(page, "charts.tof.ranges"), "the retirement is marked")
    filled.enable("D")
