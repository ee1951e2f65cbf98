"""Access tokens: shown once when created, stored as hashes in a file that a running service monitors.

A token is 256 random bits, so its SHA-256 needs neither salt nor a slow hash. Revoked tokens stay in the
file: an empty list means that no token was ever created.
"""

from __future__ import annotations

import hashlib
import hmac
import logging
import os
import re
import secrets
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter, ValidationError

from daq_service.clock import MACHINE, MachineClock, format_utc, parse_utc
from daq_service.errors import StorageError, StorageUnavailableError, UsageError
from daq_service.processes.data_folder import lock_for_change
from daq_service.settings.web import WebSettings
from daq_service.shared_file import read_shared, write_durably
from daq_service.web.auth.roles import Role
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

FILE_NAME = "tokens.json"
LOOK_EVERY_S = 1.0
"""Longest time for which a revoked token is still accepted."""
OWNER_ONLY = 0o600
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@-]{0,39}")
_S_PER_DAY = 86_400


@dataclass(frozen=True, slots=True, kw_only=True)
class Token:
    """Stored data of a token; times are RFC 3339."""

    name: str
    role: Role
    sha256: str
    created_utc: str
    expires_utc: str | None = None
    revoked_utc: str | None = None

    @property
    def state(self) -> Literal["valid", "expired", "revoked"]:
        """Return whether the token is valid, expired or revoked at present, by the computer's clock."""
        if self.revoked_utc is not None:
            return "revoked"
        is_expired = self.expires_utc is not None and parse_utc(self.expires_utc) <= time.time_ns()
        return "expired" if is_expired else "valid"


_FILE = TypeAdapter(tuple[Token, ...])


def find_tokens_file(web: WebSettings, data_folder: Path) -> Path:
    """Return the path of the configured tokens file, made absolute, or else of that in the data folder."""
    return Path(web.tokens_file).absolute() if web.tokens_file else data_folder / FILE_NAME


def read_tokens(path: Path) -> tuple[Token, ...]:
    """Read all tokens, expired and revoked ones too; none without a file.

    Raises
    ------
    StorageError
        The file cannot be read, or is no tokens file.
    """
    try:
        return _FILE.validate_json(read_shared(path))
    except FileNotFoundError:
        return ()
    except OSError as error:
        raise StorageUnavailableError(
            f"{path} cannot be read: {error.strerror}; check its permissions"
        ) from error
    except ValidationError as error:
        raise StorageError(
            f"{path} is not a file of access tokens; restore it from a copy, or remove it and make new ones "
            "with `solimon token create`"
        ) from error


def create_token(path: Path, name: str, role: Role, *, days: float | None = None) -> tuple[Token, str]:
    """Create a token, store its hash durably, and return its data and secret text, which is never stored.

    It replaces an expired or revoked token of the same name.

    Parameters
    ----------
    days
        Time until it expires; None: never.

    Raises
    ------
    UsageError
        The name is invalid, or has a valid token.
    StorageError
        The file cannot be read or written.
    """
    if not _NAME.fullmatch(name):
        raise UsageError(f"{name[:60]!r} is not a valid token name; use up to 40 letters, digits and . _ @ -")
    text, now_ns = secrets.token_urlsafe(32), time.time_ns()
    expires = None if days is None else format_utc(now_ns + round(days * _S_PER_DAY) * NS_PER_S, 0)
    token = Token(
        name=name, role=role, sha256=_hash_text(text), created_utc=format_utc(now_ns, 0), expires_utc=expires
    )
    with _edit_tokens(path) as tokens:
        if any(old.name == name and old.state == "valid" for old in tokens):
            raise UsageError(f"{name} has a token; revoke it first with `solimon token revoke {name}`")
        tokens[:] = [*(old for old in tokens if old.name != name), token]
    return token, text


