"""Authorization by role, before every operation of the API and for each command."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Annotated

from fastapi import Depends
from starlette.requests import HTTPConnection

from daq_service.commands.audit import Result
from daq_service.web.answers.problem import Problem
from daq_service.web.auth.middleware import address_of, person_at
from daq_service.web.auth.roles import OPERATIONS, Person, Role
from daq_service.web.context import context_at

TOKEN_OPERATIONS = frozenset({"log_in", "log_out", "create_token", "revoke_token"})
"""Audited in the folder of the tokens; all other operations in that of the test."""


async def _person_dependency(connection: HTTPConnection) -> Person:
    """Return `person_at`; as a coroutine it needs no thread of the pool."""
    return person_at(connection)


PersonOf = Annotated[Person, Depends(_person_dependency)]


async def admit(connection: HTTPConnection) -> None:
    """Check that the role allows an operation; a dependency of every route of the API.

    Raises
    ------
    Problem
        401: not logged in. 403: the role is too low.
    """
    operation: str = connection.scope["route"].name
    needed = OPERATIONS.get(operation, "admin")
    if needed is not None:
        person = person_at(connection)
        if not person.may(needed):
            problem = role_too_low(person, operation, needed)
            await asyncio.to_thread(
                write_audit_entry, connection, person, operation, "rejected", problem.detail
            )
            raise problem


def role_too_low(person: Person, operation: str, needed: Role) -> Problem:
    """Return the problem that a higher role is needed (403)."""
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
    """Write a request of a person and its result to the audit log."""
    context = context_at(connection)
    audit = context.access_policy.audit if operation in TOKEN_OPERATIONS else context.audit
    audit.add(
        author=person.name or claimed,
        role=person.role,
        source=address_of(connection.scope),
        what=operation,
        arguments=dict(arguments or {}),
        result=result,
        reason=reason,
        command_id=command_id,
    )
