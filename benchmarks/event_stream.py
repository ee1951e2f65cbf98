"""Web service under load: small answers, many streams, many simultaneous reconnections, frozen readers.

A process of its own serves a new data folder; this one writes events through the catalogue and reads with
plain sockets, so the load shares the cores with the service. The last part records on the twin in real time,
and shows what streams do to its strikes::

    python benchmarks/event_stream.py [--clients 1000] [--rate 4] [--seconds 10] [--json]

Next to each stands the obvious way, measured in the same run: a listening socket made without naming its
protocol (Nagle's algorithm stays on), and FastAPI's own stream of the same events. Latency: from the commit
of an event (its ``wall_utc``) to its last byte at a client.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any

from daq_service.catalogue import SetCommit, open_catalogue
from daq_service.catalogue.rows import EventRow, ShotRow

SERVER = """
import asyncio, json, os, socket, sys, threading
from pathlib import Path
from daq_service.processes.resource_use import resident_bytes
from daq_service.settings.tree import Settings
from daq_service.web import server
from daq_service.web.app import create_app

folder, way = Path(sys.argv[1]), sys.argv[2]
app = create_app(Settings(notifications=json.loads(sys.argv[3])), folder)
if way == "nagle":
    def bind(host, port, **_):
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listener.bind((host, port))
        listener.listen(2048)
        listener.setblocking(False)
        return listener
    server.bind_socket = bind
    server.uvicorn.Config.get_loop_factory = lambda config: asyncio.new_event_loop
if way == "fastapi":
    import orjson
    from fastapi.sse import EventSourceResponse, ServerSentEvent
    hub = app.state.context.hub

    @app.get("/plain", response_class=EventSourceResponse)
    async def plain():
        cursor = hub.last_id
        while not hub.closed:
            for event in hub.after(cursor):
                cursor = event.id
                data = event.frame.partition(b"data: ")[2].strip()
                yield ServerSentEvent(id=str(event.id), event=event.topic, data=orjson.loads(data))
            await hub.changed()

stop = threading.Event()

def answer():
    for _ in sys.stdin:
        print(json.dumps({"cpu_s": sum(os.times()[:2]), "memory_bytes": resident_bytes()}), flush=True)
    stop.set()

threading.Thread(target=answer, daemon=True).start()
server.reduce_garbage_collection()
server.serve(app, "127.0.0.1", 0, on_bound=lambda url: print(url, flush=True), stop=stop)
"""
STAMP = re.compile(rb'"wall_utc": ?"([^"]+)"')
ID = re.compile(rb"^id: (\d+)$", re.MULTILINE)
STORED_EVENTS, FROZEN, SMALL_REQUESTS = 5000, 200, 200
LOOK_EVERY_S = 0.01
LARGEST_STREAM_BYTES = 2**26
STRUCK_S, SHOTS, SHOT_INTERVAL_S = 60, 7, 0.05


@dataclass(frozen=True)
class Service:
    """Service in a process of its own."""

    process: subprocess.Popen[str]
    port: int

    def use(self) -> dict[str, float]:
        """Return processor time and memory so far."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        found: dict[str, float] = json.loads(self.process.stdout.readline())
        return found


@contextmanager
def service(
    folder: Path, way: str = "ours", *, notifications: Mapping[str, Any] = MappingProxyType({})
) -> Iterator[Service]:
    """Serve a folder."""
    command = [sys.executable, "-c", SERVER, str(folder), way, json.dumps(dict(notifications))]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        yield Service(process, int(process.stdout.readline().strip().rstrip("/").rpartition(":")[2]))
        process.stdin.close()


def wall_s(stamp: str) -> float:
    """Convert RFC 3339 with nanoseconds to Unix time."""
    head, _, fraction = stamp.rstrip("Z").partition(".")
    return datetime.fromisoformat(head + "+00:00").timestamp() + float(f"0.{fraction or 0}")


def percentile(values: list[float], share: float) -> float:
    """Return the value below which this share lies."""
    return sorted(values)[int(share * (len(values) - 1))]


