"""Requests to a service over HTTP, or to the service of a folder inside this process."""

from __future__ import annotations

import json
import logging
import re
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import httpx2

from daq_service.client.errors import RefusedError, UnreachableError
from daq_service.client.transport import proxy_note

log = logging.getLogger(__name__)

API = "/api/v1/"
LARGEST_PAGE = 1000
RETRY_S = 1.0
"""Pause before a stream is opened again, as its `retry` states."""

PASSING = frozenset({408, 425, 429})
"""Statuses below 500 after which a repeated request may succeed."""
LONGEST_LINE_BYTES = 10_000_000
"""Limit of the memory for a line without an end; the rest is dropped."""

Parameter = str | int | float | bool | None
Json = dict[str, Any]
"""Answer of the service, or a part of it; `/api/v1/openapi.json` describes their names."""
Events = Callable[[int, str | None], Iterator[dict[str, object]]]
"""Takes the id of an event and topics; yields events endlessly, in the order of their ids."""


class Connection:
    """Connection to a service.

    Parameters
    ----------
    http
        HTTP client with address and token; closed by `close`.
    events
        Yields events until ``closed``; None: those of the service's stream.
    """

    def __init__(
        self, http: httpx2.Client, *, events: Events | None = None, closed: threading.Event | None = None
    ) -> None:
        self.http = http
        self._events = events
        self._closed = closed or threading.Event()

    def close(self) -> None:
        """Close the connection and end its event streams."""
        self._closed.set()
        self.http.close()

    def wait(self, seconds: float) -> None:
        """Wait before a request is repeated; `close` ends it."""
        self._closed.wait(seconds)

    def get(self, path: str, **parameters: Parameter) -> Json:
        """Request a path below ``/api/v1/`` and return its JSON answer.

        Parameters
        ----------
        **parameters
            Query parameters; those that are None are left out.

        Raises
        ------
        RefusedError
            The service refuses the request, with its reason; or the answer is not that of a solimon service.
        UnreachableError
            No service answers.
        """
        response = self.response(path, **parameters)
        try:
            answer: Json = response.json()
        except ValueError:
            raise _build_foreign_service_error(response) from None
        return answer

    def response(self, path: str, **parameters: Parameter) -> httpx2.Response:
        """Request a path below ``/api/v1/`` and return the response; parameters that are None are left out.

        Raises
        ------
        RefusedError, UnreachableError
            As for `get`, but the content is not checked.
        """
        parameters_given = {name: value for name, value in parameters.items() if value is not None}
        try:
            response = self.http.get(API + path, params=parameters_given)
        except httpx2.RequestError as error:
            url = self.http.base_url
            remedy = "start `solimon run` or `solimon serve`; SSL_CERT_FILE names certificates of your own"
            raise UnreachableError(f"{url} does not answer{proxy_note(url)} ({error}); {remedy}") from error
        raise_for_error_response(response)
        return response

    def pages(self, resource: str, **parameters: Parameter) -> tuple[list[Json], Json]:
        """Read all pages of a listing of the API, `LARGEST_PAGE` rows each, into memory.

        Parameters
        ----------
        resource
            Path of the listing below ``/api/v1/``.
        **parameters
            Query parameters; those that are None are left out.

        Returns
        -------
        list of dict
            Rows, in the order of the service.
        dict
            ``as_of`` of the last page: time of reading and status of the recorder.

        Raises
        ------
        RefusedError, UnreachableError
            As for `get`.
        """
        items: list[Json] = []
        cursor = None
        while True:
            page = self.get(resource, limit=LARGEST_PAGE, cursor=cursor, **parameters)
            items += page["items"]
            cursor = page["next_cursor"]
            if cursor is None:
                return items, page["as_of"]

    def events(self, after: int, topics: str | None) -> Iterator[Json]:
        """Yield events with ids above ``after`` in order, as dicts with ``id``, ``topic`` and ``kind``.

        It blocks while there is none, and ends only after `close`. Skipped events are reported by one of
        topic ``gap``. Raise RefusedError if the service refuses the stream.

        Parameters
        ----------
        topics
            Comma-separated; None: all.
        """
        return (self._events or self._stream_events)(after, topics)

    def _stream_events(self, after: int, topics: str | None) -> Iterator[Json]:
        """Yield events with a higher id than ``after`` from the service's stream until `close`.

        While the service is unreachable, reconnect every `RETRY_S` after the last event; each new reason is
        logged as a warning. Raise RefusedError for a client error (status 4xx) that a retry cannot cure.
        """
        parameters: Mapping[str, str] = {} if topics is None else {"topics": topics}
        url, last_reason = self.http.base_url, ""
        while not self._closed.is_set():
            headers = {"Last-Event-ID": str(after), "Accept": "text/event-stream"}
            # A service that is restarted is waited for: its events are in the catalogue.
            try:
                with self.http.stream("GET", API + "stream", params=parameters, headers=headers) as response:
                    if response.is_client_error and response.status_code not in PASSING:
                        response.read()
                        raise_for_error_response(response)
                    kind = response.headers.get("content-type", "")
                    reason = "" if "event-stream" in kind else f"it answers {response.status_code} {kind}"
                    for event in parse_events(split_lines(response.iter_bytes())):
                        after = event["id"]
                        yield event
            except httpx2.RequestError as error:
                reason = str(error)
            if reason not in ("", last_reason):
                log.warning("no events from %s%s, asked again: %s", url, proxy_note(url), reason)
            last_reason = reason
            self._closed.wait(RETRY_S)


