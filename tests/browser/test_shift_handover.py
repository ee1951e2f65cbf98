"""Alarms between two shifts: several acknowledged at once, a handover, sound on a wall screen."""

import pytest
from axe_playwright_python.sync_playwright import Axe
from support.browser_pages import expect, wait_for_scripts
from support.filled_folder import filled_folder
from support.served_web import served
from support.waiting import until

pytestmark = pytest.mark.browser

LATER = "const now = Date.now; Date.now = () => now() + 20 * 60_000"
"""The browser's clock, 20 minutes later: beyond the absence that starts another visit."""
RECORDED = """
window.notified = [];
window.tones = 0;
window.Notification = class {
  static permission = "granted";
  static requestPermission() { return Promise.resolve("granted"); }
  constructor(title, { body }) { notified.push([title, body]); }
};
AudioScheduledSourceNode.prototype.start = () => { tones += 1; };
AudioScheduledSourceNode.prototype.stop = () => {};
"""
NOT_SECURE = "Object.defineProperty(window, 'isSecureContext', { value: false })"


@pytest.fixture
def running(tmp_path):
    """Yield a folder with a recorder, and the address of its page."""
    with filled_folder(tmp_path, sets=3) as filled, served(filled.settings, tmp_path) as service:
        yield filled, service.url


def test_all_in_view_are_acknowledged_with_one_note_but_no_critical_alarm(running, open_page):
    filled, url = running
    first, second = (filled.add_alarm(position, 2) for position in "BD")
    filled.add_alarm("C", 2)
    filled.add_alarm("B", 2, kind="no_reflection", priority="critical")
    page = open_page(url)
    all_in_view = page.get_by_role("button", name="Acknowledge all in view")
    expect(all_in_view).to_have_text("Acknowledge all in view (3, not 1 critical)")
    page.get_by_label("Alarms by priority").select_option("critical")
    expect(all_in_view).to_be_hidden()
    page.get_by_label("Alarms by priority").select_option("")
    for position, number in (("B", first), ("D", second)):
        page.get_by_label("Alarms by position").select_option(position)
        all_in_view.click()
        expect(page.get_by_role("dialog")).to_contain_text("Critical alarms remain")
        page.keyboard.type("seen at the handover")
        page.keyboard.press("Enter")
        (command,) = until(filled.catalogue.list_open_commands, "it is sent")
        assert command.arguments == {"alarm_id": number, "note": "seen at the handover"}
        filled.acknowledge(number, command)
        expect(page.locator(f'[data-alarm="{number}"]')).to_contain_text("acknowledged by dashboard: seen")


def test_the_next_shift_sees_what_changed_since_its_last_visit(running, open_page):
    filled, url = running
    before, shelved = filled.add_alarm("B", 1), filled.add_alarm("C", 1)
    page = open_page(url)
    visit = page.get_by_role("button", name="Since my last visit")
    expect(page.locator("#alarms [data-alarm]")).to_have_count(2)
    expect(visit).to_be_hidden()
    page.goto(f"{url}healthz")
    filled.add_alarm("D", 2)
    filled.shelve(shelved, "known leak", for_h=8)
    filled.say("pause", paused="paused by ben: new sensor", author="ben")
    filled.say("resume", paused="", author="ben")
    page.context.add_init_script(LATER)
    page.goto(url)
    wait_for_scripts(page)
    expect(visit).to_have_text("Since my last visit: 1 raised, 1 shelved, 2 commanded")
    page.get_by_label("Alarms by state").select_option("visit")
    expect(page.locator("#alarms [data-alarm]")).to_have_count(2)
    expect(page.locator(f'[data-alarm="{before}"]')).to_have_count(0)
    filled.add_alarm("B", 2, kind="few_valid_shots")  # while the page is open
    expect(page.locator("#alarms [data-alarm]")).to_have_count(3)
    visit.click()
    details = page.locator("dialog.details")
    lines = details.locator("li")
    expect(lines).to_have_count(5)
    for text in ("2024-01-01 01:00 UTC", ": raised", ": shelved", "resume by ben", "pause by ben"):
        expect(details).to_contain_text(text)
    assert Axe().run(page, context="dialog[open]").response["violations"] == []
    details.get_by_role("button", name="Mark as read").click()
    expect(lines).to_have_count(0)
    page.keyboard.press("Escape")
    expect(visit).to_be_hidden()


def test_sound_is_silenced_without_an_acknowledgement_and_a_new_alarm_sounds_again(running, open_page):
    filled, url = running
    page = open_page(url)
    page.context.add_init_script(RECORDED)
    page.reload()
    expect(page.locator("#alarms")).to_contain_text("No alarm has been raised")
    filled.add_alarm("B", 2)
    expect(page.locator("#alarms [data-alarm]")).to_have_count(1)
    sound = page.get_by_role("button", name="Sound and notifications")
    silence = page.get_by_role("button", name="Silence")
    assert page.evaluate("[tones, notified.length]") == [0, 0], "nobody asked for it"
    sound.click()
    expect(sound).to_have_attribute("aria-pressed", "true")
    until(lambda: page.evaluate("tones") >= 2, "the active alarm sounds")
    assert page.evaluate("notified") == []
    silence.click()
    expect(silence).to_be_hidden()
    expect(page.locator('[data-alarm="1"]')).to_contain_text("damage alarm, unacknowledged")
    filled.add_alarm("D", 2, priority="medium", message="a new alarm")
    expect(silence).to_be_visible()
    ((title, body),) = until(lambda: page.evaluate("notified"), "the browser is notified")
    assert title.startswith("[MEDIUM] D: signal change")
    assert title.endswith(page.title())
    assert body == "a new alarm"
    page.reload()
    expect(sound).to_have_attribute("aria-pressed", "true")
    sound.click()
    expect(silence).to_be_hidden()


def test_the_button_states_what_a_page_without_https_lacks(running, open_page):
    page = open_page(running[1])
    page.context.add_init_script(NOT_SECURE)
    page.reload()
    expect(page.get_by_role("button", name="Sound (notifications need HTTPS or localhost)")).to_be_visible()
    assert Axe().run(page, context="#alarms").response["violations"] == []
