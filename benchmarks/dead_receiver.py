"""REST latency next to unresponsive notification receivers, which must slow nothing.

Three services run side by side, each in a process of its own on a test of its own, and are asked in turn:
one without receivers, one whose receivers accept connections and never answer, one whose receivers refuse
them. Alarms are raised all the while, so that there is always something to send::

    python benchmarks/dead_receiver.py [--receivers 4] [--requests 2000] [--json]

Printed of each path and way: milliseconds of an answer, p50 and p99, and their ratio to those without
receivers; of each way the attempts that were made meanwhile and the processor time of the service.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import socket
import statistics
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from event_stream import Connected, Service, answer_s, percentile, service

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # the invented test is that of the tests
from support.filled_folder import FilledFolder

from daq_service.settings.tree import Settings

SETS, POINTS = 100, 200
PATHS = {"healthz": "/healthz", "trends": f"/api/v1/trends/B?points={POINTS}"}
ALARM_EVERY = 50
"""Requests between two alarms."""
SECRET = "DEAD_RECEIVER_SECRET"


class DeadReceiver:
    """Receiver that accepts every connection, reads everything, and never answers."""

    def __init__(self) -> None:
        self.connections: list[asyncio.Task[Any] | None] = []
        self.reached = asyncio.Event()

    async def report_message(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Hold one connection until its client gives up."""
        self.connections.append(asyncio.current_task())
        self.reached.set()
        while await reader.read(65536):
            pass
        writer.close()


def find_unused_port() -> int:
    """Return a port at which no server listens."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def notification_table(port: int | None, receivers: int) -> dict[str, Any]:
    """Return the table of notifications; each alarm is sent at once."""
    if port is None:
        return {}
    one = {"url": f"http://127.0.0.1:{port}/hook", "secret_env": SECRET}
    return {"receivers": {f"r{n}": one for n in range(receivers)}, "rules": [{"group_s": 0.0}]}


async def measure(base: Path, receivers: int, requests: int) -> dict[str, Any]:
    """Return everything that `main` prints."""
    dead = DeadReceiver()
    server = await asyncio.start_server(dead.report_message, "127.0.0.1", 0)
    ports = {"none": None, "dead": server.sockets[0].getsockname()[1], "refusing": find_unused_port()}
    with ExitStack() as stack:
        services: dict[str, Service] = {}
        folders: list[FilledFolder] = []
        for way, port in ports.items():
            tables = notification_table(port, receivers)
            folder = FilledFolder(_create_folder(base / way), Settings(notifications=tables))
            stack.callback(folder.close)
            for index in range(SETS):
                folder.add_set(index, stored=False)
            folders.append(folder)
            services[way] = stack.enter_context(service(folder.folder, notifications=tables))
        opened = {way: await asyncio.open_connection("127.0.0.1", one.port) for way, one in services.items()}
        _raise_alarms(folders, 0)
        async with asyncio.timeout(60.0):
            await dead.reached.wait()
        times_s, used_s = await _request_in_turn(services, opened, folders, requests)
        attempts = {"none": 0, "dead": len(dead.connections), "refusing": await _failures(opened["refusing"])}
        for _, writer in opened.values():
            writer.close()
    server.close()
    await asyncio.gather(*(task for task in dead.connections if task is not None))
    return {
        "cores": os.cpu_count(),
        "receivers": receivers,
        **{
            name: {
                "p50_ms": {way: round(1e3 * statistics.median(times_s[way, name]), 3) for way in ports},
                "p99_ms": {way: round(1e3 * percentile(times_s[way, name], 0.99), 3) for way in ports},
                "ratio_p50": _ratios(times_s, name, 0.5),
                "ratio_p99": _ratios(times_s, name, 0.99),
            }
            for name in PATHS
        },
        "attempts": attempts,
        "processor_s": {way: round(seconds, 2) for way, seconds in used_s.items()},
    }


async def _request_in_turn(
    services: dict[str, Service], opened: dict[str, Connected], folders: list[FilledFolder], requests: int
) -> tuple[dict[tuple[str, str], list[float]], dict[str, float]]:
    """Return the time of each request by way and path, and the processor time of each service meanwhile."""
    times_s: dict[tuple[str, str], list[float]] = {(way, name): [] for way in services for name in PATHS}
    before_s = {way: one.use()["cpu_s"] for way, one in services.items()}
    for number in range(requests):
        if number % ALARM_EVERY == 0:
            _raise_alarms(folders, number // ALARM_EVERY)
        for (way, name), found in times_s.items():
            found.append(await answer_s(opened[way], PATHS[name]))
    return times_s, {way: one.use()["cpu_s"] - before_s[way] for way, one in services.items()}


def _create_folder(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _raise_alarms(folders: list[FilledFolder], number: int) -> None:
    for folder in folders:
        folder.add_alarm("B", number % SETS)


def _ratios(times_s: dict[tuple[str, str], list[float]], name: str, share: float) -> dict[str, float]:
    alone = percentile(times_s["none", name], share)
    return {way: round(percentile(times_s[way, name], share) / alone, 2) for way in ("dead", "refusing")}


async def _failures(connected: Connected) -> int:
    """Count the failed attempts that a service reports."""
    reader, writer = connected
    writer.write(b"GET /api/v1/notifications HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n")
    content = (await reader.read()).partition(b"\r\n\r\n")[2]
    return sum(one["failed"] for one in json.loads(content)["receivers"])


def main() -> None:
    """Print the measurements."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--receivers", type=int, default=4, help="of each service that has any")
    parser.add_argument("--requests", type=int, default=2000, help="of each path and service")
    parser.add_argument("--json", action="store_true", help="one object instead of lines")
    options = parser.parse_args()
    os.environ[SECRET] = "sixteen or more characters"
    with tempfile.TemporaryDirectory() as name:
        found = asyncio.run(measure(Path(name), options.receivers, options.requests))
    if options.json:
        print(json.dumps(found))
        return
    for part, times in found.items():
        for name, values in times.items() if isinstance(times, dict) else [("", times)]:
            print(f"{part:<12}{name:<12}{values}")


if __name__ == "__main__":
    main()
