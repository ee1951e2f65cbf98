"""What is on the screen goes to other programs: the files and the copied Python have the page's figures."""

import io

import matplotlib.image
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from support.browser_pages import DESK, PHONE, dashboard, expect, show
from support.filled_folder import filled_folder
from support.waiting import until

pytestmark = pytest.mark.browser

N_SETS, SHOTS = 52, 2
LAST = N_SETS - 1
ZOOM = "from_h=4&to_h=12"


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    with filled_folder(tmp_path_factory.mktemp("out"), shots_per_set=SHOTS) as folder:
        for index in range(N_SETS):
            folder.add_set(index, stored=index == LAST)
        yield folder


@pytest.fixture(scope="module")
def page(service, browser):
    """Yield one page for all tests: two positions, a range of hours, and a set."""
    context = browser.new_context(viewport=DESK, permissions=["clipboard-read", "clipboard-write"])
    page = context.new_page()
    page.goto(f"{service.url}?{ZOOM}&position=B&compare=C&feature=isw_fwhm_s&set={LAST}")
    until(lambda: "isw_fwhm_s C" in charts(page)["feature"]["y"], "the charts are drawn")
    until(lambda: dashboard(page, "set?.volts.length"), "the set is drawn")
    yield page
    context.close()


def charts(page):
    return dashboard(page, "charts")


def opened(page, of):
    """Return the menu with this label, opened."""
    menu = page.locator("details.export", has=page.locator(f'summary[aria-label="Export: {of}"]'))
    if menu.get_attribute("open") is None:
        menu.locator("summary").click()
    expect(menu.get_by_role("button", name="Copy as Python")).to_be_visible()
    return menu


def run_copied(page, of):
    """Copy the Python of a menu and run it; return its variables."""
    menu = opened(page, of)
    menu.get_by_role("button", name="Copy as Python").click()
    expect(menu.get_by_role("status")).to_have_text("Copied")
    copied = page.evaluate("navigator.clipboard.readText()")
    assert copied == menu.get_by_label("The same in Python").input_value()
    page.keyboard.press("Escape")
    expect(menu).not_to_have_attribute("open", "")
    namespace = {}
    exec(copied, namespace)
    return namespace


def shown(page, chart, key):
    """Return hours and values of a line of a chart within the zoom."""
    drawn = charts(page)[chart]
    return np.array(
        [
            (hour, value)
            for hour, value in zip(drawn["x"], drawn["y"][key], strict=True)
            if 4 <= hour < 12 and value is not None
        ]
    )


@pytest.mark.parametrize(
    ("chart", "of", "field", "keys", "factor"),
    [
        ("tof", "Time of flight", "tof_pp_s", {"B": "tof_pp_us", "C": "tof_pp_us C"}, 1e6),
        ("distance", "Mahalanobis squared distance", "distance_squared", {"B": "distance_squared"}, 1.0),
        ("feature", "Any feature", "isw_fwhm_s", {"B": "isw_fwhm_s", "C": "isw_fwhm_s C"}, 1e6),
        ("thickness", "Wall thickness", "thickness_m", {"A": "thickness_mm"}, 1e3),
    ],
)
def test_the_copied_python_has_the_figures_of_the_chart(page, chart, of, field, keys, factor):
    data = run_copied(page, of)["data"]
    assert set(keys) <= set(data)
    for position, key in keys.items():
        table = data[position]
        expected = shown(page, chart, key)
        assert len(expected) == 16
        # The page multiplies by the same power of ten.
        np.testing.assert_array_equal(table["due_h"], expected[:, 0])
        np.testing.assert_array_equal(table[field] * factor, expected[:, 1])
        assert set(table["quality"]) == {"good"}


@pytest.mark.parametrize(
    ("chart", "field", "factor"), [("tof", "tof_pp_s", 1e6), ("feature", "isw_fwhm_s", 1e6)]
)
def test_error_bars_begin_a_standard_error_below_the_mean(page, chart, field, factor):
    until(lambda: charts(page)[chart]["low"], "the standard errors are read")
    answer = page.evaluate("fetch('/api/v1/features?position=B&limit=1000').then((answer) => answer.json())")
    expected = [1e6 * (row[field] - row["standard_error"][field]) for row in answer["items"]]
    np.testing.assert_allclose(charts(page)[chart]["low"], expected, rtol=1e-9)


