"""Roles required by each operation of the interface and each kind of command, from ``roles.toml``.

An operation is named by its `operationId`, a WebSocket or HEAD by its function; an unlisted one requires
admin, and `tests/contract/test_roles.py` fails. Each role may do what those before it may.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from pydantic import BaseModel

from daq_service.shared_file import load_module_toml

Role = Literal["viewer", "operator", "engineer", "admin"]
ROLES: tuple[Role, ...] = get_args(Role)
CLAIMED = "claimed"
"""Replaces a role where no token is required: everything is allowed, under an unverified name."""


class _Table(BaseModel, frozen=True, extra="forbid"):
    operations: Mapping[str, Role | Literal["public"]]
    commands: Mapping[str, Role]


_TABLE = _Table.model_validate(load_module_toml(__file__))
OPERATIONS: Mapping[str, Role | None] = {
    name: None if role == "public" else role for name, role in _TABLE.operations.items()
}
"""Role of each operation; None: it is public."""
ORDERS = _TABLE.commands
"""Role of each kind of command."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Person:
    """Person of a request.

    Attributes
    ----------
    name
        Name of the token; empty where none is required.
    role
        Role of the token, or `CLAIMED`.
    """

    name: str
    role: str

    def may(self, needed: Role | None) -> bool:
        """Return whether this person's role includes the rights of the ``needed`` role; None needs none."""
        return needed is None or self.role == CLAIMED or self.role in ROLES[ROLES.index(needed) :]

    def list_permissions(self) -> list[str]:
        """List the names of the operations and kinds of commands that this person may use, sorted."""
        return sorted({name for name, needed in {**OPERATIONS, **ORDERS}.items() if self.may(needed)})
