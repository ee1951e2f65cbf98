"""The waterfall in a browser: its pixels against the records, its cursor, its address, pointer and keys."""

import base64
from dataclasses import replace

import numpy as np
import pytest
from support.browser_pages import PHONE, dashboard, expect, query, show, watched_pages
from support.filled_folder import filled_folder
from support.invented_rows import event_row
from support.served_web import served
from support.waiting import until

from daq_service.archive.waterfall import image as picture
from daq_service.catalogue import SetCommit
from daq_service.catalogue.rows import FeatureRow, SetRow
from daq_service.settings.tree import Settings

pytestmark = pytest.mark.browser

N_SETS, SHOTS, END_H = 24, 2, 14.0
MISSED = {9, 10, 11}
BAD = 15
SETTINGS = Settings(
    ultrasound={"delay_s": 1e-6}, schedule={"end_h": END_H, "phases": [{"until_h": END_H, "interval_h": 0.5}]}
)
# The page's map, written down again: a test that asked the page for it would find any map right.
LIGHT = {
    -1: np.array([[255, 255, 255], [120, 178, 222], [0, 82, 148], [0, 30, 66]], dtype=float),
    1: np.array([[255, 255, 255], [244, 176, 104], [186, 84, 0], [84, 26, 0]], dtype=float),
}


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    with filled_folder(tmp_path_factory.mktemp("fall"), SETTINGS, shots_per_set=SHOTS) as folder:
        commit = folder.catalogue.commit_set

        def with_a_bad_set(rows):
            rows.features = [
                replace(row, quality="bad") if (row.position, row.set_index) == ("B", BAD) else row
                for row in rows.features
            ]
            return commit(rows)

        folder.catalogue.commit_set = with_a_bad_set
        for index in range(N_SETS):
            folder.add_set(index, stored=index not in MISSED)
        folder.add_alarm("B", 20)
        assert [row.quality for row in folder.catalogue.rows(FeatureRow, position="B", set_index=BAD)] == [
            "bad"
        ] * 3
        yield folder


def shown(page):
    return dashboard(page, "waterfall")


def drawn(page, what="the waterfall is drawn"):
    until(lambda: shown(page)["ready"], what)
    return shown(page)


def pixels(page, canvas="image"):
    """Return RGBA of the canvas, shape (height, width, 4)."""
    width, height, data = page.evaluate(
        f"""() => {{
          const canvas = document.querySelector(".waterfall-{canvas}");
          const all = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
          let text = ""; for (const value of all) text += String.fromCharCode(value);
          return [canvas.width, canvas.height, btoa(text)];
        }}"""
    )
    return np.frombuffer(base64.b64decode(data), np.uint8).reshape(height, width, 4)


def value_of(rgb, limit):
    """Return the voltage of a color of the light map."""
    parts = np.linspace(0.0, 1.0, 128)
    best = (np.inf, 0.0)
    for sign, stops in LIGHT.items():
        table = np.stack([np.interp(parts * 3, np.arange(4), stops[:, c]) for c in range(3)], axis=1)
        away = np.abs(table - rgb).sum(axis=1)
        best = min(best, (away.min(), sign * parts[away.argmin()] * limit))
    assert best[0] < 3.0, "a colour of the map, but for rounding of three channels"
    return best[1]


@pytest.fixture(scope="module")
def shared(service, browser):
    """Yield a page that shows one view after the other."""
    with watched_pages(browser) as open_:
        # Only a test reads pixels back.
        page = open_(f"{service.url}?theme=light&position=B", forgiven="Canvas2D: Multiple readback")
        drawn(page)
        yield page


def light(page, position="B", **view):
    """Show a view of the light page from its first hour to its last; wait until it is drawn."""
    show(
        page, f"?theme=light&position={position}" + "".join(f"&{key}={value}" for key, value in view.items())
    )
    page.locator("#waterfall .plot").scroll_into_view_if_needed()  # what is not seen is not asked for
    align = {"first": "first_echo" if position == "A" else "isw"}.get(view.get("align"), "trigger")
    wanted = {"position": position, "align": align, "shown": "volts"}

    def is_drawn():
        state = shown(page)
        return state["ready"] and wanted.items() <= state["header"].items() and state["hours"] == [0, END_H]

    until(is_drawn, "the view is drawn")


