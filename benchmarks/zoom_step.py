"""Script time of one step of zoom and of pan on the dashboard, from Chromium's own trace.

    python benchmarks/zoom_step.py [--sets 20000] [--steps 60] [--browser chromium] [--json]

A new folder (`history_at_any_zoom.fill`) is served by ``solimon serve`` and opened in a headless Chromium, as
wide as a desk's. Each step is one turn of the wheel over a chart, or one press of Shift with an arrow. Script
time is that of all functions, events, animation frames and microtasks of the page's main thread: of the step
itself, until what is there is drawn over the new hours; and with what a step that is the last one asks for
then, finer bins and the waterfall, until that is drawn, too.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from history_at_any_zoom import fill, one_position

CHART = "tof"
AFTER_MS = 400.0
ITSELF_MS = 100.0
"""Then the step is drawn, and nothing that it asks for has been asked for: that waits for 120 ms."""
SPAN = f"JSON.stringify(window.solimonDashboard.charts.{CHART}.span)"
SCRIPT = {
    "FunctionCall",
    "EvaluateScript",
    "v8.callFunction",
    "RunMicrotasks",
    "FireAnimationFrame",
    "EventDispatch",
    "TimerFire",
}
CATEGORIES = ["devtools.timeline", "v8", "blink.user_timing"]


@contextmanager
def serve_folder(folder: Path) -> Iterator[str]:
    """Serve a folder in a process of its own; yield its address."""
    config = folder / "test.json"
    config.write_text(one_position().model_dump_json(), encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "daq_service.cli",
        "serve",
        str(config),
        "--data-dir",
        str(folder),
        "--port",
        "0",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if found := re.search(r"http://\S+?(?=[\s,(]|$)", line):
                break
        else:
            raise SystemExit("the service ended before it told its address")
        yield found[0]
        process.terminate()


def script_ms(trace: dict[str, Any], within_ms: float = math.inf) -> list[float]:
    """Return milliseconds of script in each step, by the thread's own clock; nested script counts once.

    Parameters
    ----------
    within_ms
        What begins later is left out.
    """
    events = [event for event in trace["traceEvents"] if event.get("ph") in ("X", "I", "R")]
    marks = [event for event in events if event["name"].startswith("step ")]
    begins = {event["name"]: event["ts"] for event in marks if event["name"].endswith("begins")}
    taken = []
    for event in marks:
        if not event["name"].endswith("ends"):
            continue
        first, last = begins[event["name"].replace("ends", "begins")], event["ts"]
        of_page = [
            (other["tts"], other["tts"] + other["tdur"])
            for other in events
            if other["name"] in SCRIPT
            and "tdur" in other
            and other["tid"] == event["tid"]
            and first <= other["ts"] < min(last, first + 1e3 * within_ms)
        ]
        until, total = 0, 0
        for started, ended in sorted(of_page):
            total += max(0, ended - max(started, until))
            until = max(until, ended)
        taken.append(total / 1e3)
    return taken


def perform_step(page: Any, number: int, do: Callable[[], None]) -> None:
    """Perform one step, and wait until its data is drawn; a step that changes nothing does not count."""
    before = page.evaluate(SPAN)
    page.evaluate(f"performance.mark('step {number} begins')")
    do()
    page.wait_for_timeout(AFTER_MS)
    page.evaluate(f"performance.mark('step {number} ends')")
    if page.evaluate(SPAN) == before:
        raise SystemExit(f"step {number} did not move the chart from {before}")


def measure(url: str, browser: str, steps: int) -> dict[str, Any]:
    """Zoom in and out, then pan to and fro."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        page = running.new_context(viewport={"width": 1440, "height": 1000}).new_page()
        page.goto(url)
        # The page's policy forbids evaluating text within it, so it is asked from outside.
        while not page.evaluate(f"(window.solimonDashboard?.charts?.{CHART}?.x.length ?? 0) > 10"):
            page.wait_for_timeout(AFTER_MS)
        chart = page.locator(f"#{CHART} .u-over")
        chart.scroll_into_view_if_needed()
        box = chart.bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        for count in range(5):  # the wheel zooms once the pointer has moved there, after any scrolling
            page.mouse.move(x + count, y)
            page.wait_for_timeout(AFTER_MS)
        page.mouse.wheel(0, -200)
        running.start_tracing(page=page, categories=CATEGORIES)
        for number in range(steps):
            perform_step(
                page, number, lambda number=number: page.mouse.wheel(0, -100 if number % 12 < 6 else 100)
            )
        zoomed = json.loads(running.stop_tracing())
        page.mouse.wheel(0, -200)
        page.locator(f"#{CHART} .plot").focus()
        running.start_tracing(page=page, categories=CATEGORIES)
        for number in range(steps):
            key = "ArrowLeft" if number % 4 < 2 else "ArrowRight"
            perform_step(page, number, lambda key=key: page.keyboard.press(f"Shift+{key}"))
        panned = json.loads(running.stop_tracing())
        running.close()
    return {
        name: {
            "steps": steps,
            **{f"{part}_median_ms": statistics.median(taken) for part, taken in parts.items()},
            **{f"{part}_greatest_ms": max(taken) for part, taken in parts.items()},
        }
        for name, trace in (("zoom", zoomed), ("pan", panned))
        for parts in [{"step": script_ms(trace, ITSELF_MS), "last_step": script_ms(trace)}]
    }


def main() -> None:
    """Print the measurements."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr] # it is there
    parser.add_argument("--sets", type=int, default=20_000)
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--browser", default=shutil.which("chromium") or shutil.which("google-chrome"))
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    if chosen.browser is None:
        raise SystemExit("no Chromium is installed; install one, or name it with --browser")
    with tempfile.TemporaryDirectory() as name:
        fill(Path(name), chosen.sets)
        with serve_folder(Path(name)) as url:
            found = measure(url, chosen.browser, chosen.steps)
    if chosen.json:
        print(json.dumps(found))
        return
    for name, times in found.items():
        itself, last = (
            f"median {times[f'{part}_median_ms']:.1f} ms, greatest {times[f'{part}_greatest_ms']:.1f} ms"
            for part in ("step", "last_step")
        )
        print(f"{name:<6}{times['steps']} steps, script of each: {itself}; with what it asks for: {last}")


if __name__ == "__main__":
    main()
