"""Alarms and notes of an ended test: each operation is executed at once, by mouse and by keyboard."""

import pytest
from axe_playwright_python.sync_playwright import Axe
from support.browser_pages import dashboard, expect, show, watched_pages
from support.filled_folder import filled_folder
from support.served_web import served
from support.waiting import until

from daq_service.settings.tree import Settings

pytestmark = pytest.mark.browser

N_SETS = 52


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    with filled_folder(
        tmp_path_factory.mktemp("ended"), Settings(clock={"pace_h_per_s": 5.0}), sets=N_SETS
    ) as filled:
        for position in "BCD":
            filled.add_alarm(position, N_SETS - 2)
        filled.add_alarm(None, N_SETS - 1, priority="low", kind="disk_space")
        thin = {"set_index": N_SETS - 2, "thickness_m": 6.2e-3, "limit_m": 6.3e-3, "rule": {"k": 3, "n": 5}}
        filled.add_alarm("A", N_SETS - 2, kind="thickness_low", evidence=thin)
        poor = {"set_index": N_SETS - 2, "consecutive_poor_sets": 2, "minimum_valid_shots": 7}
        filled.add_alarm("D", N_SETS - 2, kind="few_valid_shots", priority="medium", evidence=poor)
        hole = {"set_index": N_SETS - 2, "shots_without_psw": 10, "rule": {"shots": 7, "consecutive_sets": 2}}
        filled.add_alarm("C", N_SETS - 2, kind="no_reflection", evidence=hole)
        filled.say("schedule_done", filled.due[-1].due_utc_ns)
    with served(filled.settings, filled.folder) as running:
        yield running


def drawn_page(open_, url, **options):
    page = open_(url, **options)
    until(lambda: dashboard(page, "charts.tof?.x.length > 1"), "the trend is drawn")
    return page


@pytest.fixture(scope="module")
def page(service, browser):
    """Yield one page for all tests."""
    with watched_pages(browser) as open_:
        yield drawn_page(open_, service.url)


def alarm(page, number):
    return page.locator(f'[data-alarm="{number}"]')


def open_details(page, number, name):
    """Open a dialog of an alarm and return it."""
    alarm(page, number).get_by_role("button", name=name).click()
    details = page.locator("dialog.details")
    expect(details).to_be_visible()
    return details


def notes_drawn(page):
    ranges = dashboard(page, "charts.tof.ranges")
    return [(one["from_h"], one["to_h"], one["label"]) for one in ranges if one["tone"] == "note"]


def test_a_note_is_added_by_keyboard_drawn_and_withdrawn(page):
    page.locator("#tof .plot").focus()
    page.keyboard.press("Home")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("n")
    page.keyboard.type("couplant renewed")
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    note = page.locator("#notes [data-note]")
    expect(note).to_have_count(1)
    expect(note).to_contain_text("couplant renewed")
    expect(note).to_contain_text("Hour 1.0")
    until(lambda: notes_drawn(page) == [(1.0, 1.0, "couplant renewed")], "the charts show it")
    note.get_by_role("button", name="Withdraw").focus()
    page.keyboard.press("Enter")
    expect(note).to_have_count(0)
    until(lambda: notes_drawn(page) == [], "the charts show it no more")


def test_the_visible_range_is_annotated_by_mouse_with_a_typed_note(page):
    show(page, "?from_h=5&to_h=10")
    page.get_by_role("button", name="Add note").click()
    page.get_by_role("button", name="Visible range").click()
    page.get_by_label("Note", exact=True).fill("<b>door</b> open")
    page.get_by_label("Position", exact=True).select_option("C")
    page.get_by_role("button", name="Save note").click()
    expect(page.locator("#notes [data-note]")).to_contain_text("<b>door</b> open")
    expect(page.locator("#notes [data-note]")).to_contain_text("Hours 5.0 to 10.0")
    # It is C's: the charts of B are none of it.
    assert notes_drawn(page) == []
    page.locator('#tiles [data-position="C"]').click()
    until(lambda: notes_drawn(page) == [(5.0, 10.0, "<b>door</b> open")], "it is drawn at C")


