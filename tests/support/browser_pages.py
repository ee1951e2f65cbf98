"""A headless Chromium, assertions on a page that wait until they hold, and how large a window is."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from support.served_web import DEADLINE_S

DESK = {"width": 1440, "height": 900}
PHONE = {"width": 390, "height": 844}
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
    """Return the path of a Chromium.

    Raises
    ------
    FileNotFoundError
        There is none.
    """
    path = os.environ.get("SOLIMON_TEST_BROWSER") or next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        raise FileNotFoundError(
            f"no Chromium here: none of {', '.join(BROWSERS)} is on the path (or SOLIMON_TEST_BROWSER)"
        )
    return path


@contextmanager
def chromium() -> Iterator[Any]:
    """Run one; Playwright is imported only where pages are opened."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=find_browser(), args=ARGUMENTS)
        yield running
        running.close()


def expect(locator: Any, *, within_s: float = DEADLINE_S) -> Any:
    """Playwright's `expect`, imported only where a browser test runs."""
    from playwright.sync_api import expect as expect_

    expect_.set_options(timeout=1000 * within_s)
    return expect_(locator)