def raise_for_error_response(response: httpx2.Response) -> None:
    """Raise RefusedError with status, problem type and reason if a response is no success; else return None.

    Without a problem of RFC 9457 in it, the reason is that the address is not a service of solimon.
    """
    if response.is_success:
        return
    try:
        problem = response.json()
        reason, kind = f"{problem['detail']} {problem['hint']}", problem["type"]
    except (ValueError, KeyError, TypeError):
        raise _build_foreign_service_error(response) from None
    raise RefusedError(response.status_code, kind, reason)


def _build_foreign_service_error(response: httpx2.Response) -> RefusedError:
    """Build the RefusedError of an answer that is not solimon's, with address, status and proxy."""
    status = f"{response.url} answers {response.status_code}{proxy_note(response.url)}"
    reason = f"{status}; give the address of a service of solimon"
    return RefusedError(response.status_code, "about:blank", reason)


def split_lines(chunks: Iterable[bytes]) -> Iterator[str]:
    """Yield the complete lines of a byte stream, decoded from UTF-8, without their ends (CR, LF or both).

    Invalid UTF-8 is replaced. Of an incomplete line at most `LONGEST_LINE_BYTES` are kept; at the end of the
    stream it is dropped.
    """
    pending, after_cr = b"", False
    for chunk in chunks:
        pending += chunk[1:] if after_cr and chunk.startswith(b"\n") else chunk
        after_cr = chunk.endswith(b"\r")
        *complete, pending = re.split(rb"\r\n|\r|\n", pending)
        pending = pending[:LONGEST_LINE_BYTES]
        yield from (line.decode(errors="replace") for line in complete)


def parse_events(lines: Iterator[str]) -> Iterator[Json]:
    """Parse the lines of server-sent events (WHATWG HTML) and yield the events as dicts of their JSON data.

    Heartbeats, the final `bye` and frames without data are left out. An unreadable frame, or one with an id
    outside 0 to 10**18, is logged as a warning and skipped.
    """
    fields: dict[str, str] = {}
    for line in lines:
        if line:
            name, _, value = line.partition(":")
            first_lines = f"{fields[name]}\n" if name == "data" and name in fields else ""
            fields[name] = first_lines + value.removeprefix(" ")
            continue
        frame, fields = fields, {}
        topic = frame.get("event")
        if topic in (None, "", "heartbeat", "bye") or not frame.get("data"):
            continue
        try:
            event = {"topic": topic, "kind": topic, **json.loads(frame["data"]), "id": int(frame["id"])}
            if not 0 <= event["id"] < 10**18:  # range that the service accepts
                raise ValueError(f"its id is {event['id']}")
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            log.warning("an event of the stream cannot be read and is left out: %r: %.200s", error, frame)
            continue
        yield event
