"""What can go wrong for a reader.

::

    SolimonError
    └── ClientError          the answer is none, with what helps
        ├── RefusedError     the service says why (a problem of RFC 9457): `status`, `type`
        └── UnreachableError nobody answers at this address
"""

from __future__ import annotations

from daq_service.errors import SolimonError


class ClientError(SolimonError):
    """A test cannot be read as asked."""


class RefusedError(ClientError):
    """The service's own words."""

    def __init__(self, status: int, problem_type: str, told: str) -> None:
        super().__init__(told)
        self.status = status
        self.type = problem_type


class UnreachableError(ClientError):
    """No answer came."""
