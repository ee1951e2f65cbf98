"""What the drive's process keeps in the data folder: for the one that comes after it, and for whoever looks.

``drive.json`` is durable: charge, interlock, and what the output did when it was written. ``drive.lock`` is
held while a process owns the supply's port, and its text tells a recorder of this user how to reach it.
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
from daq_service.corrosion_drive.charge import Charge, DriveState
from daq_service.processes.data_folder import DRIVE_FILE, DRIVE_LOCK, hold_lock, is_owned, lock_text
from daq_service.shared_file import read_hint, write_durably
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Kept:
    """Content of ``drive.json``.

    Attributes
    ----------
    output, age_s
        What the output did, and how old that reading was when the file was written; None: there was none.
    utc_ns, boot_ns, boot_id
        When it was written: UTC, and time of the boot.
    heard_boot_ns
        When a recorder was heard last, in that boot.
    good_for_s
        A reading that is older says nothing of now.
    """

    state: DriveState
    output: SupplyState = "unknown"
    age_s: float | None = None
    utc_ns: int
    boot_ns: int
    boot_id: str | None
    heard_boot_ns: int
    good_for_s: float = 0.0

    def written_before_s(self) -> float:
        """Time since it was written; by UTC where that was in another boot."""
        boot = boot_name()
        if self.boot_id == boot is not None:
            return max(0.0, (elapsed_ns() - self.boot_ns) / NS_PER_S)
        return max(0.0, (time.time_ns() - self.utc_ns) / NS_PER_S)


@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """How the process of the drive is reached: its port, its key in hexadecimal, and what it drives."""

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


def kept_now(state: DriveState, **told: Any) -> Kept:
    """Make what is to be kept at this moment."""
    now_ns = elapsed_ns()
    stamps = {"utc_ns": time.time_ns(), "boot_ns": now_ns, "boot_id": boot_name(), "heard_boot_ns": now_ns}
    return Kept(state=state, **{**stamps, **told})


def write_kept(folder: Path, kept: Kept) -> None:
    """Keep it, durably.

    Raises
    ------
    OSError
        The disk does not take it.
    """
    # Not the suffix of hints, which a recorder that starts sweeps away.
    temporary = (folder / DRIVE_FILE).with_suffix(".new")
    write_durably(folder / DRIVE_FILE, json.dumps(asdict(kept)).encode(), temporary=temporary)


def read_kept(folder: Path) -> Kept | None:
    """Read what was kept; None where nothing was, or nothing that can be read (with a warning)."""
    content = read_hint(folder / DRIVE_FILE)
    if content is None:
        return None
    try:
        values = json.loads(content)
        state = values.pop("state")
        return Kept(state=DriveState(**{**state, "charge": Charge(**state["charge"])}), **values)
    except (ValueError, TypeError, LookupError, AttributeError) as error:
        log.warning("%s cannot be read (%s: %s)", folder / DRIVE_FILE, type(error).__name__, error)
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveNow:
    """The drive as whoever looks at the folder finds it.

    Attributes
    ----------
    state
        "unknown" where the newest reading says nothing of now.
    last, age_s
        What the newest reading said, and its age; None: there was none.
    process
        Its process runs; None: nobody can tell.
    """

    state: SupplyState
    quality: ReadingQuality
    last: SupplyState
    age_s: float | None
    tripped: str | None
    unwatched: bool
    process: bool | None


def look_at_drive(folder: Path) -> DriveNow | None:
    """Tell how the drive stands at this moment; None where it has no process of its own and never had."""
    kept, process = read_kept(folder), is_owned(folder, DRIVE_LOCK)
    if kept is None:
        return None
    age_s = None if kept.age_s is None else kept.age_s + kept.written_before_s()
    good = process is not False and age_s is not None and age_s <= kept.good_for_s
    return DriveNow(
        state=kept.output if good else "unknown",
        quality="good" if good else "stale" if process else "lost",
        last=kept.output,
        age_s=age_s,
        tripped=kept.state.tripped,
        unwatched=kept.state.unwatched,
        process=process,
    )


def described(now: DriveNow) -> str:
    """Say it to a person."""
    last = "" if now.quality == "good" else f"{now.last} when it was "
    age = "never read" if now.age_s is None else f"{last}read {now.age_s:.0f} s ago"
    parts = [f"{now.state}, {age}"]
    parts += [f"switched off and kept off: {now.tripped}"] if now.tripped is not None else []
    parts += ["nobody owns its port"] if now.process is False else []
    return "; ".join(parts)
