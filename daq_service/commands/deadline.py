"""Until when an order stands: told the same by the recorder, the command line and the web."""

from __future__ import annotations

import time
from dataclasses import replace

from daq_service.catalogue import Catalogue
from daq_service.catalogue.rows import CommandRow
from daq_service.clock import boot_name, elapsed_ns
from hardware_drivers.nanoseconds import NS_PER_S


def left_s(row: CommandRow, *, boot: str | None, boot_ns: int, wall_utc_ns: int) -> float:
    """Time that an order has left to be begun; 0 where it has none.

    Within a boot a step of UTC changes nothing; an order of another boot has expired.

    Parameters
    ----------
    boot, boot_ns, wall_utc_ns
        Now: name of this boot (None: it has none, then UTC counts), time of it, and UTC.
    """
    if row.deadline_wall_utc_ns is None or row.deadline_boot_ns is None:
        return 0.0  # of an older version
    if row.boot_id is None or boot is None:
        return max(0.0, (row.deadline_wall_utc_ns - wall_utc_ns) / NS_PER_S)
    return max(0.0, (row.deadline_boot_ns - boot_ns) / NS_PER_S) if row.boot_id == boot else 0.0


def left_now_s(row: CommandRow) -> float:
    """Time that an order has left at this moment on this machine."""
    return left_s(row, boot=boot_name(), boot_ns=elapsed_ns(), wall_utc_ns=time.time_ns())


def as_it_stands(row: CommandRow, seconds_left: float) -> CommandRow:
    """Return the row as its recorder will answer it: one that nobody began in time has expired."""
    if row.state != "pending" or seconds_left > 0.0:
        return row
    return replace(row, state="expired", result=expired_reason("its deadline passed before that"))


def command_state(catalogue: Catalogue, order_id: int) -> tuple[CommandRow, float] | None:
    """Look at an order as it stands now, with its time left in s; None where there is no such order."""
    row = catalogue.command(order_id)
    if row is None:
        return None
    seconds_left = left_now_s(row)
    # Looked at again: it may have been begun between the first look and its deadline.
    row = catalogue.command(order_id) or row
    return as_it_stands(row, seconds_left), seconds_left


def expired_reason(why: str) -> str:
    """Answer to an order that was not begun."""
    return f"not carried out, and nobody will: {why}; give it again if it is still wanted"