def test_out_of_service_and_its_history_by_keys_alone(page):
    alarm(page, 3).get_by_role("button", name="Take out of service").focus()
    page.keyboard.press("Enter")
    page.keyboard.type("cable is being replaced")
    page.keyboard.press("Enter")
    state = "out of service by dashboard: cable is being replaced"
    expect(alarm(page, 3)).to_contain_text(state)
    expect(page.get_by_role("list", name="Shelved and out of service")).to_contain_text(state)
    history = open_details(page, 3, "History")
    expect(history).to_contain_text("taken out of service · by dashboard · cable is being replaced")
    page.keyboard.press("Escape")
    expect(alarm(page, 3).get_by_role("button", name="History")).to_be_focused()


def test_the_actions_are_shown_with_the_alarm(page):
    details = open_details(page, 4, "What to do")
    expect(details).to_contain_text("Means: ")
    expect(details.locator("li")).not_to_have_count(0)
    expect(details).to_contain_text("Contact: ")
    page.keyboard.press("Escape")


def test_the_evidence_has_sentences_and_a_figure_that_opens_each_set(service, open_page):
    page = drawn_page(open_page, service.url, forgiven="404")  # no record of the sets is stored
    positions = (
        "[...document.querySelectorAll('#alarms [data-alarm], main > *, .grid > *')].map("
        "(one) => JSON.stringify(one.getBoundingClientRect()))"
    )
    until(lambda: dashboard(page, "ready"), "all that the page shows is read")
    alarm(page, 1).get_by_role("button", name="Evidence").scroll_into_view_if_needed()
    before = page.evaluate(positions)
    assert len(before) > 20
    box = open_details(page, 1, "Evidence")
    # The same numbers as in the sentences of `describe_evidence`.
    expect(box).to_contain_text("30.5")
    expect(box).to_contain_text("70 %")
    drawn = "document.getElementById('evidence-chart-1')?.snapshot()"
    until(lambda: page.evaluate(f"{drawn}?.drawn"), "the sets around the alarm are drawn")
    assert page.evaluate(positions) == before, "nothing has moved"
    asked = "fetch('/api/v1/assessments?position=B&limit=1000').then((answer) => answer.json())"
    rows = {row["set_index"]: row for row in page.evaluate(asked)["items"]}
    shown = page.evaluate(drawn)
    # The alarm is of the last set but one: twelve before it, and what there is behind.
    assert shown["opens"] == list(range(N_SETS - 14, N_SETS))
    assert shown["y"]["assessed"] == [rows[index]["distance_squared"] for index in shown["opens"]]
    assert set(shown["y"]["limit"]) == {24.3}
    links = box.locator(".evidence-sets a")
    # The baseline's sets are not assessed: three are, and that of the alarm is the last of them.
    assessed = [rows[index] for index in (N_SETS - 4, N_SETS - 3, N_SETS - 2)]
    link_texts = links.all_inner_texts()
    assert [text.partition(":")[0] for text in link_texts] == [
        f"Set {row['set_index']}, hour {row['due_h']:.1f}" for row in assessed
    ]
    assert [text.endswith(", outside the limit") for text in link_texts] == [
        row["outlier"] for row in assessed
    ]
    links.first.click()
    expect(page.locator("#set")).to_have_attribute("data-set", f"B {assessed[0]['set_index']}")
    expect(box).to_be_hidden()
    open_details(page, 1, "Evidence")
    until(lambda: page.evaluate(f"{drawn}?.drawn"), "it is drawn again")
    box.locator(".evidence-box .plot").focus()
    page.keyboard.press("Home")
    page.keyboard.press("Enter")
    expect(page.locator("#set")).to_have_attribute("data-set", f"B {N_SETS - 14}")
    open_details(page, 1, "Evidence")
    box.get_by_role("button", name="Table of: Sets around the alarm at B").click()
    expect(box.locator("tbody tr")).to_have_count(14)
    box.get_by_text("Raw data").click()
    expect(box).to_contain_text('"limit_name": "f_predictive"')


