"""Alarms and notes of an ended test: whatever an operator does is done at once, by mouse and by keys."""

import pytest
from axe_playwright_python.sync_playwright import Axe
from support.browser_pages import expect
from support.filled_folder import FilledFolder
from support.served_web import served
from support.waiting import until

from daq_service.settings.tree import Settings

pytestmark = pytest.mark.browser

N_SETS = 52


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    filled = FilledFolder(tmp_path_factory.mktemp("ended"), Settings(clock={"pace_h_per_s": 5.0}))
    for index in range(N_SETS):
        filled.add_set(index, stored=False)
    for position in "BCD":
        filled.add_alarm(position, N_SETS - 2)
    filled.add_alarm(None, N_SETS - 1, severity="low", kind="disk_space", message="little is free")
    filled.say("schedule_done", filled.due[-1].due_utc_ns)
    filled.close()
    with served(filled.settings, filled.folder) as running:
        yield running


@pytest.fixture
def page(service, open_page):
    opened = open_page(service.url)
    charts = "window.solimonDashboard.charts"
    until(lambda: opened.evaluate(f"({charts}.tof ?? {{x: []}}).x.length") > 1, "the trend is drawn")
    return opened


def alarm(page, number):
    return page.locator(f'[data-alarm="{number}"]')


def notes_drawn(page):
    ranges = page.evaluate("window.solimonDashboard.charts.tof.ranges")
    return [(one["from_h"], one["to_h"], one["word"]) for one in ranges if one["tone"] == "note"]


def test_an_acknowledgement_of_an_ended_test_is_done_at_once(page):
    alarm(page, 1).get_by_role("button", name="Acknowledge:").click()
    expect(alarm(page, 1)).to_contain_text("acknowledged by dashboard")
    expect(alarm(page, 1).get_by_role("button", name="Acknowledge")).to_have_count(0)


def test_a_note_is_made_by_keys_drawn_and_withdrawn(page):
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


def test_the_hours_shown_are_noted_by_mouse_with_what_a_person_typed(page):
    page.goto(f"{page.url.split('?')[0]}?from_h=5&to_h=10")
    page.get_by_role("button", name="Add a note").click()
    page.get_by_role("button", name="The hours shown").click()
    page.get_by_label("What is to be known").fill("<b>door</b> open")
    page.get_by_label("Position", exact=True).select_option("C")
    page.get_by_role("button", name="Save the note").click()
    expect(page.locator("#notes [data-note]")).to_contain_text("<b>door</b> open")
    expect(page.locator("#notes [data-note]")).to_contain_text("Hours 5.0 to 10.0")
    # It is C's: the charts of B are none of it.
    assert notes_drawn(page) == []
    page.locator('#tiles [data-position="C"]').click()
    until(lambda: notes_drawn(page) == [(5.0, 10.0, "<b>door</b> open")], "it is drawn at C")


def test_an_alarm_is_shelved_and_told_apart(page):
    alarm(page, 2).get_by_role("button", name="Shelve").click()
    page.keyboard.type("known leak")
    page.get_by_role("button", name="Shelve it").click()
    shelved = alarm(page, 2)
    expect(shelved).to_contain_text("by dashboard: known leak")
    expect(shelved).to_contain_text("shelved until 2024-01-")
    expect(page.locator("#alarms")).to_contain_text("1 shelved or out of service")
    expect(page.locator('#tiles [data-position="C"]')).to_contain_text("1 shelved or out of service, until")


def test_out_of_service_and_its_history_by_keys_alone(page):
    alarm(page, 3).get_by_role("button", name="Shelve").focus()
    page.keyboard.press("Enter")
    page.keyboard.type("cable is being replaced")
    page.keyboard.press("Tab")
    page.keyboard.press("End")  # until it is returned to service
    page.keyboard.press("Enter")
    page.get_by_role("button", name="Shelve it").press("Enter")
    expect(alarm(page, 3)).to_contain_text("out of service by dashboard: cable is being replaced")
    alarm(page, 3).get_by_text("History").press("Enter")
    expect(alarm(page, 3)).to_contain_text("out of service · by dashboard · cable is being replaced")


def test_what_to_do_is_told_beside_the_alarm(page):
    alarm(page, 4).get_by_text("What now").click()
    expect(alarm(page, 4)).to_contain_text("what else lies on the volume")
    expect(alarm(page, 4)).to_contain_text("Decides: who looks after the computer")


def test_the_list_is_filtered(page):
    shown = page.locator("#alarms [data-alarm]")
    expect(shown).to_have_count(4)
    page.get_by_label("Alarms by state").select_option("suppressed")
    expect(shown).to_have_count(2)
    page.get_by_label("Alarms by position").select_option("C")
    expect(shown).to_have_count(1)
    page.get_by_label("Alarms by state").select_option("all")
    page.get_by_label("Alarms by position").select_option("")
    page.get_by_label("Alarms by severity").select_option("low")
    expect(shown).to_have_count(1)
    expect(shown).to_contain_text("little is free")


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_nothing(page, theme):
    page.goto(f"{page.url.split('?')[0]}?theme={theme}")
    expect(page.locator("#notes [data-note]")).to_have_count(1)
    expect(page.locator("#alarms .shelved")).to_have_count(2)
    assert Axe().run(page).response["violations"] == []
    alarm(page, 1).get_by_role("button", name="Shelve").click()
    assert Axe().run(page, context="dialog[open]").response["violations"] == []
    page.get_by_role("button", name="Cancel").first.click()
    page.get_by_role("button", name="Add a note").click()
    assert Axe().run(page, context="dialog[open]").response["violations"] == []
