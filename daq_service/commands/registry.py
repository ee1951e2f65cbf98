"""All kinds of commands, by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, get_args

from pydantic import Field, ValidationError

from daq_service.commands.baselines import ApproveBaseline, RenewBaseline
from daq_service.commands.kinds import (
    AcknowledgeAlarm,
    Annotate,
    Command,
    Disable,
    Enable,
    FinishNow,
    Pause,
    Resume,
    Stop,
    Strike,
    SupplyOff,
    SupplyOn,
    TrustClock,
    WithdrawAnnotation,
)
from daq_service.commands.suppression import ReturnToService, ShelveAlarm, TakeOutOfService, UnshelveAlarm
from daq_service.errors import UsageError

AnyCommand = Annotated[
    FinishNow
    | Stop
    | AcknowledgeAlarm
    | Pause
    | Resume
    | TrustClock
    | Disable
    | Enable
    | Strike
    | SupplyOn
    | SupplyOff
    | Annotate
    | WithdrawAnnotation
    | ShelveAlarm
    | UnshelveAlarm
    | TakeOutOfService
    | ReturnToService
    | ApproveBaseline
    | RenewBaseline,
    Field(discriminator="kind"),
]
KINDS: Mapping[str, type[Command]] = {
    get_args(order.model_fields["kind"].annotation)[0]: order for order in get_args(get_args(AnyCommand)[0])
}


def parse_command(kind: str, author: str, arguments: Mapping[str, object]) -> Command:
    """Parse and validate a command that does not come as JSON from the web service.

    Raises
    ------
    UsageError
        An unknown kind, or what is wrong with its author or arguments.
    """
    if kind not in KINDS:
        raise UsageError(f"unknown order {kind!r}; there are {', '.join(KINDS)}")
    try:
        return KINDS[kind].model_validate({"kind": kind, "author": author, "arguments": arguments})
    except ValidationError as error:
        problems = [f"{'.'.join(map(str, part['loc']))}: {part['msg']}" for part in error.errors()]
        raise UsageError("; ".join(problems)) from error
