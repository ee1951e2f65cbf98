"""Authorization by role, before every operation of the API and for each command."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Annotated

from fastapi import Depends
from starlette.requests import HTTPConnection

from daq_service.commands.audit import Result
from daq_service.web.answers.problem import Problem
from daq_service.web.auth.middleware import find_client_address, read_request_person
from daq_service.web.auth.roles import OPERATIONS, Person, Role
from daq_service.web.context import find_request_context

TOKEN_OPERATIONS = frozenset({"log_in", "log_out", "create_token", "revoke_token"})
"""Audited in the folder of the tokens; all other operations in that of the test."""


async def _provide_person(connection: HTTPConnection) -> Person:
    """Return `read_request_person` as dependency of routes; as a coroutine it needs no thread of the pool.

    Raises a Problem (401) without login.
    """
    return read_request_person(connection)


PersonOf = Annotated[Person, Depends(_provide_person)]


async def require_role(connection: HTTPConnection) -> None:
    """Raise a problem if the role does not allow the operation; a dependency of every route of the API.

    A role that is too low is written to the audit log. An operation without an entry requires admin.

    Raises
    ------
    Problem
        401: not logged in. 403: the role is too low.
    """
    operation: str = connection.scope["route"].name
    needed = OPERATIONS.get(operation, "admin")
    if needed is not None:
        person = read_request_person(connection)
        if not person.may(needed):
            problem = create_role_too_low(person, operation, needed)
            await asyncio.to_thread(
                write_audit_entry, connection, person, operation, "rejected", problem.detail
            )
            raise problem


def create_role_too_low(person: Person, operation: str, needed: Role) -> Problem:
    """Create, without raising it, the error that an operation needs a higher role (403)."""
    return Problem("role-too-low", f"{operation} needs the role {needed}; {person.name} is {person.role}.")


def write_audit_entry(
    connection: HTTPConnection,
    person: Person,
    operation: str,
    result: Result,
    reason: str = "",
    *,
    arguments: Mapping[str, object] | None = None,
    claimed: str = "",
    command_id: int | None = None,
) -> None:
    """Append a request of a person and its result to the audit log; blocks until it is written.

    Operations on tokens are logged in the folder of the service, others in that of the test. ``claimed`` is
    the author if the person has no name. Rejections above the rate limit are only counted, and a disk error
    is only logged.
    """
    context = find_request_context(connection)
    audit = context.access_policy.audit if operation in TOKEN_OPERATIONS else context.audit
    audit.add(
        author=person.name or claimed,
        role=person.role,
        source=find_client_address(connection.scope),
        what=operation,
        arguments=dict(arguments or {}),
        result=result,
        reason=reason,
        command_id=command_id,
    )