Connected = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def send_request(port: int, path: str, **options: Any) -> Connected:
    """Send a request and leave the response unread."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port, **options)
    writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
    return reader, writer


async def answer_s(connected: Connected, path: str) -> float:
    """Return the time of one request on an open connection, to the last byte."""
    reader, writer = connected
    began = time.perf_counter()
    writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
    head = await reader.readuntil(b"\r\n\r\n")
    length = re.search(rb"content-length: (\d+)", head.lower())
    assert length is not None
    await reader.readexactly(int(length[1]))
    return time.perf_counter() - began


async def measure_small_answers(port: int) -> dict[str, float]:
    """Return the median time of small requests, ms."""
    found = {}
    for path in ("/healthz", "/"):
        connected = await asyncio.open_connection("127.0.0.1", port)
        times_s = [await answer_s(connected, path) for _ in range(SMALL_REQUESTS)]
        connected[1].close()
        found[path] = round(1e3 * statistics.median(times_s), 3)
    return found


async def probe_during(port: int, work: Awaitable[Any]) -> tuple[Any, list[float]]:
    """Request ``/healthz`` repeatedly during ``work``; return its result, and each time."""
    connected, times_s = await asyncio.open_connection("127.0.0.1", port), list[float]()
    task = asyncio.ensure_future(work)
    while not task.done():
        times_s.append(await answer_s(connected, "/healthz"))
        await asyncio.sleep(LOOK_EVERY_S)
    connected[1].close()
    return await task, times_s


async def measure_deliveries(
    folder: Path, served: Service, path: str, clients: int, rate_hz: float, seconds: float
) -> Any:
    """Return the latency of all deliveries, and processor time of connecting and of delivering."""
    latencies_s: list[float] = []
    before = served.use()["cpu_s"]
    opened = [await send_request(served.port, path) for _ in range(clients)]
    for reader, _ in opened:
        await reader.readuntil(b"\r\n\r\n")
    # Each has heard that it is connected; the server has started to wait for all of them.
    await answer_s(await asyncio.open_connection("127.0.0.1", served.port), "/healthz")
    connecting_s = served.use()["cpu_s"] - before
    expected = clients * int(rate_hz * seconds)
    all_came = asyncio.Event()

    async def read(reader: asyncio.StreamReader) -> None:
        while chunk := await reader.read(65536):
            now = time.time()
            latencies_s.extend(now - wall_s(found.decode()) for found in STAMP.findall(chunk))
            if len(latencies_s) >= expected:
                all_came.set()

    readers = [asyncio.create_task(read(reader)) for reader, _ in opened]
    before = served.use()["cpu_s"]
    with open_catalogue(folder, writer=True) as catalogue:
        for number in range(int(rate_hz * seconds)):
            event = EventRow(utc_ns=number, topic="sets", kind="set_done", payload=payload_of(number))
            await asyncio.to_thread(catalogue.commit_set, SetCommit(events=[event]))
            await asyncio.sleep(1.0 / rate_hz)
    async with asyncio.timeout(60.0):
        await all_came.wait()
    delivering_s = served.use()["cpu_s"] - before
    for task in readers:
        task.cancel()
    for _, writer in opened:
        writer.close()
    return {
        "clients": clients,
        "deliveries": len(latencies_s),
        "expected": expected,
        "p50_ms": round(1e3 * statistics.median(latencies_s), 1),
        "p99_ms": round(1e3 * percentile(latencies_s, 0.99), 1),
        "connecting_us_a_client": round(1e6 * connecting_s / clients, 1),
        "delivering_us_a_delivery": round(1e6 * delivering_s / len(latencies_s), 1),
    }


def payload_of(number: int) -> dict[str, Any]:
    """Return the payload of an event, as large as a set's."""
    return {"number": number, "reason": None, "file": f"sets/set_{number:06d}.h5", "states": ["done"] * 20}


async def resume_clients(served: Service, clients: int, frozen: int) -> dict[str, Any]:
    """Resume clients from the first event at once, next to some that read nothing at all."""
    before = served.use()
    silent = [await send_request(served.port, "/api/v1/stream?after=0", limit=1) for _ in range(frozen)]

    async def all_of_them() -> int:
        # In a process of their own: what they read would hold up whoever asks for `/healthz` here.
        load = [sys.executable, __file__, "--load", str(served.port), "--clients", str(clients)]
        process = await asyncio.create_subprocess_exec(*load, stdout=subprocess.PIPE)
        output, _ = await process.communicate()
        return int(output)

    began = time.perf_counter()
    lost, times_s = await probe_during(served.port, all_of_them())
    took_s = time.perf_counter() - began
    after = served.use()
    for _, writer in silent:
        writer.close()
    return {
        "clients": clients,
        "frozen": frozen,
        "events": STORED_EVENTS,
        "clients_that_lost_events": lost,
        "took_s": round(took_s, 2),
        "healthz_p99_ms": round(1e3 * percentile(times_s, 0.99), 1),
        "memory_before_mb": round(before["memory_bytes"] / 1e6, 1),
        "memory_after_mb": round(after["memory_bytes"] / 1e6, 1),
    }


async def count_incomplete_clients(port: int, clients: int) -> int:
    """Read every stored event at many clients at once; return how many of them lack or repeat any."""

    async def resume() -> bool:
        reader, writer = await send_request(port, "/api/v1/stream?after=0", limit=LARGEST_STREAM_BYTES)
        content = await reader.readuntil(b"id: %d\n" % STORED_EVENTS)
        writer.close()
        return [int(number) for number in ID.findall(content)] != list(range(1, STORED_EVENTS + 1))

    return sum(await asyncio.gather(*(resume() for _ in range(clients))))


