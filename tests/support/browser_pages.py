"""Assertions on a page that wait until they hold, and how large a window is."""

from __future__ import annotations

from typing import Any

from support.served_web import DEADLINE_S

DESK = {"width": 1440, "height": 900}
PHONE = {"width": 390, "height": 844}


def expect(locator: Any, *, within_s: float = DEADLINE_S) -> Any:
    """Playwright's `expect`, imported only where a browser test runs."""
    from playwright.sync_api import expect as expect_

    expect_.set_options(timeout=1000 * within_s)
    return expect_(locator)