def revoke_token(path: Path, name: str) -> Token:
    """Mark a token as revoked, store that durably, and return the token; it stays in the file.

    A running service rejects it within a second.

    Raises
    ------
    UsageError
        There is no unrevoked token of that name.
    StorageError
        The file cannot be read or written.
    """
    if not read_tokens(path):
        raise UsageError(f"there is no token {name[:60]!r} to revoke; {path} holds none")
    with _edit_tokens(path) as tokens:
        index = next((n for n, old in enumerate(tokens) if old.name == name and not old.revoked_utc), None)
        if index is None:
            names = ", ".join(old.name for old in tokens if not old.revoked_utc) or "none"
            raise UsageError(f"there is no token {name[:60]!r} to revoke; there are: {names}")
        tokens[index] = replace(tokens[index], revoked_utc=format_utc(time.time_ns(), 0))
        return tokens[index]


@contextmanager
def _edit_tokens(path: Path) -> Iterator[list[Token]]:
    """Lock the tokens file, yield its tokens for changes in place, and write them durably at the end.

    Nothing is written if the context raises. Waits up to 5 s for the lock. Raises StorageError if the file
    cannot be locked, read or written.
    """
    try:
        with lock_for_change(path):
            tokens = list(read_tokens(path))
            yield tokens
            content = _FILE.dump_json(tuple(tokens), indent=1)
            write_durably(path, content, temporary=path.with_suffix(".new"), mode=OWNER_ONLY)
    except OSError as error:
        raise StorageUnavailableError(
            f"{path} cannot be written: {error.strerror}; nothing has changed; make its folder writable"
        ) from error


def _hash_text(text: str) -> str:
    """Return the SHA-256 of a text as 64 hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()


class KnownTokens:
    """Tokens file in a running service, checked every second; used only on the event loop.

    Where the file is missing or unreadable after a token was created, all access is denied until it is back.
    """

    def __init__(self, path: Path, *, machine: MachineClock = MACHINE) -> None:
        self._path, self._machine = path, machine
        self._next_s = -1.0
        self._mark: tuple[int, ...] | None = None
        self._tokens: tuple[Token, ...] = ()
        self._asked_for = False

    @property
    def asked_for(self) -> bool:
        """Return whether a token was ever created, so that each request needs one."""
        self._reload_if_changed()
        return self._asked_for

    def find(self, text: str) -> Token | None:
        """Return the token with this secret text, valid or not; None if there is none.

        Hashes are compared in constant time.
        """
        self._reload_if_changed()
        sha256, match = _hash_text(text), None
        for token in self._tokens:
            if hmac.compare_digest(token.sha256, sha256):
                match = token
        return match

    def has_valid_token(self, name: str, role: str) -> bool:
        """Return whether a person has a token with exactly this role that is valid at present."""
        self._reload_if_changed()
        return any(
            token.name == name and token.role == role and token.state == "valid" for token in self._tokens
        )

    def _reload_if_changed(self) -> None:
        """Read the tokens again if their file has changed, checked at most once a second.

        An unreadable file leaves no token, so that all access is denied; it is logged.
        """
        if self._machine.mono_s() < self._next_s:
            return
        self._next_s = self._machine.mono_s() + LOOK_EVERY_S
        mark = _compute_file_mark(self._path)
        if mark == self._mark:
            return
        try:
            self._tokens = read_tokens(self._path)
        except StorageError as error:
            log.error("all requests are rejected: %s", error)
            self._tokens, self._asked_for = (), True
        was_asked_for = self._asked_for
        # The first token created the lock: after a restart, a lost tokens file still denies access.
        self._asked_for = was_asked_for or bool(self._tokens) or self._path.with_suffix(".lock").exists()
        if self._asked_for and not was_asked_for and not self._tokens:
            log.error("all requests are rejected: %s is gone; bring it back, or make new tokens", self._path)
        self._mark = mark


def _compute_file_mark(path: Path) -> tuple[int, ...]:
    """Return time (ns), size and inode of a file, to detect changes; if unreadable, the error number."""
    try:
        status = os.stat(path)  # noqa: PTH116 - the seam is os
    except OSError as error:
        return (error.errno or 0,)
    return status.st_mtime_ns, status.st_size, status.st_ino