def test_a_chart_is_saved_as_a_picture(page):
    with page.expect_download() as found:
        page.get_by_role("button", name="Save as PNG: Time of flight").click()
    assert found.value.suggested_filename == "tof.png"
    picture = matplotlib.image.imread(found.value.path())
    drawn = page.locator("#tof canvas").bounding_box()
    assert picture.shape[0] > drawn["height"] + 50, "title, subtitle and names are above it"
    assert len(np.unique(picture[:20].reshape(-1, 4), axis=0)) > 2, "the title is written"


def test_the_copied_python_of_the_test_has_every_position(page):
    data = run_copied(page, "the test")
    assert set(data["assessments"]["position"]) == {"B", "C", "D"}
    assert data["features"]["due_h"].between(4, 12, inclusive="left").all()
    assert len(data["features"]) == 3 * 16


def test_the_copied_python_has_the_records_of_the_opened_set(page):
    waves = run_copied(page, "waveforms of the set")["waves"]
    drawn = dashboard(page, "set")
    by_label = dict(zip(drawn["labels"], drawn["volts"], strict=True))
    for shot in range(SHOTS):
        # The same linear polynomial, evaluated twice: rounding only.
        np.testing.assert_allclose(waves[shot], by_label[f"shot {shot}"], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_every_link_of_every_menu_leads_to_its_file(page, service):
    with service.client() as api:
        formats = api.get("/api/v1/tables").json()["formats"]
        for of, n_links in (
            ("Time of flight", 2 * len(formats)),
            ("Mahalanobis squared distance", 2 * len(formats)),
            ("waveforms of the set", len(formats) + 1),
            ("the test", (6 + 2) * len(formats) + 1),  # six tables; two of them for confirmation sets, too
        ):
            links = opened(page, of).get_by_role("link")
            addresses = [links.nth(k).get_attribute("href") for k in range(links.count())]
            assert len(set(addresses)) == n_links
            for address in addresses:
                answer = api.get(address)
                assert answer.status_code == 200, address
                assert "attachment" in answer.headers["content-disposition"]
                assert len(answer.content) > 100
            page.keyboard.press("Escape")
        assert "Position B" in api.get("/api/v1/report?from_h=4&to_h=12").text
        npz = api.get(f"/api/v1/waveforms/B?first_set={LAST}&last_set={LAST}&format=npz")
    with np.load(io.BytesIO(npz.content)) as arrays:
        assert arrays["voltage_v"].shape[0] == SHOTS


@pytest.mark.slow
def test_the_report_is_accessible_and_printable(service, open_page, tmp_path):
    target = tmp_path / "report.html"
    with service.client() as api:
        target.write_bytes(api.get("/api/v1/report").content)
    page = open_page(target.as_uri())
    found = Axe().run(page)
    assert found.violations_count == 0, found.generate_report()
    for width in (PHONE["width"], DESK["width"]):
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.pdf(prefer_css_page_size=True).startswith(b"%PDF")


def test_the_menu_works_with_the_keyboard_and_is_accessible(page):
    summary = page.locator('summary[aria-label="Export: Amplitude ratio"]')
    summary.focus()
    page.keyboard.press("Enter")
    menu = opened(page, "Amplitude ratio")
    axe = Axe()
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        found = axe.run(page, context="details.export[open]")
        assert found.violations_count == 0, found.generate_report()
    page.keyboard.press("Tab")
    expect(menu.get_by_role("link").first).to_be_focused()
    page.keyboard.press("Escape")
    expect(summary).to_be_focused()
    expect(page.locator("#set")).to_be_visible()
    page.set_viewport_size(PHONE)
    opened(page, "Amplitude ratio")
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    page.set_viewport_size(DESK)
    summary.focus()
    page.keyboard.press("Escape")


def test_without_a_clipboard_the_python_is_selected(page):
    show(page)
    page.evaluate("Object.defineProperty(navigator, 'clipboard', {value: undefined, configurable: true})")
    menu = opened(page, "Time of flight")
    menu.get_by_role("button", name="Copy as Python").click()
    expect(menu.get_by_role("status")).to_contain_text("Ctrl+C")
    code = menu.get_by_label("The same in Python")
    selected = code.evaluate("box => box.value.slice(box.selectionStart, box.selectionEnd)")
    assert selected == code.input_value()
    assert "from_h" not in selected
    page.evaluate("delete navigator.clipboard")
