"""Deadline of a command: the same for the recorder, the command line and the web service."""

from __future__ import annotations

import time
from dataclasses import replace

from daq_service.catalogue import Catalogue
from daq_service.catalogue.rows import CommandRow
from daq_service.clock import boot_name, elapsed_ns
from hardware_drivers.nanoseconds import NS_PER_S


def compute_remaining_s(row: CommandRow, *, boot: str | None, boot_ns: int, wall_utc_ns: int) -> float:
    """Return the remaining time in s in which a command must be started; 0 after its deadline or without one.

    Within a boot the boot's clock counts, so a step of UTC has no effect. A command of another boot has
    expired. UTC counts if the name of either boot is unknown.

    Parameters
    ----------
    boot, boot_ns, wall_utc_ns
        Current values: name of this boot (None: unknown), its time in ns, and UTC in ns.
    """
    if row.deadline_wall_utc_ns is None or row.deadline_boot_ns is None:
        return 0.0  # of an older version
    if row.boot_id is None or boot is None:
        return max(0.0, (row.deadline_wall_utc_ns - wall_utc_ns) / NS_PER_S)
    return max(0.0, (row.deadline_boot_ns - boot_ns) / NS_PER_S) if row.boot_id == boot else 0.0


def remaining_now_s(row: CommandRow) -> float:
    """Return the remaining time in s from now in which a command must be started; 0 after its deadline."""
    return compute_remaining_s(row, boot=boot_name(), boot_ns=elapsed_ns(), wall_utc_ns=time.time_ns())


def mark_if_expired(row: CommandRow, seconds_left: float) -> CommandRow:
    """Return a copy of the row with state ``expired`` and a result if it is pending with no seconds left.

    Any other row is returned unchanged; nothing is stored.
    """
    if row.state != "pending" or seconds_left > 0.0:
        return row
    return replace(row, state="expired", result=describe_expiry("its deadline passed before that"))


def read_command_state(catalogue: Catalogue, order_id: int) -> tuple[CommandRow, float] | None:
    """Read a command and its remaining time in s; None if there is no command with this id.

    A pending command after its deadline is returned as expired, but not stored so. Errors of the catalogue
    pass through.
    """
    row = catalogue.command(order_id)
    if row is None:
        return None
    seconds_left = remaining_now_s(row)
    # Read again: it may have been started between the first query and its deadline.
    row = catalogue.command(order_id) or row
    return mark_if_expired(row, seconds_left), seconds_left


def describe_expiry(reason: str) -> str:
    """Return the answer text for a command that was not executed, with the reason and the remedy."""
    return f"not executed: {reason}; send it again if it is still needed"
