"""The table of the web service: where it answers, to whom, and what keeps others out."""

from __future__ import annotations

import ipaddress
import json
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

LOOPBACK = {"127.0.0.1": "127.0.0.1", "localhost": "127.0.0.1", "::1": "::1"}
"""Names of this machine for itself, and their addresses."""
HostName = Annotated[str, Field(pattern=r"^[a-z0-9]([a-z0-9.-]{0,251}[a-z0-9])?$")]


def is_ip_address(text: str) -> bool:
    """Return whether a text is an IPv4 or IPv6 address; host names are not."""
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True


class WebSettings(BaseModel):
    """The web service."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    host: str = Field(default="127.0.0.1", max_length=45)
    """Address of this computer to listen at; any but 127.0.0.1, localhost and ::1 needs TLS or a proxy, and
    tokens. 0.0.0.0 and :: are all of them."""
    port: int = Field(default=8750, ge=0, le=65535)
    """TCP port; 0 takes a free one."""
    host_names: tuple[HostName, ...] = ()
    """Names by which browsers reach the service from elsewhere; requests for others are refused."""
    tls_certificate: str = ""
    """PEM file of the service's own certificate with its chain, relative to the configuration file."""
    tls_key: str = ""
    """PEM file of its key, without a password, relative to the configuration file."""
    proxy: str = ""
    """Address of a proxy that terminates TLS; it alone is believed who asks (X-Forwarded-For and -Proto)."""
    tokens_file: str = ""
    """Hashes of the access tokens, relative to the configuration file; absent: tokens.json of the data
    folder. On loopback nothing is asked for until there is a token."""

    @field_validator("host", "proxy")
    @classmethod
    def _validate_ip_address(cls, text: str) -> str:
        """Return the text if it is empty, an IP address or a loopback name; raise ValueError otherwise."""
        if text and text not in LOOPBACK and not is_ip_address(text):
            raise ValueError("give an IP address of a computer; names belong into web.host_names")
        return text

    @field_validator("host")
    @classmethod
    def _require_host(cls, text: str) -> str:
        """Return the text; raise ValueError if it is empty."""
        if not text:
            raise ValueError("give an IP address of this computer, for example 127.0.0.1")
        return text

    @model_validator(mode="after")
    def _check_exposed_service(self) -> Self:
        """Return the table; raise ValueError if other computers reach the service without encryption or name.

        Encryption is a certificate with its key, which need each other, or a proxy.
        """
        if bool(self.tls_certificate) != bool(self.tls_key):
            raise ValueError("web.tls_certificate and web.tls_key belong together; give both or none")
        if self.is_reachable and not (self.tls_certificate or self.proxy):
            what = f"web.host is {self.host!r}"
            if self.host in LOOPBACK:
                what = f"web.host_names is {json.dumps(self.host_names)}"
            raise ValueError(
                f"{what}: other computers shall reach the service, so tokens and measurements must travel "
                "encrypted; set web.tls_certificate and web.tls_key, or web.proxy to the address of a proxy "
                f"that terminates TLS; or keep to this machine ({', '.join(LOOPBACK)})"
            )
        if self.is_reachable and not self.names_elsewhere:
            raise ValueError(
                "no host name is given for other computers; set web.host_names to how browsers call "
                'this computer, for example ["lab.example.org"]'
            )
        return self

    @property
    def is_reachable(self) -> bool:
        """Return whether other computers can reach the service, directly or through a proxy."""
        return self.host not in LOOPBACK or bool(self.host_names) or bool(self.proxy)

    @property
    def names_elsewhere(self) -> frozenset[str]:
        """Return the host names that requests may use in addition to those of the loopback.

        These are ``host_names``, and ``host`` unless it means all addresses.
        """
        own = {self.host} - LOOPBACK.keys()
        return frozenset(self.host_names) | {
            name for name in own if not ipaddress.ip_address(name).is_unspecified
        }

    @property
    def has_tls(self) -> bool:
        """Return whether the service itself encrypts, because a certificate is configured."""
        return bool(self.tls_certificate)
