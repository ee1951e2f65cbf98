"""A headless Chromium for the tests of this folder, and pages that may not complain."""

import re

import pytest
from support.browser_pages import DESK, chromium, find_browser
from support.served_web import DEADLINE_S


@pytest.fixture(scope="module")
def browser():
    try:
        find_browser()
    except FileNotFoundError as error:
        pytest.skip(str(error))
    with chromium() as running:
        yield running


@pytest.fixture
def open_page(browser):
    """Opens pages; at the end none of them may have complained."""
    contexts, complaints = [], []

    def open_(url, *, viewport=DESK, forgiven=None, name="dashboard"):
        """None as `name`: this browser has never been here."""
        context = browser.new_context(viewport=viewport)
        contexts.append(context)
        if name is not None:
            context.add_init_script(f"localStorage.setItem('solimon-name', {name!r})")
        page = context.new_page()
        page.set_default_timeout(1000 * DEADLINE_S)

        def complain(text):
            if forgiven is None or not re.search(forgiven, text):
                complaints.append(text)

        page.on("console", lambda message: message.type in {"error", "warning"} and complain(message.text))
        page.on("pageerror", lambda error: complain(str(error)))
        page.goto(url)
        return page

    yield open_
    for context in contexts:
        context.close()
    assert complaints == []
