"""A service that asks for tokens: the page's own way in and out."""

import pytest
from support.browser_pages import expect
from support.filled_folder import FilledFolder
from support.served_web import served

from daq_service.settings.tree import Settings
from daq_service.web.auth.tokens import create_token

pytestmark = pytest.mark.browser


def test_the_page_shows_nothing_until_it_has_a_token_and_keeps_it_over_a_reload(tmp_path, open_page):
    tokens = tmp_path / "tokens.json"
    _, text = create_token(tokens, "ann", "operator")
    folder = FilledFolder(tmp_path, Settings(web={"tokens_file": str(tokens)}))
    try:
        folder.add_set(0, stored=False)
        with served(folder.settings, folder.folder) as service:
            page = open_page(service.url, forgiven="401")
            dialog, tiles = page.get_by_role("dialog", name="Log in"), page.locator("#tiles [role=radio]")
            expect(dialog).to_be_visible()
            page.get_by_label("Token").fill("not one of ours")
            page.keyboard.press("Enter")
            expect(page.locator("#login-trouble")).not_to_be_empty()
            page.keyboard.press("Escape")
            expect(dialog).to_be_visible()
            expect(tiles).to_have_count(0)
            page.get_by_label("Token").fill(text)
            page.keyboard.press("Enter")
            expect(tiles).not_to_have_count(0)
            expect(page.locator("#connection")).to_have_text("Live")
            page.reload()
            expect(tiles).not_to_have_count(0)
            assert text not in page.url + str(page.evaluate("document.cookie + JSON.stringify(localStorage)"))
            page.get_by_role("button", name="Log out ann (operator)").click()
            expect(dialog).to_be_visible()
            expect(tiles).to_have_count(0)
    finally:
        folder.close()
