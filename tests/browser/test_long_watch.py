"""A page that stays open: through a whole test, asleep, and on paper."""

import pytest
from support.browser_pages import DESK, dashboard, expect
from support.filled_folder import filled_folder
from support.waiting import until

from daq_service.settings.tree import Settings

pytestmark = pytest.mark.browser

SETTINGS = Settings(clock={"pace_h_per_s": 5.0})
N_SETS = 50
A4_WIDTH = 794
"""Pixels of A4 at the 96 dots per inch of CSS."""
SETS_OF_THE_PAPER = 425
LARGEST_GROWTH_BYTES = 10e6
"""What the page of a test of 350 h may take more at its end than after `N_SETS` sets."""


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """Return one test that all tests of the module extend."""
    with filled_folder(tmp_path_factory.mktemp("watched"), SETTINGS, shots_per_set=3) as folder:
        for index in range(N_SETS):
            folder.add_set(index, stored=index == N_SETS - 1)
        folder.add_alarm("C", N_SETS - 2)
        yield folder


@pytest.fixture(scope="module")
def page(service, browser):
    page = browser.new_context(viewport=DESK, color_scheme="dark").new_page()
    page.goto(f"{service.url}?position=B")
    until(lambda: n_drawn(page) >= N_SETS, "the trend is drawn")
    yield page
    page.context.close()


def n_drawn(page):
    return dashboard(page, "charts.tof?.x.length ?? 0")


def ink(page):
    return page.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--ink').trim()")


@pytest.mark.slow
def test_a_page_that_is_left_through_a_whole_test_does_not_grow(filled, page, capsys):
    devtools = page.context.new_cdp_session(page)

    def held_bytes():
        devtools.send("HeapProfiler.collectGarbage")
        return devtools.send("Runtime.getHeapUsage")["usedSize"]

    before = held_bytes()
    for index in range(n_drawn(page), SETS_OF_THE_PAPER):
        filled.add_set(index, stored=False)
        if index % 5 == 4:
            until(lambda index=index: n_drawn(page) == index + 1, "the sets are drawn")
    grown = held_bytes() - before
    with capsys.disabled():
        print(f"\n{SETS_OF_THE_PAPER} sets: the page has grown by {grown / 1e6:.2f} MB")
    assert grown < LARGEST_GROWTH_BYTES


def test_paper_is_light_says_whence_and_has_no_controls(page):
    dark = ink(page)
    page.evaluate(
        """() => addEventListener("beforeprint", () => {
            const root = getComputedStyle(document.documentElement);
            window.inkOfPaper = root.getPropertyValue("--ink").trim();
        })"""
    )
    page.pdf(format="A4")
    assert page.evaluate("window.inkOfPaper") not in {dark, "", None}
    assert ink(page) == dark, "as it was"
    page.emulate_media(media="print")
    page.set_viewport_size({"width": A4_WIDTH, "height": 1123})
    expect(page.locator("#printed")).to_contain_text(f"from {page.url}")
    expect(page.locator("#printed")).to_be_visible()
    for controls in ("#theme", "#toolbar", "#tof button"):
        expect(page.locator(controls).first).to_be_hidden()
    assert page.evaluate("document.documentElement.scrollWidth") <= A4_WIDTH
