"""Latency and cost of the event stream with many clients on this machine.

A process of its own serves a new data folder; this one writes events through the catalogue and
reads them with plain sockets, so the load shares the cores with the service::

    python benchmarks/event_stream.py --clients 1000 --rate 4 --seconds 10

Latency: from the commit of an event (its ``wall_utc``) to its last byte at a client.
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
from datetime import datetime
from pathlib import Path

from daq_service.catalogue import open_catalogue

SERVER = """
import os, sys, threading
from pathlib import Path
from daq_service.settings.tree import Settings
from daq_service.web.app import create_app
from daq_service.web.server import serve

stop = threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), stop.set()), daemon=True).start()
before_s = []

def on_bound(url):
    before_s.append(sum(os.times()[:2]))
    print(url, flush=True)

serve(create_app(Settings(), Path(sys.argv[1])), "127.0.0.1", 0, on_bound=on_bound, stop=stop)
print(sum(os.times()[:2]) - before_s[0], flush=True)
"""
STAMP = re.compile(rb'"wall_utc":"([^"]+)"')


def wall_s(stamp: str) -> float:
    """RFC 3339 with nanoseconds to Unix time."""
    head, _, fraction = stamp.rstrip("Z").partition(".")
    return datetime.fromisoformat(head + "+00:00").timestamp() + float(f"0.{fraction or 0}")


async def client(port: int, ready: asyncio.Semaphore, latencies_s: list[float]) -> None:
    """Read one stream to its end."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"GET /api/v1/stream HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
    await reader.readuntil(b"retry: 1000\n\n")
    ready.release()
    while chunk := await reader.read(65536):
        now = time.time()
        latencies_s += [now - wall_s(found.decode()) for found in STAMP.findall(chunk)]
    writer.close()


async def measure(folder: Path, port: int, clients: int, rate_hz: float, seconds: float, stop) -> list[float]:
    """Latencies of all deliveries."""
    latencies_s: list[float] = []
    ready = asyncio.Semaphore(0)
    readers = [asyncio.create_task(client(port, ready, latencies_s)) for _ in range(clients)]
    for _ in range(clients):
        await ready.acquire()
    with open_catalogue(folder, writer=True) as catalogue:
        for number in range(int(rate_hz * seconds)):
            await asyncio.to_thread(
                catalogue.add_event, utc_ns=number, topic="sets", kind="set_done", payload={"number": number}
            )
            await asyncio.sleep(1.0 / rate_hz)
    stop()
    await asyncio.gather(*readers)
    return latencies_s


def main() -> None:
    """Print one JSON object."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--clients", type=int, default=1000)
    parser.add_argument("--rate", type=float, default=4.0, help="events a second")
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with open_catalogue(folder, writer=True) as catalogue:
            catalogue.create_experiment(
                name="load",
                configuration_hash="0",
                configuration={},
                epoch_utc_ns=0,
                clock="simulated",
                solimon_version="0",
            )
        server = subprocess.Popen(
            [sys.executable, "-c", SERVER, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert server.stdin is not None
        assert server.stdout is not None
        port = int(server.stdout.readline().strip().rstrip("/").rpartition(":")[2])
        stopped_at: list[float] = []

        def stop() -> None:
            stopped_at.append(time.monotonic())
            server.stdin.close()  # type: ignore[union-attr]

        latencies_s = asyncio.run(measure(folder, port, options.clients, options.rate, options.seconds, stop))
        cpu_s = float(server.stdout.readline())
        server.wait()
        stop_s = time.monotonic() - stopped_at[0]
    latencies_s.sort()
    print(
        json.dumps(
            {
                "clients": options.clients,
                "deliveries": len(latencies_s),
                "expected": options.clients * int(options.rate * options.seconds),
                "p50_ms": round(1e3 * statistics.median(latencies_s), 1),
                "p99_ms": round(1e3 * latencies_s[int(0.99 * (len(latencies_s) - 1))], 1),
                "max_ms": round(1e3 * latencies_s[-1], 1),
                "server_cpu_us_a_delivery": round(1e6 * cpu_s / len(latencies_s), 1),
                "stop_s": round(stop_s, 2),
                "cores": os.cpu_count(),
            }
        )
    )


if __name__ == "__main__":
    main()
