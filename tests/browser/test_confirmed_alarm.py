"""From suspicion over a confirmation set to its alarm: a test that the recorder's own line took."""

import pytest
from support.browser_pages import dashboard, expect, query
from support.drifting_wall import RAISED, drifting_wall
from support.served_web import served
from support.waiting import until

pytestmark = pytest.mark.browser
SET = RAISED["B", "transducer_change"]
NAME = f"confirmation set {SET}.1"


@pytest.fixture(scope="module")
def line(tmp_path_factory):
    return drifting_wall(tmp_path_factory.mktemp("drifting"))


def test_an_alarm_leads_to_the_confirmation_set_that_suspicion_asked_for(line, open_page):
    with served(line.settings, line.folder) as service:
        page = open_page(f"{service.url}?position=B")
        until(lambda: dashboard(page, "ready"), "all that the page shows is read")
        # Suspicion asked twice: at the first set beyond the limit, and as the alarm came.
        ranges = dashboard(page, "charts.tof.ranges")
        marks = [one["from_h"] for one in ranges if one["label"] == "confirmation set"]
        assert len(marks) == 2
        card = page.locator("[data-alarm]").filter(has_text="B: signal change").first
        expect(card).to_contain_text("probable contact change (model: ")
        card.get_by_role("button", name="Evidence").click()
        expect(page.locator("dialog.details")).to_contain_text("Confirmed by the set of")
        page.keyboard.press("Escape")
        card.get_by_role("link", name=f"Open {NAME} of position B").click()
        panel = page.locator("solimon-set")
        expect(panel.get_by_role("heading", level=2)).to_contain_text(f"Position B · {NAME} · hour")
        expect(panel).to_have_attribute("data-waveforms", "3")
        assert query(page)["set"] == f"{SET}.1"
        for key, shown in (("ArrowRight", SET + 1), ("ArrowLeft", SET)):
            page.keyboard.press(key)
            expect(panel.get_by_role("heading", level=2)).to_contain_text(f"Position B · set {shown} · hour")
        page.close()