def measure_strike_delays(clients: int) -> dict[str, float]:
    """Return the delays of a recorder's strikes (of the twin, in real time) next to streams.

    A set each second of `SHOTS` strikes; the first sets, in which kernels are compiled, are left out.
    """
    second_h = 1.0 / 3600.0
    schedule = {
        "phases": [{"until_h": STRUCK_S * second_h, "interval_h": second_h}],
        "shots_per_set": SHOTS,
        "shot_interval_s": SHOT_INTERVAL_S,
    }
    test = {"clock": {"kind": "wall"}, "positions": {"B": {"method": "solitary_wave"}}, "schedule": schedule}
    with tempfile.TemporaryDirectory() as name:
        config, folder = Path(name, "test.json"), Path(name, "data")
        config.write_text(json.dumps(test), encoding="utf-8")
        command = [sys.executable, "-m", "daq_service.cli", "record", str(config), "--data-dir", str(folder)]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as recorder:
            while not (folder / "catalogue.sqlite").exists():
                if recorder.poll() is not None:
                    raise SystemExit(f"the recorder ended with {recorder.returncode}")
                time.sleep(LOOK_EVERY_S)
            with service(folder) as served:
                asyncio.run(_listen_until(recorder, served.port, clients))
        with open_catalogue(folder) as catalogue:
            rows = catalogue.rows(ShotRow)
    started_ns = {row.set_index: row.mono_ns for row in rows if row.shot_index == 0}
    off_ms = [
        abs((row.mono_ns - started_ns[row.set_index]) / 1e6 - 1e3 * SHOT_INTERVAL_S * row.shot_index)
        for row in rows
        if row.shot_index and row.set_index in started_ns and row.set_index >= STRUCK_S // 2
    ]
    return {
        "clients": clients,
        "strikes": len(off_ms),
        "p50_ms": round(statistics.median(off_ms), 2),
        "p99_ms": round(percentile(off_ms, 0.99), 2),
    }


async def _listen_until(recorder: subprocess.Popen[bytes], port: int, clients: int) -> None:
    """Read many streams and discard them, until the recorder has ended."""
    opened = [await send_request(port, "/api/v1/stream") for _ in range(clients)]

    async def read(reader: asyncio.StreamReader) -> None:
        while await reader.read(65536):
            pass

    readers = [asyncio.create_task(read(reader)) for reader, _ in opened]
    await asyncio.to_thread(recorder.wait)
    for task in readers:
        task.cancel()
    for _, writer in opened:
        writer.close()


def measure(folder: Path, options: argparse.Namespace, report: Callable[[str], None]) -> dict[str, Any]:
    """Return everything that `main` prints."""
    found: dict[str, Any] = {}
    for way in ("nagle", "ours"):
        report(f"small answers, {way}")
        with service(folder, way) as served:
            found.setdefault("small_answers_ms", {})[way] = asyncio.run(measure_small_answers(served.port))
    small = found["small_answers_ms"]
    small["ratio"] = {path: round(small["nagle"][path] / small["ours"][path], 1) for path in small["ours"]}
    for way, path in (("fastapi", "/plain"), ("ours", "/api/v1/stream")):
        report(f"{options.clients} streams, {way}")
        with service(folder, way) as served:
            load = (folder, served, path, options.clients, options.rate, options.seconds)
            found.setdefault("streams", {})[way] = asyncio.run(measure_deliveries(*load))
    return found


def main() -> None:
    """Print the measurements."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--clients", type=int, default=1000)
    parser.add_argument("--rate", type=float, default=4.0, help="events a second")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--json", action="store_true", help="one object instead of lines")
    parser.add_argument("--load", type=int, metavar="PORT", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.load is not None:
        print(asyncio.run(count_incomplete_clients(options.load, options.clients)))
        return

    def report(stage: str) -> None:
        print(f"measuring: {stage}", file=sys.stderr, flush=True)

    found: dict[str, Any] = {"cores": os.cpu_count()}
    with tempfile.TemporaryDirectory() as name:
        create_test(Path(name))
        found |= measure(Path(name), options, report)
    with tempfile.TemporaryDirectory() as name:
        create_test(Path(name))
        with open_catalogue(Path(name), writer=True) as catalogue:
            commit = SetCommit()
            for number in range(STORED_EVENTS):
                event: dict[str, Any] = {"utc_ns": number, "wall_utc_ns": number, "topic": "sets"}
                commit.events.append(EventRow(**event, kind="set_done", payload=payload_of(number)))
            catalogue.commit_set(commit)
        found["come_back"] = {}
        for frozen in (0, FROZEN):
            with service(Path(name)) as served:
                report(f"{options.clients} come back, {frozen} frozen")
                found["come_back"][f"{frozen} frozen"] = asyncio.run(
                    resume_clients(served, options.clients, frozen)
                )
    found["strikes_off_their_times"] = {}
    for clients in (0, options.clients):
        report(f"strikes beside {clients} streams")
        found["strikes_off_their_times"][f"{clients}"] = measure_strike_delays(clients)
    if options.json:
        print(json.dumps(found))
        return
    for part, values in found.items():
        for name, value in values.items() if isinstance(values, dict) else [("", values)]:
            print(f"{part:<25}{name:<12}{value}")


def create_test(folder: Path) -> None:
    """Make an empty test."""
    with open_catalogue(folder, writer=True) as catalogue:
        catalogue.create_experiment(
            name="load",
            configuration_hash="0",
            configuration={},
            epoch_utc_ns=0,
            clock="simulated",
            solimon_version="0",
        )


if __name__ == "__main__":
    main()
