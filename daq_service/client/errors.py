"""Errors of the client.

::

    SolimonError
    └── ClientError          no valid answer, with the remedy
        ├── RefusedError     the service refuses (a problem of RFC 9457): `status`, `type`
        └── UnreachableError no service answers at this address
"""

from __future__ import annotations

from daq_service.errors import SolimonError


class ClientError(SolimonError):
    """A test cannot be read as requested."""


class RefusedError(ClientError):
    """The service refuses a request; the message is its reason."""

    def __init__(self, status: int, problem_type: str, reason: str) -> None:
        super().__init__(reason)
        self.status = status
        self.type = problem_type


class UnreachableError(ClientError):
    """No service answers."""
