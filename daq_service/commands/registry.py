"""All kinds of commands, by name: the classes of this package whose field ``kind`` has one value."""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, get_args

from pydantic import Field, ValidationError

from daq_service.commands import baselines, kinds, suppression
from daq_service.commands.kinds import Command
from daq_service.errors import UsageError

KINDS: Mapping[str, type[Command]] = {
    get_args(command.model_fields["kind"].annotation)[0]: command
    for module in (kinds, suppression, baselines)
    for command in vars(module).values()
    if isinstance(command, type)
    and issubclass(command, Command)
    and get_args(command.model_fields["kind"].annotation)
}
if TYPE_CHECKING:
    AnyCommand = Command
else:
    AnyCommand = Annotated[reduce(or_, KINDS.values()), Field(discriminator="kind")]


def parse_command(kind: str, author: str, arguments: Mapping[str, object]) -> Command:
    """Build a validated command of a registered kind from its name, author and arguments.

    Raises
    ------
    UsageError
        The kind is unknown, or author or arguments are not valid; the message lists every problem.
    """
    if kind not in KINDS:
        raise UsageError(f"unknown command {kind!r}; there are {', '.join(KINDS)}")
    try:
        return KINDS[kind].model_validate({"kind": kind, "author": author, "arguments": arguments})
    except ValidationError as error:
        problems = [f"{'.'.join(map(str, part['loc']))}: {part['msg']}" for part in error.errors()]
        raise UsageError("; ".join(problems)) from error
