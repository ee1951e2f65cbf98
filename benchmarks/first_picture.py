"""First view of the dashboard in a headless Chromium: from the navigation to drawn charts, on loopback.

    python benchmarks/first_picture.py [--folder F] [--times N] [--json]

A process of its own serves the folder of a test (default: 425 sets of the paper's schedule, invented). Each
visit has a browser context of its own, so nothing is cached; "again" reloads in the same. Counted from the
start of the navigation, by the page's own clock: the first paint; tiles with values; charts with points.
Next to it stands the bare answer of the page's document.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import httpx2

TESTS = Path(__file__).parents[1] / "tests"
sys.path.insert(0, str(TESTS))  # the invented test and the browser are those of the tests
from support.browser_pages import DESK, chromium  # noqa: E402
from support.filled_folder import FilledFolder  # noqa: E402

from daq_service.settings.tree import Settings  # noqa: E402

SETS, STORED = 425, 48
"""Of the paper's test; records are stored of the baseline's sets."""
SERVER = """
import sys, threading
from pathlib import Path
from daq_service.settings.tree import Settings
from daq_service.web.app import create_app
from daq_service.web.server import serve
stop = threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), stop.set()), daemon=True).start()
app = create_app(Settings(), Path(sys.argv[1]))
serve(app, "127.0.0.1", 0, on_bound=lambda url: print(url, flush=True), stop=stop)
"""
WATCH = """
const seen = {};
let tell;
window.allSeen = new Promise((resolve) => (tell = resolve));
const look = () => {
  const board = window.solimonDashboard;
  const now = performance.now();
  if (!seen.tiles && document.querySelector(".tile[data-state]:not([data-state=''])")) seen.tiles = now;
  const charts = board ? Object.values(board.charts) : [];
  if (charts.length && charts.every((chart) => chart.drawn)) {
    seen.charts = now;
    const paints = performance.getEntriesByType("paint");
    seen.paint = paints.find((one) => one.name === "first-contentful-paint")?.startTime ?? null;
    return tell(seen);
  }
  requestAnimationFrame(look);
};
requestAnimationFrame(look);
"""
WHAT = {"paint": "first paint", "tiles": "tiles with values", "charts": "every chart drawn"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--folder", type=Path, help="data folder of a test")
    parser.add_argument("--times", type=int, default=10)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = options.folder or create_filled_test(Path(place))
        server = subprocess.Popen(
            [sys.executable, "-c", SERVER, str(folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=dict(os.environ),
        )
        try:
            assert server.stdout is not None
            times_by_name = visit_times(server.stdout.readline().strip(), options.times)
        finally:
            assert server.stdin is not None
            server.stdin.close()
            server.wait()
    if options.json:
        print(json.dumps(times_by_name))
        return
    print(f"{'':22}{'median':>10}{'least':>10}{'most':>10}   ms, {options.times} visits")
    for name, times_ms in times_by_name.items():
        print(f"{name:22}{statistics.median(times_ms):10.1f}{min(times_ms):10.1f}{max(times_ms):10.1f}")


def create_filled_test(folder: Path) -> Path:
    """Create an ended test with invented data."""
    test = FilledFolder(folder, Settings())
    for index in range(SETS):
        test.add_set(index, stored=index < STORED or index == SETS - 1)
    test.close()
    return folder


def visit_times(url: str, times: int) -> dict[str, list[float]]:
    """Return the milliseconds of each visit."""
    times_by_name: dict[str, list[float]] = {"document alone": []}
    with httpx2.Client(base_url=url) as api:
        for _ in range(times):
            start_s = time.perf_counter()
            api.get("/").raise_for_status()
            times_by_name["document alone"].append(1e3 * (time.perf_counter() - start_s))
    with chromium() as browser:
        for _ in range(times):
            context = browser.new_context(viewport=DESK)
            context.add_init_script(WATCH)
            page = context.new_page()
            for when, go in (("", lambda page=page: page.goto(url)), (", again", page.reload)):
                go()
                for name, at_ms in wait_until_drawn(page).items():
                    times_by_name.setdefault(f"{WHAT[name]}{when}", []).append(at_ms)
            context.close()
    return times_by_name


def wait_until_drawn(page: Any) -> dict[str, float]:
    """Wait until everything is drawn."""
    found: dict[str, float] = page.evaluate("window.allSeen")
    return {name: found[name] for name in WHAT}


if __name__ == "__main__":
    main()
