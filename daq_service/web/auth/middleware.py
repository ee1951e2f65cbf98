"""Authentication middleware: the person of a request, and refusals before any route.

A token is in the header `Authorization: Bearer`, or for the page in a cookie that no script can read.
A valid one is always accepted, independent of wrong ones before it: 256 random bits cannot be guessed. The
cost of wrong tokens is limited instead, in answers and in lines of the audit log.
"""

from __future__ import annotations

import asyncio
import hashlib
import ipaddress
import re
import ssl
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from daq_service.commands.audit import Allowance, Audit
from daq_service.errors import UsageError
from daq_service.settings.web import LOOPBACK, WebSettings
from daq_service.web.answers.problem import Problem, build_problem_response, read_request_id
from daq_service.web.auth.roles import CLAIMED, Person
from daq_service.web.auth.tokens import KnownTokens, find_tokens_file, read_tokens

PUBLIC_PATHS = frozenset({"/", "/healthz", "/readyz", "/api/v1/session"})
PAGE_FILES = ("/static/", "/docs")
"""Prefixes of the paths of dashboard and documentation."""
OF_TEST = re.compile(r"/tests/[^/]+(?=/)")
"""Prefix of the paths of a test in a service with several tests."""
MOST_WRONG, WRONG_EVERY_S = 10, 6.0
"""Wrong tokens of one address answered with 401: this many at once, then one every six seconds."""
MOST_ADDRESSES = 1000
LONGEST_TOKEN = 200
LONGEST_REASON = 400
"""Limit of the reason in the audit log: the host name of a foreign request may have any length."""


class AccessPolicy:
    """Access policy of a service; used only on the event loop.

    Parameters
    ----------
    no_person
        No token is required: for a reader inside this process, which can read the files of the folder anyway.
    """

    def __init__(self, web: WebSettings, data_folder: Path, *, no_person: bool = False) -> None:
        self._web, self._no_person = web, no_person
        self.tokens_path = find_tokens_file(web, data_folder)
        self.tokens = KnownTokens(self.tokens_path)
        self.audit = Audit(data_folder)
        # Cookies do not depend on the port: each service needs a different name.
        self._cookie = f"solimon-{hashlib.sha256(str(data_folder.absolute()).encode()).hexdigest()[:8]}"
        self._wrong: dict[str, Allowance] = {}

    @property
    def is_open(self) -> bool:
        """Return whether no token is required: with ``no_person``, or on loopback without any token yet."""
        return self._no_person or (not self._web.is_reachable and not self.tokens.asked_for)

    def choose_cookie_name(self, scope: Scope) -> str:
        """Return the name of the page's cookie for this service.

        Over TLS it has the prefix ``__Host-``, so that a browser binds it to the host.
        """
        return f"__Host-{self._cookie}" if is_encrypted(scope) else self._cookie

    def authenticate_request(self, scope: Scope) -> Person | None:
        """Return the person of a request; None if it has no token although one is required.

        Where none is required, the person has the role `CLAIMED` and no name.

        Raises
        ------
        Problem
            401, 429: the token is wrong. 403: the request was not encrypted.
        """
        headers = Headers(scope=scope)
        self._refuse_unencrypted(scope, headers)
        if self.is_open:
            return Person(name="", role=CLAIMED)
        text = self._read_token_text(scope, headers)
        return None if text is None else self.authenticate_token(text, find_client_address(scope))

    def authenticate_token(self, text: str, address: str) -> Person:
        """Return the person of a token; a wrong one counts against the limit of its address.

        Raises
        ------
        Problem
            401: the token is unknown, expired or revoked. 429: after 10 wrong ones, then one every 6 s.
        """
        token = self.tokens.find(text)
        if token is not None and token.state == "valid":
            return Person(name=token.name, role=token.role)
        if not self._find_allowance(address).try_take():
            raise Problem(
                "too-many-wrong-tokens",
                f"More than {MOST_WRONG} wrong tokens came from {address}; a right one is always let in.",
            )
        reason = "the token is unknown" if token is None else f"the token of {token.name} is {token.state}"
        raise Problem("wrong-token", f"{reason[0].upper()}{reason[1:]}.")

    def has_access(self, person: Person) -> bool:
        """Return whether a person still has access; open streams check it again.

        `CLAIMED` has access while no token is required, others while they have a valid token with their role.
        """
        if person.role == CLAIMED:
            return self.is_open
        return self.tokens.has_valid_token(person.name, person.role)

    async def audit_rejection(self, scope: Scope, reason: str, *, what: str = "enter") -> None:
        """Append a rejection with reason (up to 400 characters) and request id to the audit log, in a thread.

        Rejections above the rate limit are only counted. The request itself is not logged, because it may
        contain a token.
        """
        person: Person | None = scope.get("state", {}).get("person")
        await asyncio.to_thread(
            self.audit.add,
            author=person.name if person else "",
            role=person.role if person else "",
            source=find_client_address(scope),
            what=what,
            arguments={"request_id": read_request_id(scope)},
            result="rejected",
            reason=reason[:LONGEST_REASON],
        )

    def _read_token_text(self, scope: Scope, headers: Headers) -> str | None:
        """Return the token of a request from its header or else its cookie; None without one.

        An Authorization header of another scheme gives an empty, thus wrong, token.
        """
        scheme, _, text = headers.get("authorization", "").partition(" ")
        if scheme:
            return text.strip() if scheme.lower() == "bearer" else ""
        try:
            morsel = SimpleCookie(headers.get("cookie", "")).get(self.choose_cookie_name(scope))
        except CookieError:
            return None
        return None if morsel is None else morsel.value

    def _refuse_unencrypted(self, scope: Scope, headers: Headers) -> None:
        """Raise a Problem (403) if a reachable service gets an unencrypted request that is not local.

        Local means that both host and client address are those of the loopback.
        """
        if not self._web.is_reachable or is_encrypted(scope):
            return
        host = urlsplit(f"//{headers.get('host', '')}").hostname
        if host not in LOOPBACK or not _is_loopback(find_client_address(scope)):
            raise Problem(
                "not-encrypted",
                f"A request to {host} from {find_client_address(scope)} was neither TLS nor handed on by "
                f"web.proxy ({self._web.proxy or 'none'}) with X-Forwarded-Proto: https.",
            )

    def _find_allowance(self, address: str) -> Allowance:
        """Return the rate limit for wrong tokens of an address; create it at the first wrong one.

        The limits of the 1000 addresses that were wrong last are kept.
        """
        allowance = self._wrong.pop(address, None) or Allowance(MOST_WRONG, WRONG_EVERY_S)
        self._wrong[address] = allowance
        if len(self._wrong) > MOST_ADDRESSES:
            del self._wrong[next(iter(self._wrong))]
        return allowance


