"""Memory of one service of many tests: listed, requested in turn, followed all at once, idle.

The folders are copies of one invented test, served by a process of its own in which idle tests close after a
second instead of a minute. Everything is done twice, so that what is not given back shows::

    python benchmarks/many_tests.py [--tests 50] [--sets 60] [--json]

Printed of each step: resident memory in MB, tests that are open, threads; and MB a test that is followed.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx2

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # the invented test is that of the tests
from support.filled_folder import FilledFolder

from daq_service.settings.tree import Settings

SERVER = """
import json, sys, threading
from pathlib import Path
from daq_service.processes.resource_use import resident_bytes
from daq_service.settings.tree import Settings
from daq_service.web.multi_test import open_tests
from daq_service.web.multi_test.app import create_multi_test_app
from daq_service.web.server import serve

open_tests.IDLE_S, open_tests.LOOK_EVERY_S = 1.0, 0.2
own, *folders = map(Path, sys.argv[1:])
app = create_multi_test_app(folders, Settings(), own)
stop = threading.Event()

def answer():
    for _ in sys.stdin:
        is_open = sum(test.context is not None for test in app.state.tests.all.values())
        told = {"memory_bytes": resident_bytes(), "open": is_open, "threads": threading.active_count()}
        print(json.dumps(told), flush=True)
    stop.set()

threading.Thread(target=answer, daemon=True).start()
serve(app, "127.0.0.1", 0, on_bound=lambda url: print(url, flush=True), stop=stop)
"""
CLOSED_WITHIN_S = 60.0
OF_A_TEST = ("info", "trends/B?points=200", "alarms")


class Service:
    """Service of many tests in a process of its own."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.url = self._read().strip()

    def _read(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline()

    def use(self) -> dict[str, int]:
        """Return memory, open tests and threads now."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        found: dict[str, int] = json.loads(self._read())
        return found

    def left_alone(self) -> dict[str, int]:
        """Wait until every test is closed."""
        until_s = time.monotonic() + CLOSED_WITHIN_S
        while (found := self.use())["open"]:
            if time.monotonic() > until_s:
                raise SystemExit(f"{found['open']} tests stay open though nobody asks for them")
            time.sleep(0.1)
        return found


@contextmanager
def service(own: Path, folders: list[Path]) -> Iterator[Service]:
    """Run a service of the folders."""
    command = [sys.executable, "-c", SERVER, *map(str, [own, *folders])]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        yield Service(process)
        process.stdin.close()


def create_folders(base: Path, tests: int, sets: int) -> list[Path]:
    """Create the folders."""
    first = base / "test 1"
    first.mkdir()
    filled = FilledFolder(first, Settings())
    for index in range(sets):
        filled.add_set(index, stored=False)
    filled.add_alarm("B", sets - 1)
    filled.close()
    return [first, *(shutil.copytree(first, base / f"test {n}") for n in range(2, tests + 1))]


def measure(base: Path, tests: int, sets: int) -> dict[str, Any]:
    """Return everything that `main` prints."""
    steps: dict[str, dict[str, int]] = {}
    with service(base, create_folders(base, tests, sets)) as served, ExitStack() as stack:
        limits = httpx2.Limits(max_connections=tests + 1)  # each stream takes one
        # Nothing is encrypted: reading all certificates would take longer than the answers.
        client = httpx2.Client(base_url=served.url, timeout=60.0, verify=False, limits=limits)
        stack.enter_context(client)
        steps["begun"] = served.use()
        apis = [row["api"] for row in client.get("/api/v1/tests").raise_for_status().json()["items"]]
        assert len(apis) == tests
        steps["listed"] = served.use()
        for repetition in ("once", "again"):
            for api in apis:
                for path in OF_A_TEST:
                    client.get(f"{api}/{path}").raise_for_status()
            steps[f"asked {repetition}"] = served.use()
            with ExitStack() as streams:
                followed = []  # whoever lets go of what it reads by ends the stream
                for api in apis:
                    answer = streams.enter_context(client.stream("GET", f"{api}/stream"))
                    followed.append(answer.raise_for_status().iter_raw())
                    next(followed[-1])
                steps[f"followed {repetition}"] = served.use()
            steps[f"left {repetition}"] = served.left_alone()
    memory = {step: values["memory_bytes"] / 1e6 for step, values in steps.items()}
    return {
        "tests": tests,
        "sets": sets,
        "steps": {
            step: {"memory_mb": round(memory[step], 1), "open": values["open"], "threads": values["threads"]}
            for step, values in steps.items()
        },
        "mb_a_followed_test": round((memory["followed once"] - memory["listed"]) / tests, 2),
        "mb_more_the_second_time": round(memory["followed again"] - memory["followed once"], 1),
    }


def main() -> None:
    """Print the measurements."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tests", type=int, default=50)
    parser.add_argument("--sets", type=int, default=60, help="of each test")
    parser.add_argument("--json", action="store_true", help="one object instead of lines")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        found = measure(Path(name), options.tests, options.sets)
    if options.json:
        print(json.dumps(found))
        return
    for part, results in found.items():
        for name, values in results.items() if isinstance(results, dict) else [("", results)]:
            print(f"{part:<24}{name:<16}{values}")


if __name__ == "__main__":
    main()
