"""What one check says: how it stands, what was found, what to do."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from daq_service import errors
from daq_service.clock import boot_id
from hardware_drivers.errors import BusyError, InstrumentError
from hardware_drivers.kinds import Finding
from hardware_drivers.measurement import Stamp

State = Literal["ok", "warn", "fail", "skipped"]
Area = Literal["software", "folder", "machine", "recorder", "rig"]

Value = float | str | bool | None

EXIT_CODES: Mapping[Area, int] = {
    # In this order: the first area that failed gives the exit code.
    "recorder": errors.BusyError.exit_code,
    "rig": errors.RigError.exit_code,
    "machine": errors.RigError.exit_code,
    "folder": errors.StorageError.exit_code,
    "software": errors.UsageError.exit_code,
}

HELD = "end the program that holds it, or wait until that ends; nothing of it was touched"


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One thing that was looked at.

    Attributes
    ----------
    name
        What was looked at: ``transducer B: trigger``.
    found
        In words, with units.
    remedy
        What to do; every check that is not ``ok`` has one, and what is ``ok`` keeps none.
    values
        The same for programs, SI units in the names.
    """

    area: Area
    name: str
    state: State = "ok"
    found: str
    remedy: str = ""
    values: Mapping[str, Value] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.state == "ok":
            object.__setattr__(self, "remedy", "")
        elif not self.remedy:
            raise ValueError(f"the check {self.name!r} is {self.state!r} and needs a remedy")


def exit_code(checks: Sequence[Check]) -> int:
    """Exit code of a checkup: 0 where nothing failed."""
    failed = {check.area for check in checks if check.state == "fail"}
    return next((code for area, code in EXIT_CODES.items() if area in failed), errors.EXIT_OK)


def failure(name: str, error: InstrumentError, otherwise: str) -> Check:
    """Check of an instrument that ended in an error; messages of this project end in their remedy.

    Parameters
    ----------
    otherwise
        Remedy where the message has none.
    """
    if isinstance(error, BusyError):
        # Whoever holds an instrument stands where a recorder does.
        return Check(area="recorder", name=name, state="fail", found=str(error), remedy=HELD)
    problem, _, remedy = str(error).rpartition("; ")
    if not problem:
        problem, remedy = str(error), otherwise
    return Check(area="rig", name=name, state="fail", found=problem, remedy=remedy)


def told(finding: Finding, of: str = "") -> Check:
    """Give the check that an instrument's finding is.

    Parameters
    ----------
    of
        Name of the instrument, where there are several.
    """
    name = ": ".join(filter(None, (of, finding.subject, finding.check)))
    if finding.held:
        # Whoever holds an instrument stands where a recorder does.
        return Check(area="recorder", name=name, state="fail", found=finding.detail, remedy=HELD)
    return Check(
        area="rig",
        name=name,
        state=finding.state,
        found=finding.detail,
        remedy=finding.remedy or "see what its maker says of it",
        values=finding.values,
    )


def stamp_now() -> Stamp:
    """Time on this computer's own clocks."""
    return Stamp(utc_ns=time.time_ns(), mono_ns=time.monotonic_ns(), boot_id=boot_id())