@pytest.mark.parametrize("align", ["trigger", "first"])
def test_pixels_are_the_samples_of_the_records(filled, shared, align):
    page = shared
    light(page, align=align, hides="tracks,alarms,gaps,bad")
    view = shown(page)
    header, limit = view["header"], view["limit"]
    image = pixels(page)
    height, width, _ = image.shape
    seen = 0
    rng = np.random.default_rng(7)
    for index in range(N_SETS):
        hour = filled.due[index].due_h + 0.25
        x = int((hour - view["hours"][0]) / (view["hours"][1] - view["hours"][0]) * width)
        if index in MISSED:
            assert (image[:, x, 3] == 0).all(), "a gap stays a gap"
            continue
        records = [one.waveform for one in filled.records(index) if one.key.position == "B"]
        for y in rng.integers(2, height - 2, 12).tolist():
            # Every sample whose time lies in a cell that the pixel touches.
            per_s = (view["seconds"][1] - view["seconds"][0]) / height
            edges = (view["seconds"][0] + np.array([y, y + 1]) * per_s - header["first_s"]) / header["cell_s"]
            first, last = int(np.floor(edges[0] + 1e-6)), int(np.floor(edges[1] + 1e-6)) - 1
            cells = header["first_s"] + np.array([first, max(first, last) + 1]) * header["cell_s"]
            values = []
            for waveform in records:
                anchor = 0.0 if align == "trigger" else 50e-6
                after = waveform.time_s() - anchor
                inside = (after >= cells[0] - 1e-12) & (after < cells[1] - 1e-12)
                values.append(waveform.volts()[inside])
            samples = np.concatenate(values)
            if samples.size == 0:
                assert image[y, x, 3] == 0
                continue
            expected = samples[np.abs(samples).argmax()]
            # A step of the map is a 127th of the limit; two channels' rounding may take the next one.
            assert value_of(image[y, x, :3], limit) == pytest.approx(expected, abs=1.6 * limit / 127)
            seen += 1
    assert seen > 100


def test_aligned_pulses_are_on_one_line_for_any_trigger(filled, shared):
    page = shared
    light(page, align="first")
    view = shown(page)
    (isw, psw) = view["tracks"][:2]
    assert {value for value in isw["seconds"] if value is not None} == {0.0}
    features = {
        row.due_h: row.psw_time_s - row.isw_time_s
        for row in filled.catalogue.rows(FeatureRow, position="B", scope="set")
    }
    found = dict(zip(psw["hours"], psw["seconds"], strict=True))
    assert found == {hour: pytest.approx(value) for hour, value in features.items()}
    assert view["header"]["align"] == "isw"
    expect(page.locator("#waterfall")).to_contain_text("one set per row")


def test_the_cursor_reads_by_pointer_and_by_keys_and_opens_the_set(filled, shared):
    page = shared
    light(page)
    box = page.locator("#waterfall .plot")
    box.scroll_into_view_if_needed()
    over = page.locator(".waterfall-over").bounding_box()
    view = drawn(page)
    hour = filled.due[6].due_h + 0.1
    x = over["x"] + over["width"] * hour / view["hours"][1]
    page.mouse.move(x, over["y"] + over["height"] / 2)
    readout = page.locator("#waterfall .readout")
    expect(readout).to_contain_text("hour 3.")
    expect(readout).to_contain_text("set 6")
    expect(readout).to_contain_text(" V")
    page.mouse.move(
        over["x"] + over["width"] * (filled.due[10].due_h + 0.1) / view["hours"][1], over["y"] + 9
    )
    expect(readout).to_contain_text("no waveform")
    page.mouse.click(x, over["y"] + over["height"] / 2)
    expect(page.locator("#set")).to_have_attribute("data-set", "B 6")
    page.keyboard.press("Escape")
    box.focus()
    page.mouse.move(5, 5)
    for key in ("Home", "ArrowRight", "ArrowDown", "ArrowUp", "End", "ArrowLeft"):
        page.keyboard.press(key)
    expect(readout).to_contain_text(f"set {N_SETS - 2}")
    page.keyboard.press("Enter")
    expect(page.locator("#set")).to_have_attribute("data-set", f"B {N_SETS - 2}")
    page.keyboard.press("Escape")
    expect(box).to_be_focused()


