"""What a person sees at once: on a desk, on a phone and on paper, measured by position and size."""

import io
import itertools
import re
from dataclasses import replace

import pypdfium2
import pytest
from axe_playwright_python.sync_playwright import Axe
from PIL import Image
from support.browser_pages import DESK, PHONE, dashboard, expect, show, watched_pages
from support.filled_folder import LIMIT_CHART, filled_folder, frozen_baseline
from support.served_web import served
from support.waiting import until

from daq_service.catalogue import SetCommit
from daq_service.corrosion_drive.charge import DriveState
from daq_service.corrosion_drive.supply_state import stamp_state, write_stored_state
from daq_service.settings.tree import Settings

pytestmark = pytest.mark.browser

N_SETS = 60
OUTLIERS = (52, 53)
TRENDS = ("chart", "distance", "tof", "thickness")
PAPER_PX = 718
"""Width of A4 between margins of 10 mm, at 96 pixels an inch."""
ALARM_RGB = (176, 63, 0)
TRIP = "no recorder was heard for 600 s, the cell was above its highest temperature, and the cover was open"


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """Return a test with alarms at B and C, outliers at D, confirmation sets, and a supply that tripped."""
    with filled_folder(tmp_path_factory.mktemp("first"), Settings(clock={"pace_h_per_s": 5.0})) as folder:
        make_assessment = folder.assessment

        def with_outliers(position, index, hour):
            row = make_assessment(position, index, hour)
            if position == "C" and index == N_SETS - 1:
                row = replace(row, diagnosis="wall", diagnosis_probability=0.996, diagnosis_details={})
            if position == "D" and index in OUTLIERS:
                row = replace(row, distance_squared=400.0, outlier=True)
            return row

        folder.assessment = with_outliers
        for index in range(N_SETS):
            folder.add_set(index, shown=index == N_SETS - 1)
        folder.catalogue.commit_set(SetCommit(baselines=[frozen_baseline(position) for position in "BCD"]))
        for planned_set in (50, 54, 55):
            folder.add_confirmation("D", planned_set)
        folder.add_alarm("B", N_SETS - 9, evidence={"raised_by": "mewma", "limit_name": "mewma"})
        folder.add_alarm("C", N_SETS - 1, evidence={"raised_by": "diagnosis", "limit_name": "mewma"})
        folder.add_environment(N_SETS - 1)
        off = DriveState(tripped=TRIP, must_switch_off=True)
        write_stored_state(folder.folder, stamp_state(off, output="off", age_s=2.0))
        yield folder


@pytest.fixture(scope="module")
def service(filled):
    with served(filled.settings, filled.folder) as running:
        yield running


@pytest.fixture(scope="module")
def page(service, browser):
    """Yield one page for all tests: each shows its own view and size."""
    with watched_pages(browser) as open_:
        page = open_(service.url, timezone_id="Asia/Tokyo")
        until(lambda: dashboard(page, "ready"), "all that the page shows is read")
        yield page


def box(page, selector):
    """Return left, top, right and bottom of the first match, from the top of the page."""
    found = page.locator(selector).first.bounding_box()
    top = found["y"] + page.evaluate("scrollY")
    return found["x"], top, found["x"] + found["width"], top + found["height"]


def sized(page, size, view=""):
    page.set_viewport_size(size)
    show(page, view)
    until(lambda: dashboard(page, "charts.tof.drawn"), "the view is drawn")


def wait_for_waterfall(page):
    page.locator("#waterfall .plot").scroll_into_view_if_needed()  # what is not seen is not read
    until(lambda: dashboard(page, "waterfall")["ready"], "the waterfall is drawn")


def test_state_trends_and_alarms_are_on_the_first_screen(page):
    sized(page, DESK, "?position=D")
    order = [box(page, selector) for selector in (".top", "#headline", "#tiles", "#charts", "#baseline")]
    for above, below in itertools.pairwise(order):
        assert above[3] <= below[1]
    for trend in TRENDS[:2]:
        assert box(page, f"#{trend} .plot")[3] <= DESK["height"], trend
    for trend in TRENDS[2:]:
        assert box(page, f"#{trend} .u-over")[3] <= DESK["height"] + box(page, "#environment")[3], trend
    assert box(page, "#alarms .alarm")[3] <= DESK["height"]
    assert box(page, "#control")[1] >= box(page, "#charts")[3]


