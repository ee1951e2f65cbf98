"""Several tests: the list, the way to each and back, another test's series on the axis of this one."""

import re

import pytest
from axe_playwright_python.sync_playwright import Axe
from support.browser_pages import PHONE, dashboard, expect
from support.filled_folder import FilledFolder
from support.served_web import served_app
from support.waiting import until

from daq_service.catalogue.rows import FeatureRow
from daq_service.settings.tree import Settings
from daq_service.web.multi_test.app import create_multi_test_app

pytestmark = pytest.mark.browser

N_SETS = 6


@pytest.fixture(scope="module")
def tests(tmp_path_factory):
    """Yield a test, a copy that is a few sets further, and a missing folder."""
    place = tmp_path_factory.mktemp("many")
    found = {}
    for name, sets in (("Plate 7", N_SETS), ("Twin of plate 7", N_SETS + 3)):
        folder = place / name
        folder.mkdir()
        found[name] = FilledFolder(folder, Settings(name=name))
        for index in range(sets):
            found[name].add_set(index, stored=index == 0)
    found["Plate 7"].add_alarm("C", 4)
    found["Twin of plate 7"].say("schedule_done")
    found["Twin of plate 7"].recorder_ends()
    yield found
    for filled in found.values():
        filled.close()


@pytest.fixture(scope="module")
def service(tests, tmp_path_factory):
    folders = [filled.folder for filled in tests.values()]
    app = create_multi_test_app(
        [*folders, folders[0].parent / "unplugged"], Settings(), tmp_path_factory.mktemp("own")
    )
    with served_app(app) as running:
        yield running


def drawn(page):
    until(lambda: dashboard(page, "charts").get("tof", {"x": []})["x"], "the trend is drawn")


def test_the_list_leads_to_a_test_and_the_test_back_by_keyboard_alone(service, open_page):
    page = open_page(service.url)
    cards = page.locator(".test")
    expect(cards).to_have_count(3)
    plate, twin, unplugged = (cards.nth(k) for k in range(3))
    expect(plate.locator(".chip").first).to_have_text("Alarm")
    expect(plate.locator(".test-head")).to_contain_text("1 alarm, highest priority high")
    expect(plate.locator(".tile-age")).to_contain_text(f"Set {N_SETS - 1} · hour")
    expect(plate.locator(".test-positions > li")).to_have_count(4)
    expect(twin.locator(".test-head")).to_contain_text("Test finished")
    expect(unplugged).to_contain_text("Folder not found")
    expect(unplugged.locator(".test-remedy")).to_contain_text("Mount its disk")
    expect(unplugged.locator("a")).to_have_count(0)
    for key in ("Tab", "Enter", "Tab"):  # over the link that skips to the tests
        page.keyboard.press(key)
    expect(plate.locator("a")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.locator("#experiment")).to_have_text("Plate 7")
    drawn(page)
    assert page.url.startswith(f"{service.url}tests/plate-7/")
    until(lambda: dashboard(page, "connected"), "events come from below the test's name")
    page.locator("#all-tests").focus()
    page.keyboard.press("Enter")
    expect(page.locator(".test")).to_have_count(3)


