"""A headless Chromium, pages without errors, the state of the dashboard, assertions that wait."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import parse_qs, urlsplit

from support.served_web import DEADLINE_S
from support.waiting import until

DESK = {"width": 1440, "height": 900}
PHONE = {"width": 390, "height": 844}
BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    # Another host is an error on the console, by the pages' policy too; watching each request costs more.
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE localhost",
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
    """Run a Chromium; Playwright is imported only where pages are opened."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=find_browser(), args=ARGUMENTS)
        yield running
        running.close()


@contextmanager
def watched_pages(browser: Any) -> Iterator[Callable[..., Any]]:
    """Open pages; fail at the end if one logged an error or requested another host."""
    contexts: list[Any] = []
    complaints: list[str] = []

    def open_(
        url: str,
        *,
        viewport: dict[str, int] = DESK,
        forgiven: str | None = None,
        name: str | None = "dashboard",
        **options: Any,
    ) -> Any:
        """None as `name`: this browser has never been here; `options` are Playwright's of a context."""
        context = browser.new_context(viewport=viewport, **options)
        contexts.append(context)
        if name is not None:
            context.add_init_script(f"localStorage.setItem('solimon-name', {name!r})")
        page = context.new_page()
        page.set_default_timeout(1000 * DEADLINE_S)

        def complain(text: str) -> None:
            if forgiven is None or not re.search(forgiven, text):
                complaints.append(text)

        page.on("console", lambda message: message.type in {"error", "warning"} and complain(message.text))
        page.on("pageerror", lambda error: complain(str(error)))
        page.goto(url)
        wait_for_scripts(page)
        return page

    yield open_
    for context in contexts:
        context.close()
    assert complaints == [], complaints


def show(page: Any, view: str = "") -> None:
    """Show another view on an open page by its address; opening a page takes three seconds."""
    page.mouse.move(0, 0)
    page.evaluate(
        """view => {
          document.activeElement.blur();
          scrollTo(0, 0);
          history.pushState(null, "", location.pathname + view);
          dispatchEvent(new PopStateEvent("popstate"));
        }""",
        view,
    )


def wait_for_scripts(page: Any) -> None:
    """Wait for the scripts of the dashboard, which load after its tiles are drawn."""
    there = "!document.getElementById('later') || Boolean(window.solimonDashboard)"
    until(lambda: page.evaluate(there), "the page's scripts are there")


def dashboard(page: Any, what: str) -> Any:
    """Return a state of the dashboard by its path, e.g. ``charts.tof.x``."""
    wait_for_scripts(page)
    return page.evaluate(f"window.solimonDashboard.{what}")


def query(page: Any) -> dict[str, str]:
    """Return the query of the page's address."""
    return {key: value for key, (value,) in parse_qs(urlsplit(page.url).query).items()}


def at_hour(page: Any, chart: str, hour: float, part: float = 0.5) -> tuple[float, float]:
    """Return page coordinates of an hour on a chart, once it is loaded and stable."""
    until(lambda: dashboard(page, "ready"), "all that the page shows is read")
    page.locator(f"#{chart} .plot").scroll_into_view_if_needed()
    box = page.locator(f"#{chart} .u-over").bounding_box()
    low, high = dashboard(page, f"charts.{chart}.span")
    return box["x"] + box["width"] * (hour - low) / (high - low), box["y"] + part * box["height"]


def expect(locator: Any, *, within_s: float = DEADLINE_S) -> Any:
    """Return Playwright's `expect`, imported only where a browser test runs."""
    from playwright.sync_api import expect as expect_

    expect_.set_options(timeout=1000 * within_s)
    return expect_(locator)
