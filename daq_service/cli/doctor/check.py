"""Result of a check: state, finding, remedy."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from daq_service import errors
from daq_service.clock import read_boot_id
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


@dataclass(frozen=True, slots=True)
class Check:
    """Result of one check.

    Attributes
    ----------
    name
         Subject of the check: ``transducer B: trigger``.
    found
         Finding in words, with units.
    remedy
        What to do; only a check that is ``ok`` has none.
    values
        The same for programs, SI units in the names.
    """

    area: Area
    name: str
    state: State
    found: str
    remedy: str = ""
    values: Mapping[str, Value] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Remove the remedy of a check that is ok; raise ValueError if another check has none."""
        if self.state == "ok":
            object.__setattr__(self, "remedy", "")
        elif not self.remedy:
            raise ValueError(f"the check {self.name!r} is {self.state!r} and needs a remedy")


def choose_exit_code(checks: Sequence[Check]) -> int:
    """Return 0 if no check failed, otherwise the exit code of the first failed area in `EXIT_CODES`.

    Warnings and skipped checks do not count.
    """
    failed = {check.area for check in checks if check.state == "fail"}
    return next((code for area, code in EXIT_CODES.items() if area in failed), errors.EXIT_OK)


def build_error_check(name: str, error: InstrumentError, otherwise: str) -> Check:
    """Create the failed check for an instrument's error, whose message may contain the remedy.

    Text after the last ``; `` of the message is the remedy. An instrument that another program holds gives a
    check of area ``recorder``, any other error one of area ``rig``.

    Parameters
    ----------
    otherwise
        Remedy if the message contains none.
    """
    if isinstance(error, BusyError):
        # A program that holds an instrument counts like a recorder.
        return Check("recorder", name, "fail", str(error), HELD)
    problem, _, remedy = str(error).rpartition("; ")
    if not problem:
        problem, remedy = str(error), otherwise
    return Check("rig", name, "fail", problem, remedy)


def build_finding_check(finding: Finding, instrument: str = "") -> Check:
    """Convert a finding of an instrument driver to a check of area ``rig``.

    A finding that another program holds the instrument gives a failed check of area ``recorder``. A finding
    without a remedy gets a general one.

    Parameters
    ----------
    instrument
        Name of the instrument, prefixed to the check's name; empty if there is only one.
    """
    name = ": ".join(filter(None, (instrument, finding.subject, finding.check)))
    if finding.held:
        # A program that holds an instrument counts like a recorder.
        return Check("recorder", name, "fail", finding.detail, HELD)
    remedy = finding.remedy or "read its maker's documentation"
    return Check("rig", name, finding.state, finding.detail, remedy, finding.values)


def read_time_stamp() -> Stamp:
    """Return the present UTC and monotonic time, ns, and the boot id of this computer."""
    return Stamp(utc_ns=time.time_ns(), mono_ns=time.monotonic_ns(), boot_id=read_boot_id())