def test_the_list_has_no_violation_of_accessibility_and_fits_a_phone(service, open_page):
    page = open_page(service.url)
    expect(page.locator(".test")).to_have_count(3)
    for scheme in ("dark", "light"):
        page.emulate_media(color_scheme=scheme)
        assert Axe().run(page).response["violations"] == []
    page.set_viewport_size(PHONE)
    until(lambda: page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"], "it fits")
    assert Axe().run(page).response["violations"] == []


@pytest.mark.slow
def test_a_twin_series_is_drawn_on_the_axis_of_the_test_and_opens_its_set(tests, service, open_page):
    page = open_page(f"{service.url}tests/plate-7/?position=B")
    drawn(page)
    choice = page.locator("#others select")
    expect(choice.locator("optgroup")).to_have_count(1)
    choice.select_option("twin-of-plate-7:C")
    expect(page).to_have_url(re.compile(r"compare=twin-of-plate-7:C"))
    row = page.locator("#others li[data-entry='twin-of-plate-7:C']")
    expect(row).to_contain_text("Test finished")
    expect(row).to_contain_text(re.compile(r"hour \d+\.\d · \d+\.\d h old"))
    key = "tof_pp_us twin-of-plate-7:C"
    until(lambda: key in dashboard(page, "charts")["tof"]["y"], "the twin's series is drawn")
    twin = tests["Twin of plate 7"]
    rows = [row for row in twin.catalogue.rows(FeatureRow, position="C") if row.shot_index is None]
    chart = dashboard(page, "charts")["tof"]
    values = dict(zip(chart["x"], chart["y"][key], strict=True))
    assert {row.due_h: pytest.approx(1e6 * row.tof_pp_s) for row in rows} == values
    own = dict(zip(chart["x"], chart["y"]["tof_pp_us"], strict=True))
    assert [hour for hour, value in own.items() if value is not None] == [d.due_h for d in twin.due[:N_SETS]]
    expect(page.locator("#tof .legend")).to_contain_text("time of flight twin-of-plate-7 C")
    expect(page.locator("#tof .legend path[stroke-dasharray='5 4']")).to_have_count(1)
    expect(page.locator("#tof .card-head p")).to_contain_text("each from its own hour 0")
    assert Axe().run(page).response["violations"] == []
    page.reload()
    until(lambda: key in dashboard(page, "charts")["tof"]["y"], "the address brings it back")
    page.locator("#tof .plot").scroll_into_view_if_needed()
    over = page.locator("#tof .u-over")
    # While other series come the plot is made again: there is none for a moment.
    box = until(over.bounding_box, "the plot is there")
    low, high = dashboard(page, "charts.tof.span")
    last = N_SETS + 2  # only the twin has got there
    over.click(
        position={"x": box["width"] * (twin.due[last].due_h - low) / (high - low), "y": box["height"] / 2}
    )
    expect(page).to_have_url(re.compile(rf"/tests/twin-of-plate-7/\?position=C&set={last}$"))
    expect(page.locator("#experiment")).to_have_text("Twin of plate 7")
    page.go_back()
    page.locator("#others").get_by_role("button", name="Remove twin-of-plate-7 C").click()
    until(lambda: key not in dashboard(page, "charts")["tof"]["y"], "it is taken out")
    expect(page.locator("#others li")).to_have_count(0)


def test_another_test_that_cannot_be_shown_is_reported_in_the_list(service, open_page):
    page = open_page(f"{service.url}tests/plate-7/?position=B&compare=unplugged:B,nobody:B,C")
    drawn(page)
    rows = page.locator("#others li")
    expect(rows).to_have_count(2)
    expect(rows.nth(0)).to_contain_text("not updating: There is no data folder")
    expect(rows.nth(1)).to_contain_text("not updating: this service has no nobody B")
    assert list(dashboard(page, "charts")["tof"]["y"])[:2] == ["tof_pp_us", "tof_pp_us C"]


def test_a_hidden_page_leaves_its_connection_to_others_and_misses_nothing(tests, service, open_page):
    filled, streams = tests["Plate 7"], service.app.state.tests.count_streams
    page = open_page(f"{service.url}tests/plate-7/?position=B")
    drawn(page)

    def hide(hidden):
        page.evaluate(
            "hidden => { Object.defineProperty(document, 'hidden', { value: hidden, configurable: true });"
            " document.dispatchEvent(new Event('visibilitychange')); }",
            hidden,
        )

    until(lambda: streams() == 1, "the page follows the test")
    hide(True)
    # The service notices a closed connection when it sends again.
    until(lambda: (filled.say("nothing"), streams())[1] == 0, "the connection is free")
    newest = filled.say("nothing")
    hide(False)
    until(lambda: dashboard(page, "lastEventId") == newest, "what came meanwhile is told")
    assert dashboard(page, "connected")