@pytest.mark.parametrize("width", [1440, 1920, 2560])
def test_the_header_is_one_row_that_is_centered(page, width):
    sized(page, {"width": width, "height": 900})
    # Whatever may be offered at once.
    page.evaluate("""() => {
      for (const button of document.querySelectorAll(".controls > [hidden]")) {
        button.hidden = false;
        button.dataset.shown = "";
      }
    }""")
    parts = page.locator(".brand, .clock, .controls > *").evaluate_all(
        "parts => parts.map((part) => part.getBoundingClientRect()).map((one) => (one.top + one.bottom) / 2)"
    )
    left, _, right, bottom = box(page, ".top")
    page.evaluate("() => document.querySelectorAll('[data-shown]').forEach((one) => (one.hidden = true))")
    assert len(parts) == 9
    assert max(parts) - min(parts) < 8.0, "one row"
    assert bottom < 80.0
    edges = box(page, ".brand")[0] - left, right - box(page, ".controls")[2]
    assert edges[0] == pytest.approx(edges[1], abs=1.0)
    assert edges[0] == pytest.approx(box(page, "#tiles")[0], abs=1.0)


def test_the_most_urgent_alarm_is_the_headline(filled, service, page):
    sized(page, DESK)
    headline = page.locator("#headline")
    with service.client() as api:
        alarms = {one["position"]: one for one in api.get("/api/v1/alarms").json()["items"]}
    newest = alarms["C"]
    sentence = f"{newest['headline']}, detected at hour 30.0. {newest['action']}"
    expect(headline).to_contain_text(sentence)
    expect(headline).to_contain_text("1 more active alarm")
    filled.add_alarm("A", N_SETS - 20, priority="critical", kind="thickness_low")
    expect(headline).to_contain_text("detected at hour 20.5.")
    expect(headline.locator(".chip")).to_have_text("Critical")


def test_without_an_alarm_the_headline_has_the_age_of_the_newest_set(tmp_path, open_page):
    with filled_folder(tmp_path) as folder:
        for index in range(3):
            folder.add_set(index, stored=False)
        with served(folder.settings, tmp_path) as running:
            page = open_page(running.url)
            headline = page.locator("#headline")
            expect(headline).to_contain_text(re.compile(r"No active alarm.*Newest set: hour 1\.5, .+ old\."))
            shelved = folder.add_alarm("B", 2)
            expect(headline).to_contain_text("detected at hour 1.5.")
            folder.shelve(shelved, "known", for_h=8.0)
            expect(headline).to_contain_text("1 shelved or out of service.")
            page.close()


def test_a_tile_has_the_statistic_of_its_alarm_a_sparkline_and_the_interval_of_a_thickness(filled, page):
    sized(page, DESK)
    tile = {position: page.locator(f'#tiles [data-position="{position}"]') for position in "ABCD"}
    expect(tile["C"].locator(".figure")).to_have_text("> 99 %")
    expect(tile["C"]).to_contain_text("model: wall")
    expect(tile["B"].locator(".figure")).to_have_text(re.compile(r"^[\d.]+ \S limit$"))
    expect(tile["B"]).to_contain_text(re.compile(rf"control chart [\d.]+, limit {LIMIT_CHART:g}"))
    wall = filled.thickness(N_SETS - 1, filled.due[N_SETS - 1].due_h)
    low, high = (1e3 * wall[name] for name in ("interval_low_m", "interval_high_m"))
    expect(tile["A"]).to_contain_text(f"{low:.2f} to {high:.2f} mm (95 %, probe delay assumed)")
    for one in tile.values():
        left, top, right, bottom = one.locator(".sparkline").evaluate(
            "(svg) => { const {x, y, width, height} = svg.getBBox(); return [x, y, x + width, y + height] }"
        )
        assert 0 <= left < right <= 120, "the line is within its sparkline"
        assert 0 <= top < bottom <= 36
        assert right - left > 50


def test_all_charts_of_the_page_have_one_time_axis(filled, page):
    sized(page, DESK, "?position=B")
    wait_for_waterfall(page)
    spans = {name: chart["span"] for name, chart in dashboard(page, "charts").items()}
    spans["waterfall"] = dashboard(page, "waterfall")["hours"]
    assert set(map(tuple, spans.values())) == {(0, 36)}
    lefts = {box(page, f"#{trend} .u-over")[0] - box(page, f"#{trend}")[0] for trend in TRENDS}
    assert max(lefts) - min(lefts) < 1.0


