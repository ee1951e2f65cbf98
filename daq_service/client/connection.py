"""Questions to a service over HTTP, or to the service of a folder inside this process: the same answers."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import Any

import httpx

from daq_service.client.errors import RefusedError, UnreachableError

API = "/api/v1/"
LARGEST_PAGE = 1000
RETRY_S = 1.0
"""Between tries to come back to a stream, as its `retry` asks for."""

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
        answer: dict[str, Any] = self.response(path, **asked).json()
        return answer

    def response(self, path: str, **asked: Any) -> httpx.Response:
        """Give the same as it came; parameters that are None are left out."""
        given = {name: value for name, value in asked.items() if value is not None}
        try:
            response = self.http.get(API + path, params=given)
        except httpx.TransportError as error:
            raise UnreachableError(
                f"{self.http.base_url} does not answer ({error}); `solimon run` or `solimon serve` makes it"
            ) from error
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
        while not self._closed.is_set():
            asked: Mapping[str, str] = {} if topics is None else {"topics": topics}
            headers = {"Last-Event-ID": str(after), "Accept": "text/event-stream"}
            # A service that is restarted is waited for: its events are in the catalogue.
            with (
                suppress(httpx.TransportError),
                self.http.stream("GET", API + "stream", params=asked, headers=headers) as response,
            ):
                if response.status_code != httpx.codes.SERVICE_UNAVAILABLE:
                    if response.is_error:
                        response.read()
                    check(response)
                    for event in parsed(response.iter_lines()):
                        after = event["id"]
                        yield event
            self._closed.wait(RETRY_S)


def check(response: httpx.Response) -> None:
    """Raise what a service says against a request."""
    if response.is_success:
        return
    try:
        problem = response.json()
        told = f"{problem['detail']} {problem['hint']}"
    except (ValueError, KeyError):
        raise RefusedError(
            response.status_code,
            "about:blank",
            f"{response.url} answers {response.status_code}; give the address of a service of solimon",
        ) from None
    raise RefusedError(response.status_code, problem["type"], told)


def parsed(lines: Iterator[str]) -> Iterator[dict[str, Any]]:
    """Server-sent events but for heartbeats and the service's goodbye."""
    fields: dict[str, str] = {}
    for line in lines:
        if line:
            name, _, value = line.partition(": ")
            fields[name] = value
            continue
        topic, data = fields.get("event"), fields.get("data")
        if topic and topic != "bye" and data:
            told = json.loads(data)
            yield {"id": int(fields["id"]), "topic": topic, "kind": topic, **told}
        fields = {}
