"""What a person's role allows: asked before every operation of the API, and by the routes of orders."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import Depends
from fastapi.routing import APIRoute
from starlette.requests import HTTPConnection

from daq_service.commands.audit import Result
from daq_service.web.answers.problem import Problem
from daq_service.web.auth.middleware import address_of, person_at
from daq_service.web.auth.roles import OPERATIONS, Person, Role
from daq_service.web.context import context_at

OF_THE_DOORS = frozenset({"log_in", "log_out", "create_token", "revoke_token"})
"""Audited beside the tokens; all else beside the test that it is about."""


async def _person_at(connection: HTTPConnection) -> Person:
    """As `person_at`: a plain function would cost each request a thread, and a place in their line."""
    return person_at(connection)


PersonOf = Annotated[Person, Depends(_person_at)]


def operation_of(route: Any) -> str:
    """Name of an operation, as the table of roles calls it."""
    return str((isinstance(route, APIRoute) and route.operation_id) or route.name)


async def admit(connection: HTTPConnection) -> None:
    """Refuse an operation that the role does not allow; a dependency of every route of the API.

    Raises
    ------
    Problem
        401: nobody has said who asks. 403: the role is too low.
    """
    operation = operation_of(connection.scope["route"])
    needed = OPERATIONS.get(operation, "admin")
    if needed is not None:
        person = person_at(connection)
        if not person.may(needed):
            problem = role_too_low(person, operation, needed)
            await asyncio.to_thread(told, connection, person, operation, "refused", problem.detail)
            raise problem


def role_too_low(person: Person, what: str, needed: Role) -> Problem:
    """Say which role is needed."""
    return Problem(
        403,
        "role-too-low",
        "Your role does not allow this",
        f"{what} needs the role {needed}; {person.name} is {person.role}.",
        "Ask somebody with that role, or an administrator for another token.",
    )


def told(
    connection: HTTPConnection,
    person: Person,
    what: str,
    result: Result,
    why: str = "",
    *,
    arguments: Mapping[str, Any] | None = None,
    claimed: str = "",
    command_id: int | None = None,
) -> None:
    """Write into the audit what a person asked for."""
    context = context_at(connection)
    audit = context.doors.audit if what in OF_THE_DOORS else context.audit
    audit.add(
        who=person.name or claimed,
        role=person.role,
        source=address_of(connection.scope),
        what=what,
        arguments=dict(arguments or {}),
        result=result,
        why=why,
        command_id=command_id,
    )
