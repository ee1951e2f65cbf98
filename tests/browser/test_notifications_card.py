"""Notifications on the page: status of receivers, a test message by keyboard, the log; read by everybody."""

import pytest
from axe_playwright_python.sync_playwright import Axe
from support.browser_pages import expect
from support.filled_folder import FilledFolder
from support.receivers import http_receiver
from support.reported_alarms import notifying
from support.served_web import served

pytestmark = pytest.mark.browser


def test_a_receiver_is_tried_by_keyboard_and_a_dead_one_is_a_warning(tmp_path, open_page, monkeypatch):
    monkeypatch.setenv("DUTY_SECRET", "correct-horse-battery-staple")
    with http_receiver() as receiver:
        settings = notifying({"duty": {"url": receiver.url, "secret_env": "DUTY_SECRET"}})
        filled = FilledFolder(tmp_path, settings)
        filled.add_set(0, stored=False, shown=True)
        with served(settings, tmp_path) as service:
            page = open_page(service.url)
            card = page.locator("#notifications")
            expect(card).to_contain_text("Ready")
            button = card.get_by_role("button", name="Send test message to duty")
            button.focus()
            page.keyboard.press("Enter")
            expect(card).to_contain_text("Test message accepted after")
            assert receiver.next().message["title"].startswith("TEST, no alarm")
            expect(button).to_be_focused()
            card.locator("summary").press("Enter")
            expect(card.locator("tbody tr").first).to_contain_text("tested")
            state = service.app.state.context.notifications.queues["duty"].state
            state.failing_since_utc_ns = 1_700_000_000 * 10**9
            state.last_failure = "no answer within 15 s"
            page.reload()
            expect(card).to_contain_text("Unreachable")
            expect(card).to_contain_text("no answer within 15 s. Messages wait")
            for theme in ("light", "dark"):
                page.emulate_media(color_scheme=theme)
                found = Axe().run(page, "#notifications")
                assert found.violations_count == 0, found.generate_report()
            page.close()  # it would miss the service
        filled.close()
