"""The table of notifications: who is told of alarms outside of the page, of which ones, and how soon.

An address that holds a password, and every secret, stands in a file or in a variable of the environment:
settings only name the place, so that no log, answer or copy of the configuration can tell it.
"""

from __future__ import annotations

import re
from typing import Annotated, Literal, Self
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from daq_service.settings.alarm_delays import EARLIER_ALARM_KINDS
from daq_service.settings.web import LOOPBACK

Priority = Literal["low", "medium", "high", "critical"]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,31}$")]
SHORTEST_FOR_PEOPLE_S = 3600.0
"""Between two heartbeat messages by e-mail or chat."""
MOST_RECEIVERS = 16
"""Each has a thread of its own."""
_VARIABLE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


def find_webhook_url_error(url: str, *, plain_http: bool) -> str:
    """Return the reason why a webhook's URL is rejected, without quoting the URL; empty if it is valid.

    ``http`` is valid only for the loopback or with ``plain_http``.
    """
    try:
        parts = urlsplit(url)
        _ = parts.port
    except ValueError:
        return "it is not an address; give one like https://alarms.example.org/solimon"
    if parts.scheme not in {"http", "https"} or not parts.hostname:
        return "it is not a web address; give one like https://alarms.example.org/solimon"
    if not url.isascii() or not url.isprintable() or " " in url:
        return "it has characters that an address cannot have; write them as %XX, and a host's name in ASCII"
    if parts.username is not None or parts.password is not None:
        return "it holds a name or a password; take them out: messages are signed with the secret"
    if parts.scheme == "http" and parts.hostname not in LOOPBACK and not plain_http:
        return (
            f"it is http:// to {parts.hostname}, so anybody on the way could read and change alarms; use "
            "https://, or set plain_http = true for this receiver"
        )
    return ""


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ReceiverSettings(_Table):
    """Receiver of notifications."""

    kind: Literal["webhook", "apprise"] = "webhook"
    """`webhook`: a signed POST of JSON; `apprise`: e-mail, chat and others, by the extra `notify`."""
    url: str = Field(default="", max_length=2000)
    """Address of a webhook that is no secret itself."""
    url_file: str = ""
    """File whose only line is the address, relative to the configuration file; apprise's addresses hold
    passwords."""
    url_env: str = ""
    """Variable of the environment that holds the address."""
    secret_file: str = ""
    """File whose only line is the webhook's secret (16 characters or more), relative to the configuration
    file."""
    secret_env: str = ""
    """Variable of the environment that holds the secret."""
    plain_http: bool = False
    """Allows http:// to another computer: messages travel unencrypted."""
    heartbeat_s: float | None = Field(default=None, ge=10.0, le=86_400.0)
    """Interval of heartbeat messages with the recorder's state and the age of the last set; absent: none. For
    e-mail and chat at least 3600 s. None is sent while no recorder responds: act when it is missing."""

    @model_validator(mode="after")
    def _check_required_keys(self) -> Self:
        """Return the table; ValueError unless it has exactly one address key and a webhook one secret key.

        A webhook's URL must be valid; apprise has no secret and a heartbeat of at least 3600 s.
        """
        places = ["url", "url_file", "url_env"] if self.kind == "webhook" else ["url_file", "url_env"]
        if self.kind == "apprise" and self.url:
            raise ValueError("an address of apprise holds a password; set it in url_file or url_env")
        self._require_exactly_one(places)
        if self.kind == "webhook":
            self._require_exactly_one(["secret_file", "secret_env"])
        elif self.secret_file or self.secret_env or self.plain_http:
            raise ValueError("secret_file, secret_env, plain_http are a webhook's; take them out for apprise")
        elif self.heartbeat_s is not None and self.heartbeat_s < SHORTEST_FOR_PEOPLE_S:
            raise ValueError(
                f"heartbeat_s = {self.heartbeat_s:g} is below {SHORTEST_FOR_PEOPLE_S:g}, the minimum for "
                f"e-mail and chat. Give {SHORTEST_FOR_PEOPLE_S:g} or more."
            )
        if self.url and (refusal := find_webhook_url_error(self.url, plain_http=self.plain_http)):
            raise ValueError(f"url: {refusal}")
        return self

    def _require_exactly_one(self, places: list[str]) -> None:
        """Raise ValueError unless exactly one of these keys has a value."""
        given = [name for name in places if getattr(self, name)]
        if len(given) != 1:
            found = " and ".join(given) or "none"
            raise ValueError(f"{found} of {', '.join(places)} is given; give exactly one")

    @field_validator("url_env", "secret_env")
    @classmethod
    def _check_variable_name(cls, name: str) -> str:
        """Return a valid environment variable name or an empty text.

        Raises ValueError for other characters or a name that begins with SOLIMON_.
        """
        if name and not _VARIABLE.fullmatch(name):
            raise ValueError("give the name of a variable, not what it holds: letters, digits and _")
        if name.upper().startswith("SOLIMON_"):
            raise ValueError("variables that begin with SOLIMON_ are the configuration's; choose another")
        return name