def test_zoom_is_that_of_the_charts_and_part_of_the_address(shared, open_page):
    page = shared
    light(page)
    box = page.locator("#waterfall .plot")
    box.focus()
    page.keyboard.press("Home")
    for key in ("ArrowRight", "ArrowRight", "+", "+", "PageUp", "PageUp"):
        page.keyboard.press(key)
    until(lambda: shown(page)["ready"] and "from_wf_us" in query(page), "both axes are zoomed")
    view = shown(page)
    assert view["hours"][1] - view["hours"][0] < 14.0
    assert dashboard(page, "charts.tof.span") == view["hours"]
    whole = view["header"]["whole_s"]
    assert view["seconds"][1] - view["seconds"][0] == pytest.approx((whole[1] - whole[0]) / 2.25)
    page.get_by_label("Values of the waterfall").select_option("difference")
    page.get_by_label("Time counts from").select_option("first")
    page.get_by_role("button", name="Tracks").click()
    until(lambda: shown(page)["header"]["shown"] == "difference" and shown(page)["ready"], "it is asked for")
    wanted = {"shown": "difference", "align": "first", "hides": "tracks"}
    assert wanted.items() <= query(page).items()
    before = shown(page)
    other = open_page(page.url)
    assert drawn(other)["header"] == before["header"]
    box.scroll_into_view_if_needed()

    def wheeled():
        # A page that still scrolls goes on scrolling: the pointer has to move after it.
        over = page.locator(".waterfall-over").bounding_box()
        x, y = over["x"] + over["width"] / 2, over["y"] + over["height"] / 2
        page.mouse.move(x - 3, y)
        page.mouse.move(x, y)
        page.mouse.wheel(0, -300)

    def hours_are_zoomed():
        wheeled()
        return shown(page)["hours"] != before["hours"]

    def time_is_zoomed():
        page.keyboard.down("Shift")
        wheeled()
        page.keyboard.up("Shift")
        return shown(page)["seconds"] != shown(page)["header"]["whole_s"]

    until(hours_are_zoomed, "the wheel zooms hours")
    until(time_is_zoomed, "with Shift it zooms time")
    assert "from_wf_us" in query(page)
    page.locator("#waterfall").get_by_role("button", name="Full waveform").click()
    assert "from_wf_us" not in query(page)


def test_touch_gestures_pan_zoom_and_open(filled, service, open_page):
    address = f"{service.url}?theme=light&position=B&from_h=4&to_h=8"
    page = open_page(address, viewport=PHONE, has_touch=True)
    drawn(page)
    page.locator("#waterfall .plot").scroll_into_view_if_needed()
    over = page.locator(".waterfall-over").bounding_box()
    screen = page.context.new_cdp_session(page)

    def touch(kind, *places, area=over):
        points = [
            {"x": area["x"] + x * area["width"], "y": area["y"] + y * area["height"], "id": k}
            for k, (x, y) in enumerate(places)
        ]
        screen.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    def under(x, y):
        """Return hour and seconds at a point of the figure."""
        (from_h, to_h), (from_s, to_s) = shown(page)["hours"], shown(page)["seconds"]
        return from_h + x * (to_h - from_h), from_s + y * (to_s - from_s)

    def dragged(begin, end):
        """Drag by touch; the data stay under the fingers."""
        held = [value for place in begin for value in under(*place)]
        touch("touchStart", *begin)
        touch("touchMove", *end)
        touch("touchEnd")
        # Rounding of microseconds in the address, far below a pixel.
        wanted = pytest.approx(held, rel=1e-6, abs=1e-9)
        until(lambda: [value for place in end for value in under(*place)] == wanted, "the picture follows")

    dragged([(0.7, 0.5)], [(0.4, 0.5)])
    assert shown(page)["hours"] == pytest.approx([5.2, 9.2])
    dragged([(0.4, 0.4), (0.6, 0.6)], [(0.2, 0.3), (0.8, 0.9)])
    view = drawn(page)
    assert view["hours"][1] - view["hours"][0] == pytest.approx(4.0 / 3.0)
    assert view["seconds"][1] - view["seconds"][0] == pytest.approx(np.ptp(view["header"]["whole_s"]) / 3.0)
    # On a chart alike, and the waterfall follows.
    page.locator("#tof .u-over").scroll_into_view_if_needed()
    chart = page.locator("#tof .u-over").bounding_box()
    for kind, part in (("touchStart", 0.4), ("touchMove", 0.2)):
        touch(kind, (part, 0.5), (1.0 - part, 0.5), area=chart)
    touch("touchEnd")
    until(lambda: np.ptp(shown(page)["hours"]) == pytest.approx(4.0 / 9.0, rel=1e-3), "both are zoomed")
    page.locator("#waterfall .plot").scroll_into_view_if_needed()
    over = page.locator(".waterfall-over").bounding_box()
    hour, _ = under(0.5, 0.5)
    page.touchscreen.tap(over["x"] + 0.5 * over["width"], over["y"] + 0.5 * over["height"])
    newest = max(index for index in range(N_SETS) if filled.due[index].due_h <= hour)
    expect(page.locator("#set")).to_have_attribute("data-set", f"B {newest}")