class AuthenticationMiddleware:
    """Middleware that allows only page and login without a token, where tokens are required."""

    def __init__(self, app: ASGIApp, policy: AccessPolicy, *, has_tests: bool = False) -> None:
        self._app, self._policy, self._has_tests = app, policy, has_tests

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Store the person and pass authorized requests on; answer the others with a problem and audit them.

        Paths of the page, health checks and login need no token.
        """
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        person, problem = None, None
        try:
            person = self._policy.authenticate_request(scope)
        except Problem as rejection:
            problem = rejection
        path = OF_TEST.sub("", scope["path"], count=1) if self._has_tests else scope["path"]
        if path in PUBLIC_PATHS or path.startswith(PAGE_FILES):
            # Page, health checks and login are public, but not without encryption.
            problem = problem if problem is not None and problem.status == 403 else None
        elif person is None and problem is None:
            problem = create_token_required_error()
        scope.setdefault("state", {})["person"] = person
        if problem is None:
            await self._forward_request(scope, receive, send)
            return
        if problem.status == 429:
            self._policy.audit.count_omitted_rejection()
        elif problem.name != "no-token" or _is_write_request(scope):
            await self._policy.audit_rejection(scope, problem.detail)
        await build_problem_response(scope, problem)(scope, receive, send)

    async def _forward_request(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Forward a request to the application, and audit a write that is answered with 422."""
        statuses: list[int] = []

        async def send_and_note_status(message: Message) -> None:
            """Send a message of the response and store its status."""
            if message["type"] == "http.response.start":
                statuses.append(message["status"])
            await send(message)

        await self._app(scope, receive, send_and_note_status if _is_write_request(scope) else send)
        if 422 in statuses:
            what = getattr(scope.get("route"), "name", None) or "enter"
            await self._policy.audit_rejection(scope, "the request was not valid", what=what)


def _is_write_request(scope: Scope) -> bool:
    """Return whether a request is HTTP with a method other than GET, HEAD and OPTIONS."""
    return scope["type"] == "http" and scope["method"] not in {"GET", "HEAD", "OPTIONS"}


def create_token_required_error() -> Problem:
    """Create, without raising it, the error that a request needs a token (401)."""
    return Problem("no-token", "This service asks for an access token.")


def read_request_person(connection: HTTPConnection) -> Person:
    """Return the person that `AuthenticationMiddleware` stored with a request.

    Raises
    ------
    Problem
        401: not logged in.
    """
    person: object = getattr(connection.state, "person", None)
    if person is None:
        raise create_token_required_error()
    assert isinstance(person, Person)
    return person


def is_encrypted(scope: Scope) -> bool:
    """Return whether the request came over TLS, to the server or to a trusted proxy."""
    return scope["scheme"] in {"https", "wss"}


def find_client_address(scope: Scope) -> str:
    """Return the network address of a client as the server reports it (behind a trusted proxy, the header's).

    ``unknown`` without one.
    """
    client = scope.get("client")
    return str(client[0]) if client else "unknown"


def _is_loopback(address: str) -> bool:
    """Return whether an address is that of this computer; a text that is no IP address is not."""
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False


def refuse_unprotected_service(web: WebSettings, data_folder: Path) -> None:
    """Raise UsageError unless a reachable service has a valid token, and TLS a usable certificate.

    Raises
    ------
    UsageError
        A token, or a certificate that can be used, is missing.
    StorageError
        The tokens file cannot be read.
    """
    path = find_tokens_file(web, data_folder)
    if web.is_reachable and not any(token.state == "valid" for token in read_tokens(path)):
        raise UsageError(
            f"other computers shall reach the service (web.host is {web.host!r}, web.host_names "
            f"{list(web.host_names)}), and {path} holds no valid access token; make one with "
            "`solimon token create NAME --role admin`, or keep to 127.0.0.1"
        )
    if web.has_tls:
        try:
            ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(
                web.tls_certificate, web.tls_key, password=_refuse_password_prompt
            )
        except (OSError, ValueError) as error:
            raise UsageError(
                f"web.tls_certificate {web.tls_certificate} and web.tls_key {web.tls_key} cannot be used: "
                f"{error}; give readable PEM files, the key being this certificate's and without a password"
            ) from error


def _refuse_password_prompt() -> str:
    """Raise ValueError instead of prompting for the password of a private key."""
    raise ValueError("the key has a password")