def test_confirmation_sets_are_one_entry_of_the_legend_and_outliers_have_their_color(page):
    sized(page, DESK, "?position=D&from_h=24.2&to_h=30")
    legend = page.locator("#distance .legend")
    expect(legend.get_by_text("confirmation set")).to_have_count(1)
    outlier = legend.locator("li", has_text="outlier").locator("path")
    expect(outlier).to_have_attribute("fill", "var(--data)")
    ranges = dashboard(page, "charts.distance.ranges")
    assert sum(one["label"] == "confirmation set" for one in ranges) == 3
    picture = page.locator("#distance .u-over").screenshot()
    with Image.open(io.BytesIO(picture)) as image:
        colors = {color for _, color in image.convert("RGB").getcolors(1 << 24)}
    assert ALARM_RGB not in colors, "no outlier has the color of alarms"
    assert (0, 114, 178) in colors, "points are drawn"


def test_times_follow_the_chosen_zone_in_one_format(page):
    sized(page, DESK)
    expect(page.locator("#time")).to_contain_text(re.compile(r"^2024-01-02 06:\d\d UTC"))
    page.get_by_label("Time axis").select_option("local")
    expect(page.locator("#time")).to_contain_text(re.compile(r"^2024-01-02 15:\d\d \+09:00"))
    expect(page.locator("#alarms .alarm-head").first).to_contain_text("+09:00")
    page.locator("#tof .plot").focus()
    page.keyboard.press("Home")
    expect(page.locator("#tof .readout")).to_contain_text("hour 0.5 · 2024-01-01 09:30 +09:00")
    text = page.locator("body").inner_text()
    assert not re.findall(r"\d\d:\d\d UTC|\d{4}-\d\d-\d\dT", text)


def test_on_a_phone_the_first_alarm_is_near_the_top_and_nothing_is_wider(page):
    sized(page, PHONE)
    expect(page.locator("#environment")).to_contain_text(TRIP)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    assert box(page, "#alarms .alarm")[1] < 1.5 * PHONE["height"]
    for selector in ("#environment", "#headline", *(f"#{trend}" for trend in TRENDS)):
        left, _, right, _ = box(page, selector)
        assert 0 <= left < right <= PHONE["width"], selector
    found = Axe().run(page)
    assert found.violations_count == 0, found.generate_report()


def test_printed_charts_fill_the_page_and_the_waterfall_keeps_its_image(page):
    sized(page, DESK, "?position=B&theme=dark")
    wait_for_waterfall(page)
    page.evaluate("""() => addEventListener("beforeprint", () => {
      window.onPaper = [...document.querySelectorAll("#charts > :not([hidden]) .plot")].map((plot) => {
        const canvas = plot.querySelector(".waterfall-axes, canvas").getBoundingClientRect();
        const box = plot.getBoundingClientRect();
        return [plot.closest("[id]").id, box.width, canvas.left - box.left, box.right - canvas.right];
      });
    })""")
    document = pypdfium2.PdfDocument(page.pdf(format="A4"))
    plots = page.evaluate("window.onPaper")
    assert {name for name, *_ in plots} >= {*TRENDS, "waterfall", "waveform", "amplitude-ratio"}
    for name, width, left, right in plots:
        assert PAPER_PX - 60 < width <= PAPER_PX, name
        assert abs(left) < 1.0, name
        assert abs(right) < 1.0, name
    inked = {"map": 0, "right": 0}
    for sheet in document:
        image = sheet.render(scale=96 / 72).to_pil().convert("RGB")
        edge = image.crop((image.width - 36, 0, image.width, image.height))
        inked["right"] += sum(count for count, color in edge.getcolors(1 << 24) if sum(color) < 600)
        inked["map"] += sum(
            count for count, (red, green, blue) in image.getcolors(1 << 24) if red > 150 > green > 60 > blue
        )
    document.close()
    assert inked["right"] == 0, "nothing is in the margin"
    assert inked["map"] > 2000, "the pulses of the waterfall, brown and wide"
    assert page.evaluate("document.documentElement.classList.contains('paper')") is False


def test_the_page_of_a_finished_test_has_a_last_waveform_and_nothing_stale(filled, page):
    """The last test: it ends the recording."""
    sized(page, DESK, "?position=B")
    expect(page.locator("#waveform-title")).to_have_text("Live waveform · B")
    filled.say("schedule_done", filled.due[N_SETS - 1].due_utc_ns)
    filled.recorder_ends()
    expect(page.locator("#connection")).to_have_text("Test finished")
    expect(page.locator("#waveform-title")).to_have_text("Last waveform · B")
    expect(page.locator('.tile[data-stale="true"]')).to_have_count(0)
    expect(page.locator("#tiles")).not_to_contain_text("Stale")
    expect(page.get_by_role("button", name="Strike")).to_have_count(0)
