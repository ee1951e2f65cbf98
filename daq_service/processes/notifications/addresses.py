"""Addresses and secrets of receivers: read from where the settings state, and never shown."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import urlsplit

from daq_service.alarms.guidance import GUIDANCE
from daq_service.errors import UsageError
from daq_service.settings.notifications import NotificationSettings, ReceiverSettings, find_webhook_url_error
from daq_service.shared_file import read_shared

SHORTEST_SECRET = 16
_SCHEME = re.compile(r"[a-z0-9.+-]{1,40}(?=://)")


@dataclass(frozen=True, slots=True, repr=False)
class Address:
    """Address and secret of a receiver, without a text form, so that no log can hold it."""

    url: str
    secret: bytes


def read_address(
    name: str, receiver: ReceiverSettings, environment: Mapping[str, str] = os.environ
) -> Address:
    """Read the address and the secret of a receiver from settings, file or environment variable.

    They are read at each call, so a change applies at once. For apprise the secret is empty.

    Raises
    ------
    UsageError
        One is missing or invalid (a secret has 16 characters or more), or apprise is not installed; the
        message does not repeat it.
    """
    url = receiver.url or _read_configured_text(name, "url", receiver.url_file, receiver.url_env, environment)
    if receiver.kind == "apprise":
        if find_spec("apprise") is None:
            raise _build_receiver_error(name, 'e-mail and chat need the extra: pip install "solimon[notify]"')
        if not _SCHEME.match(url.lower()):
            raise _build_receiver_error(name, "the address is none of apprise; give one like mailtos://...")
        return Address(url, b"")
    if refusal := find_webhook_url_error(url, plain_http=receiver.plain_http):
        raise _build_receiver_error(name, f"the address is refused: {refusal}")
    secret = _read_configured_text(name, "secret", receiver.secret_file, receiver.secret_env, environment)
    if len(secret) < SHORTEST_SECRET:
        raise _build_receiver_error(
            name, f"the secret has {len(secret)} characters; give one of {SHORTEST_SECRET} or more"
        )
    return Address(url, secret.encode())


def hide_address_secrets(receiver: ReceiverSettings) -> str:
    """Return scheme, host and port of a receiver's URL, or the name of the variable or file with it."""
    if receiver.url:
        parts = urlsplit(receiver.url)
        return f"{parts.scheme}://{parts.netloc}"
    place = f"the variable {receiver.url_env}" if receiver.url_env else Path(receiver.url_file).name
    return f"from {place}"


def validate_receivers(settings: NotificationSettings) -> None:
    """Read every receiver's address and secret, and check the alarm kinds of the rules.

    Raises
    ------
    UsageError
        An address, a secret or a kind is missing, invalid or unknown; the first one is reported.
    """
    for name, receiver in settings.receivers.items():
        read_address(name, receiver)
    for number, rule in enumerate(settings.rules, start=1):
        if unknown := sorted(set(rule.kinds) - GUIDANCE.keys()):
            raise UsageError(
                f"notifications.rules, rule {number}: there is no kind of alarm {unknown[0]!r}; there are "
                f"{', '.join(sorted(GUIDANCE))}"
            )


def _read_configured_text(
    name: str, key: str, file: str, variable: str, environment: Mapping[str, str]
) -> str:
    """Read an address or secret from its variable, or else from its file of one line, without outer spaces.

    Raises UsageError if it is empty, unreadable, not UTF-8 or has several lines.
    """
    if variable:
        text = environment.get(variable, "").strip()
        if not text:
            problem = f"the variable {variable} of {key}_env is not set; set it for the web service"
            raise _build_receiver_error(name, problem)
        return text
    try:
        text = read_shared(Path(file)).decode().strip()
    except OSError as error:
        raise _build_receiver_error(name, f"{key}_file {file} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError:
        raise _build_receiver_error(name, f"{key}_file {file} is not UTF-8 text; save it as such") from None
    if not text or len(text.splitlines()) != 1:
        raise _build_receiver_error(name, f"{key}_file {file} must hold exactly one line")
    return text


def _build_receiver_error(name: str, problem: str) -> UsageError:
    """Create, without raising it, the UsageError for a receiver, with its key and the problem."""
    return UsageError(f"notifications.receivers.{name}: {problem}")