def test_marks_are_drawn_over_it_and_can_be_switched_off(filled, shared):
    page = shared
    light(page)
    counts = {}
    for name in ("Tracks", "Alarms", "Missing sets", "Bad sets"):
        before = int((pixels(page, "over")[..., 3] > 0).sum())
        page.locator("#waterfall").get_by_role("button", name=name).click()
        counts[name] = before - int((pixels(page, "over")[..., 3] > 0).sum())
    assert all(count > 0 for name, count in counts.items() if name != "Missing sets"), counts
    assert not (pixels(page, "over")[..., 3] > 0).any()


def test_a_probe_has_a_thickness_axis_and_a_table(shared):
    page = shared
    light(page, position="A", align="first")
    box = page.locator("#waterfall .plot")
    box.focus()
    page.keyboard.press("End")
    expect(page.locator("#waterfall .readout")).to_contain_text("mm")
    page.get_by_role("button", name="Table of: Waterfall").click()
    rows = page.locator("#waterfall tbody tr")
    expect(rows).to_have_count(N_SETS - len(MISSED))
    rows.first.locator(".link").click()
    expect(page.locator("#set")).to_have_attribute("data-set", f"A {N_SETS - 1}")


def test_a_position_chosen_and_left_at_once_leaves_the_image(shared):
    light(shared)
    shared.evaluate("""() => {
      for (const position of ["C", "B"]) {
        history.pushState(null, "", `?position=${position}&theme=light`);
        dispatchEvent(new PopStateEvent("popstate"));
      }
    }""")
    assert drawn(shared, "the image of B is back")["header"]["position"] == "B"


def test_the_view_continues_while_sets_arrive(filled, shared):
    page = shared
    light(page)
    rows = shown(page)["header"]["rows"]
    n_sets = len(filled.catalogue.rows(FeatureRow, position="B", scope="set"))
    filled.add_set(n_sets)
    until(lambda: shown(page)["header"]["rows"] == rows + 1, "the new set is drawn")
    assert shown(page)["header"]["last_set"][-1] == n_sets


def test_without_tiles_the_page_fills_itself(filled, open_page, monkeypatch):
    monkeypatch.setattr(picture, "SETS_AT_ONCE", 9)
    with served(filled.settings, filled.folder) as fresh:
        # The service ends before the page does.
        page = open_page(f"{fresh.url}?position=B", forgiven="ERR_CONNECTION_REFUSED")
        until(
            lambda: shown(page)["ready"] and shown(page)["header"]["pending_sets"] == 0, "all sets are read"
        )
        header = shown(page)["header"]
        stored = [row.set_index for row in filled.catalogue.rows(SetRow, position="B") if row.file]
        assert header["first_set"] == stored
        expect(page.locator("#waterfall")).not_to_contain_text("sets are loading")


def test_no_difference_is_requested_before_a_baseline_exists(tmp_path, open_page):
    with filled_folder(tmp_path, SETTINGS) as filled:
        filled.add_set(0, assessed=False)
        with served(filled.settings, tmp_path) as fresh:
            # The service ends before the page does.
            page = open_page(f"{fresh.url}?position=B&shown=difference", forgiven="ERR_CONNECTION_REFUSED")
            empty = page.locator("#waterfall .empty")
            expect(empty).to_have_text("Position B has no baseline yet")
            event = event_row("baseline_frozen", "assessments", position="B", set_index=0)
            assessment = filled.assessment("B", 0, filled.due[0].due_h)
            filled.catalogue.commit_set(SetCommit(assessments=[assessment], events=[event]))
            until(lambda: shown(page)["ready"], "the difference is drawn once there is one")
            assert shown(page)["header"]["baseline_sets"] == 1
