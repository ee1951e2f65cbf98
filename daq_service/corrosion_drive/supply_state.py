"""State of the drive in the data folder: for the process after this one, and for status, page and API.

``drive.json`` is durable: charge, interlock, and the newest reading. ``drive.lock`` is held while a process
owns the supply's port; its text holds the address at which a recorder of this user reaches that process.
"""

from __future__ import annotations

import json
import logging
import os
import time
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from daq_service.catalogue.rows import ReadingQuality, SupplyState
from daq_service.clock import boot_name, elapsed_ns
from daq_service.corrosion_drive.charge import Charge, Command, DriveState
from daq_service.processes.data_folder import DRIVE_FILE, DRIVE_LOCK, hold_lock, is_owned, lock_text
from daq_service.shared_file import write_durably
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Kept:
    """Content of ``drive.json``.

    Attributes
    ----------
    output, age_s
        Newest reading, and its age when the file was written; None: there was none.
    utc_ns, boot_ns, boot_id
        When it was written: UTC, and time of the boot.
    heard_boot_ns
        Time of that boot at which a recorder was last heard.
    good_for_s
        Longest age of a reading that is still good.
    writer
        Name of the process that wrote it.
    supply_port
        Port at which the supply was last read; empty: at none.
    """

    state: DriveState
    output: SupplyState = "unknown"
    age_s: float | None = None
    utc_ns: int
    boot_ns: int
    boot_id: str | None
    heard_boot_ns: int
    good_for_s: float = 0.0
    writer: str = ""
    supply_port: str = ""

    def written_before_s(self, now_ns: int | None = None) -> float:
        """Return the time since it was written; by UTC where that was in another boot."""
        boot = boot_name()
        if self.boot_id == boot is not None:
            return max(0.0, ((elapsed_ns() if now_ns is None else now_ns) - self.boot_ns) / NS_PER_S)
        return max(0.0, (time.time_ns() - self.utc_ns) / NS_PER_S)


UNREADABLE = Kept(
    state=DriveState(must_switch_off=True), utc_ns=0, boot_ns=0, boot_id="unreadable", heard_boot_ns=0
)
"""Stands for a file that cannot be read: the output counts as on, without a command."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """How the process of the drive is reached: its port, its key in hexadecimal, and its configuration."""

    port: int
    key: str
    fingerprint: str


def own_drive(folder: Path, address: Address) -> AbstractContextManager[object]:
    """Hold the drive's lock, with an address that only this user reads; `BusyError` if another one does."""
    text = f"process {os.getpid()}\n{json.dumps(asdict(address))}"
    return hold_lock(folder, DRIVE_LOCK, text, who="process of the drive", mode=0o600)


def address_of(folder: Path) -> Address:
    """Read the address of the process that holds the lock.

    Raises
    ------
    ValueError, TypeError
        It has not written it yet, or another user's process has.
    """
    return Address(**json.loads(lock_text(folder, DRIVE_LOCK).partition("\n")[2]))


def process_of(folder: Path) -> int:
    """Read the process number of the holder of the lock; ValueError where it is not there yet."""
    return int(lock_text(folder, DRIVE_LOCK).partition("\n")[0].removeprefix("process "))


def kept_now(state: DriveState, **values: Any) -> Kept:
    """Return the content for this moment."""
    now_ns = elapsed_ns()
    stamps = {"utc_ns": time.time_ns(), "boot_ns": now_ns, "boot_id": boot_name(), "heard_boot_ns": now_ns}
    return Kept(state=state, **{**stamps, **values})


def write_kept(folder: Path, kept: Kept) -> None:
    """Write it durably.

    Raises
    ------
    OSError
        The disk does not take it.
    """
    # Not the suffix of hints, which a recorder that starts sweeps away.
    temporary = (folder / DRIVE_FILE).with_suffix(".new")
    content = json.dumps(asdict(kept), default=sorted).encode()
    write_durably(folder / DRIVE_FILE, content, temporary=temporary)


def read_kept(folder: Path) -> Kept | None:
    """Read it; None where there is none, `UNREADABLE` (with a warning) where it cannot be read."""
    path = folder / DRIVE_FILE
    try:
        values = json.loads(path.read_bytes())
        state = values.pop("state")
        if "output_on" in state:  # written before commands were kept
            state["command"] = {} if state.pop("output_on") else None
            state["latched"] = ["supply_unwatched"] if state.pop("unwatched") else []
        command = state["command"]
        state["command"] = None if command is None else Command(**command)
        state["latched"] = frozenset(state["latched"])
        return Kept(state=DriveState(**{**state, "charge": Charge(**state["charge"])}), **values)
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, LookupError, AttributeError) as error:
        log.warning("%s cannot be read (%s: %s)", path, type(error).__name__, error)
        return UNREADABLE


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveNow:
    """State of the drive as it is read from the folder.

    Attributes
    ----------
    state
        "unknown" where the newest reading is too old.
    last, age_s
        Newest reading, and its age; None: there was none.
    switch_off_pending
        The output must be off and has not been read as off yet.
    process
        Its process runs; None: that cannot be found out.
    written_age_s
        Age of the file.
    """

    state: SupplyState
    quality: ReadingQuality
    last: SupplyState
    age_s: float | None
    tripped: str | None
    unwatched: bool
    switch_off_pending: bool
    process: bool | None
    written_age_s: float


def look_at_drive(folder: Path) -> DriveNow | None:
    """Return the state of the drive at this moment; None where it never had a process of its own."""
    kept, process = read_kept(folder), is_owned(folder, DRIVE_LOCK)
    if kept is None:
        return None
    written_age_s = kept.written_before_s()
    age_s = None if kept.age_s is None else kept.age_s + written_age_s
    good = process is not False and age_s is not None and age_s <= kept.good_for_s
    return DriveNow(
        state=kept.output if good else "unknown",
        quality="good" if good else "stale" if process else "lost",
        last=kept.output,
        age_s=age_s,
        tripped=kept.state.tripped,
        unwatched="supply_unwatched" in kept.state.latched,
        switch_off_pending=kept.state.must_switch_off,
        process=process,
        written_age_s=written_age_s,
    )


def described(now: DriveNow) -> str:
    """Describe it in one line."""
    last = "" if now.quality == "good" else f"{now.last} when it was "
    age = "never read" if now.age_s is None else f"{last}read {now.age_s:.0f} s ago"
    parts = [f"{now.state}, {age}"]
    parts += ["switch-off pending, output may be ON"] if now.switch_off_pending else []
    parts += [f"tripped: {now.tripped}"] if now.tripped is not None else []
    parts += [f"state written {now.written_age_s:.0f} s ago"] if now.quality != "good" else []
    parts += ["no process owns its port"] if now.process is False else []
    return "; ".join(parts)
