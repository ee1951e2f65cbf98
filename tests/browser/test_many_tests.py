"""Several tests: the list, the way to each and back, another test's series on the axis of this one."""

import pytest
from axe_playwright_python.sync_playwright import Axe
from support.browser_pages import PHONE, expect
from support.filled_folder import FilledFolder
from support.served_web import served_app
from support.waiting import until

from daq_service.settings.tree import Settings
from daq_service.web.many.app import create_app_of_many

pytestmark = pytest.mark.browser

N_SETS = 6


@pytest.fixture(scope="module")
def tests(tmp_path_factory):
    """A test, its twin that is a few sets further, and a folder that is not there."""
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
    app = create_app_of_many(
        [*folders, folders[0].parent / "unplugged"], Settings(), tmp_path_factory.mktemp("own")
    )
    with served_app(app) as running:
        yield running


def dashboard(page, what):
    return page.evaluate(f"window.solimonDashboard.{what}")


def drawn(page):
    until(lambda: dashboard(page, "charts").get("tof", {"x": []})["x"], "the trend is drawn")


def test_the_list_leads_to_a_test_and_the_test_back_by_keyboard_alone(service, open_page):
    page = open_page(service.url)
    cards = page.locator(".test")
    expect(cards).to_have_count(3)
    plate, twin, unplugged = (cards.nth(k) for k in range(3))
    expect(plate.locator(".chip").first).to_have_text("Alarm")
    expect(plate.locator(".test-head")).to_contain_text("1 alarm, worst high")
    expect(plate.locator(".tile-age")).to_contain_text(f"set {N_SETS - 1} of hour")
    expect(plate.locator(".test-positions > li")).to_have_count(4)
    expect(twin.locator(".test-head")).to_contain_text("Test finished")
    expect(unplugged).to_contain_text("Folder not there")
    expect(unplugged.locator(".test-remedy")).to_contain_text("Mount its disk")
    expect(unplugged.locator("a")).to_have_count(0)
    page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    expect(plate.locator("a")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.locator("#experiment")).to_have_text("Plate 7")
    drawn(page)
    assert page.url.startswith(f"{service.url}tests/plate-7/")
    until(lambda: dashboard(page, "connected"), "events come from below the test's name")
    page.locator("#all-tests").focus()
    page.keyboard.press("Enter")
    expect(page.locator(".test")).to_have_count(3)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_list_has_no_violation_of_accessibility(service, open_page, scheme):
    page = open_page(service.url)
    page.emulate_media(color_scheme=scheme)
    expect(page.locator(".test")).to_have_count(3)
    assert Axe().run(page).response["violations"] == []


def test_the_list_fits_a_phone(service, open_page):
    page = open_page(service.url, viewport=PHONE)
    expect(page.locator(".test")).to_have_count(3)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    assert Axe().run(page).response["violations"] == []