class RuleSettings(_Table):
    """Alarms for some receivers; the first rule that fits an alarm and a receiver counts."""

    receivers: tuple[Name, ...] = ()
    """Their names; empty: all."""
    priority: Priority = "medium"
    """Lowest priority that is sent."""
    positions: tuple[str, ...] = ()
    """Alarms of these positions; empty: of all, and those of the rig, the disk and the clock."""
    kinds: tuple[str, ...] = ()
    """Kinds of alarm, for example wall_change; empty: all (docs/how-to/respond-to-an-alarm.md lists them)."""
    delay_s: float = Field(default=0.0, ge=0.0, le=3600.0)
    """An alarm that returns to normal within this time is not sent."""
    group_s: float = Field(default=10.0, ge=0.0, le=3600.0)
    """Alarms within this time are sent as one message."""
    returned: bool = True
    """Also notify when an alarm returns to normal."""

    @model_validator(mode="before")
    @classmethod
    def _convert_old_names(cls, values: object) -> object:
        """Return the values with the current names of the key ``severity`` and of earlier alarm kinds.

        A value that is no table is returned unchanged, for validation to reject.
        """
        if not isinstance(values, dict):
            return values
        current = {"priority" if name == "severity" else name: value for name, value in values.items()}
        if isinstance(kinds := current.get("kinds"), list | tuple):
            current["kinds"] = [EARLIER_ALARM_KINDS.get(kind, kind) for kind in kinds]
        return current


class NotificationSettings(_Table):
    """Notifications by the web service."""

    receivers: dict[Name, ReceiverSettings] = Field(default_factory=dict, max_length=MOST_RECEIVERS)
    """Receivers by name; without any nothing is sent."""
    rules: tuple[RuleSettings, ...] = Field(default=(RuleSettings(),), min_length=1, max_length=100)
    """Absent: every alarm of priority medium or more to all receivers."""
    give_up_h: float = Field(default=24.0, gt=0.0, le=720.0)
    """Time after which an undelivered message is given up; the delivery log records it."""

    @model_validator(mode="after")
    def _require_known_receivers(self) -> Self:
        """Return the table; raise ValueError for the first rule that names an unknown receiver."""
        for number, rule in enumerate(self.rules, start=1):
            if unknown := sorted(set(rule.receivers) - set(self.receivers)):
                raise ValueError(
                    f"rule {number} names the receiver {unknown[0]!r}; there are "
                    f"{', '.join(self.receivers) or 'none'}: add [notifications.receivers.{unknown[0]}], or "
                    "correct the name"
                )
        return self

    def require_known_positions(self, positions: list[str]) -> None:
        """Require that the rules name only positions of this list.

        Raises
        ------
        ValueError
            A rule names an unknown position: the number of the rule, counted from 1, and the valid names.
        """
        for number, rule in enumerate(self.rules, start=1):
            if unknown := sorted(set(rule.positions) - set(positions)):
                raise ValueError(
                    f"notifications.rules, rule {number}: there is no position {unknown[0]!r}; the positions "
                    f"are {', '.join(positions)}"
                )
