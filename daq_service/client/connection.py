"""Questions to a service over HTTP, or to the service of a folder inside this process: the same answers."""

from __future__ import annotations

import json
import logging
import re
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import httpx

from daq_service.client.errors import RefusedError, UnreachableError
from daq_service.client.transport import through

log = logging.getLogger(__name__)

API = "/api/v1/"
LARGEST_PAGE = 1000
RETRY_S = 1.0
"""Between tries to come back to a stream, as its `retry` asks for."""

PASSING = frozenset({408, 425, 429})
"""Answers below 500 after which the same question may have another answer."""
LONGEST_LINE_BYTES = 10_000_000
"""The rest is dropped: a line without an end takes no more memory than that."""

Events = Callable[[int, str | None], Iterator[dict[str, Any]]]
"""Takes an event's id and topics; endless, in the order of the ids."""


class Connection:
    """A service's answers.

    Parameters
    ----------
    http
        Its address and token; closed by `close`.
    events
        Follows the test until ``closed``; None: by the service's stream.
    """

    def __init__(
        self, http: httpx.Client, *, events: Events | None = None, closed: threading.Event | None = None
    ) -> None:
        self.http = http
        self._events = events
        self._closed = closed or threading.Event()

    def close(self) -> None:
        """End it, and whoever follows."""
        self._closed.set()
        self.http.close()

    def get(self, path: str, **asked: Any) -> dict[str, Any]:
        """Answer below ``/api/v1/``.

        Raises
        ------
        RefusedError, UnreachableError
            The service refuses, with its reason; or nobody answers.
        """
        response = self.response(path, **asked)
        try:
            answer: dict[str, Any] = response.json()
        except ValueError:
            raise _foreign(response) from None
        return answer

    def response(self, path: str, **asked: Any) -> httpx.Response:
        """Give the same as it came; parameters that are None are left out."""
        given = {name: value for name, value in asked.items() if value is not None}
        try:
            response = self.http.get(API + path, params=given)
        except httpx.RequestError as error:
            url = self.http.base_url
            remedy = "start `solimon run` or `solimon serve`; SSL_CERT_FILE names certificates of your own"
            raise UnreachableError(f"{url} does not answer{through(url)} ({error}); {remedy}") from error
        check(response)
        return response

    def pages(self, resource: str, **asked: Any) -> tuple[list[dict[str, Any]], dict[str, Any]]:
        """Read all pages of a listing; its rows, and how fresh the last page was."""
        items: list[dict[str, Any]] = []
        cursor = None
        while True:
            page = self.get(resource, limit=LARGEST_PAGE, cursor=cursor, **asked)
            items += page["items"]
            cursor = page["next_cursor"]
            if cursor is None:
                return items, page["as_of"]

    def events(self, after: int, topics: str | None) -> Iterator[dict[str, Any]]:
        """Events behind an id as they come, without end; ``gap`` and ``topic`` as the stream tells them."""
        return (self._events or self._streamed)(after, topics)

    def _streamed(self, after: int, topics: str | None) -> Iterator[dict[str, Any]]:
        asked: Mapping[str, str] = {} if topics is None else {"topics": topics}
        url, trouble = self.http.base_url, ""
        while not self._closed.is_set():
            headers = {"Last-Event-ID": str(after), "Accept": "text/event-stream"}
            # A service that is restarted is waited for: its events are in the catalogue.
            try:
                with self.http.stream("GET", API + "stream", params=asked, headers=headers) as response:
                    if response.is_client_error and response.status_code not in PASSING:
                        response.read()
                        check(response)
                    kind = response.headers.get("content-type", "")
                    reason = "" if "event-stream" in kind else f"it answers {response.status_code} {kind}"
                    for event in parsed(lines_of(response.iter_bytes())):
                        after = event["id"]
                        yield event
            except httpx.RequestError as error:
                reason = str(error)
            if reason not in ("", trouble):
                log.warning("no events from %s%s, asked again: %s", url, through(url), reason)
            trouble = reason
            self._closed.wait(RETRY_S)


def check(response: httpx.Response) -> None:
    """Raise what a service says against a request."""
    if response.is_success:
        return
    try:
        problem = response.json()
        reason, kind = f"{problem['detail']} {problem['hint']}", problem["type"]
    except (ValueError, KeyError, TypeError):
        raise _foreign(response) from None
    raise RefusedError(response.status_code, kind, reason)


def _foreign(response: httpx.Response) -> RefusedError:
    answered = f"{response.url} answers {response.status_code}{through(response.url)}"
    reason = f"{answered}; give the address of a service of solimon"
    return RefusedError(response.status_code, "about:blank", reason)


def lines_of(chunks: Iterable[bytes]) -> Iterator[str]:
    """Yield the complete lines of a stream of events: they end by CR, LF or both, and by nothing else."""
    pending, after_cr = b"", False
    for chunk in chunks:
        pending += chunk[1:] if after_cr and chunk.startswith(b"\n") else chunk
        after_cr = chunk.endswith(b"\r")
        *complete, pending = re.split(rb"\r\n|\r|\n", pending)
        pending = pending[:LONGEST_LINE_BYTES]
        yield from (line.decode(errors="replace") for line in complete)


def parsed(lines: Iterator[str]) -> Iterator[dict[str, Any]]:
    """Yield server-sent events but for heartbeats and the service's goodbye.

    A frame that cannot be read is reported in the log and skipped.
    """
    fields: dict[str, str] = {}
    for line in lines:
        if line:
            name, _, value = line.partition(":")
            before = f"{fields[name]}\n" if name == "data" and name in fields else ""
            fields[name] = before + value.removeprefix(" ")
            continue
        frame, fields = fields, {}
        topic = frame.get("event")
        if topic in (None, "", "heartbeat", "bye") or not frame.get("data"):
            continue
        try:
            event = {"topic": topic, "kind": topic, **json.loads(frame["data"]), "id": int(frame["id"])}
            if not 0 <= event["id"] < 10**18:  # as the service takes it back
                raise ValueError(f"its id is {event['id']}")
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            log.warning("an event of the stream cannot be read and is left out: %r: %.200s", error, frame)
            continue
        yield event
