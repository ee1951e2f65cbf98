"""A headless Chromium for the tests of this folder, and pages that may not complain."""

import os
import re
import shutil

import pytest
from support.browser_pages import DESK
from support.served_web import DEADLINE_S

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


def find_browser() -> str:
    path = os.environ.get("SOLIMON_TEST_BROWSER") or next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        pytest.skip(
            f"no Chromium here: none of {', '.join(BROWSERS)} is on the path (or SOLIMON_TEST_BROWSER)"
        )
    return path


@pytest.fixture(scope="module")
def browser():
    path = find_browser()
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=path, args=ARGUMENTS)
        yield running
        running.close()


@pytest.fixture
def open_page(browser):
    """Opens pages; at the end none of them may have complained."""
    contexts, complaints = [], []

    def open_(url, *, viewport=DESK, forgiven=None):
        context = browser.new_context(viewport=viewport)
        contexts.append(context)
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
