"""Response times by route, until the first byte, so that streams count as well."""

from __future__ import annotations

import time

from prometheus_client import CollectorRegistry, Histogram
from starlette.types import ASGIApp, Message, Receive, Scope, Send

BUCKETS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 5.0)


class AnswerTimes:
    """Histogram with a separate registry, so that two applications of a process share nothing."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.histogram = Histogram(
            "solimon_http_answer_seconds",
            "Time until an answer begins, by route",
            labelnames=["route"],
            buckets=BUCKETS_S,
            registry=self.registry,
        )


class RequestTimes:
    """Timing middleware in plain ASGI, since Starlette's `BaseHTTPMiddleware` would buffer the streams."""

    def __init__(self, app: ASGIApp, times: AnswerTimes) -> None:
        self._app = app
        self._times = times

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and record the time in s until its response starts, by route."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        started_s = time.perf_counter()

        async def send_timed(message: Message) -> None:
            """Send a message; observe the elapsed time when the response starts."""
            if message["type"] == "http.response.start":
                # The route's pattern: what a client writes into a path must not become a label.
                route = getattr(scope.get("route"), "path", "none")
                self._times.histogram.labels(route).observe(time.perf_counter() - started_s)
            await send(message)

        await self._app(scope, receive, send_timed)