@pytest.mark.parametrize(
    ("number", "column", "factor", "limit", "sets"),
    [(5, "thickness?position=A", 1e3, 6.3, 5), (6, "sets?position=D", 1, 7, 2)],
    ids=["thickness_low", "few_valid_shots"],
)
def test_the_figure_shows_the_quantity_that_the_kind_assesses(page, number, column, factor, limit, sets):
    box = open_details(page, number, "Evidence")
    drawn = f"document.getElementById('evidence-chart-{number}').snapshot()"
    expect(box.locator(".evidence-sets a")).to_have_count(sets)
    until(lambda: page.evaluate(drawn)["drawn"], "the sets around the alarm are drawn")
    items = page.evaluate(f"fetch('/api/v1/{column}&limit=1000').then((answer) => answer.json())")["items"]
    name = "thickness_m" if number == 5 else "n_valid"
    values = {item["set_index"]: item[name] * factor for item in items}
    shown = page.evaluate(drawn)
    assert shown["opens"] == list(range(N_SETS - 14, N_SETS))
    assert shown["y"]["assessed"] == pytest.approx([values[index] for index in shown["opens"]], rel=1e-12)
    assert shown["y"]["limit"] == pytest.approx([limit] * 14, rel=1e-12)
    if number == 5:
        below = sum(item["interval_high_m"] < 6.3e-3 for item in items[N_SETS - 6 : N_SETS - 1])
        assert below < sum(item["thickness_m"] < 6.3e-3 for item in items[N_SETS - 6 : N_SETS - 1])
        expect(box).to_contain_text(f"{below} of the last 5 assessed sets outside the limit")
    page.keyboard.press("Escape")


def test_the_figure_of_a_kind_without_its_own_limit_counts_nothing(page):
    box = open_details(page, 7, "Evidence")
    until(
        lambda: page.evaluate("document.getElementById('evidence-chart-7')?.snapshot().drawn"), "it is drawn"
    )
    expect(box.locator(".card-head p").first).to_have_text("Position C")
    expect(box).not_to_contain_text("assessed sets")
    page.keyboard.press("Escape")


def test_the_list_is_filtered(page):
    shown = page.locator("#alarms [data-alarm]")
    expect(shown).to_have_count(7)
    page.get_by_label("Alarms by state").select_option("suppressed")
    expect(shown).to_have_count(1)
    page.get_by_label("Alarms by position").select_option("C")
    expect(shown).to_have_count(0)
    page.get_by_label("Alarms by state").select_option("all")
    page.get_by_label("Alarms by position").select_option("")
    page.get_by_label("Alarms by priority").select_option("low")
    expect(shown).to_have_count(1)
    expect(shown).to_contain_text("Disk")
    page.get_by_label("Alarms by priority").select_option("")


def test_axe_finds_nothing_at_alarms_and_notes(page):
    show(page)
    for theme in ("dark", "light"):
        show(page, f"?theme={theme}")
        expect(page.locator("#theme")).to_have_text(f"Theme: {theme}")
        expect(page.locator("#notes [data-note]")).to_have_count(1)
        expect(page.locator("#alarms .suppressed-list li")).to_have_count(1)
        assert Axe().run(page, context="#alarms, #notes").response["violations"] == []
        box = open_details(page, 1, "Evidence")
        expect(box.locator(".evidence-sets a")).to_have_count(3)
        assert Axe().run(page, context="dialog[open]").response["violations"] == []
        page.keyboard.press("Escape")
    alarm(page, 1).get_by_role("button", name="Shelve").click()
    assert Axe().run(page, context="dialog[open]").response["violations"] == []
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Add note").click()
    assert Axe().run(page, context="dialog[open]").response["violations"] == []
