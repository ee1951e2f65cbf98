"""A headless Chromium for the tests of this folder, and pages that may not complain."""

import pytest
from support.browser_pages import chromium, find_browser, watched_pages
from support.doubles_bench import doubles
from support.served_web import served

__all__ = ["doubles"]


@pytest.fixture(scope="package")
def browser():
    """Run one browser for all files of this folder: a start costs more than most tests."""
    try:
        find_browser()
    except FileNotFoundError as error:
        pytest.skip(str(error))
    with chromium() as running:
        yield running


@pytest.fixture
def open_page(browser):
    """Open pages; fail at the end if one of them logged an error."""
    with watched_pages(browser) as open_:
        yield open_


@pytest.fixture(scope="module")
def service(filled):
    with served(filled.settings, filled.folder) as running:
        yield running
