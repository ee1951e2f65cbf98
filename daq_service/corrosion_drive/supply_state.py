"""State of the supply in the data folder: for the next supply process, and for status, page and API.

``drive.json`` is durable: charge, interlock, and the newest reading. ``drive.lock`` is held while a process
owns the supply's port; its text holds the address of that process for a recorder of this user.
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
from daq_service.processes.data_folder import DRIVE_FILE, DRIVE_LOCK, hold_lock, is_held, read_lock_owner
from daq_service.settings.alarm_delays import EARLIER_ALARM_KINDS
from daq_service.shared_file import write_durably
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredState:
    """Content of ``drive.json``.

    Attributes
    ----------
    output, age_s
        Newest reading, and its age when the file was written; None: there was none.
    utc_ns, boot_ns, boot_id
        Time of writing: UTC, and time of the boot.
    heard_boot_ns
        Time of that boot of the last request of a recorder.
    good_for_s
        Longest age of a good reading.
    writer
        Name of the process that wrote it.
    supply_port
        Port at which the supply was last read; empty: never read.
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

    def compute_file_age_s(self, now_ns: int | None = None) -> float:
        """Return the time in s since the file was written, at least 0.

        By the clock of this boot (``now_ns`` in ns, None: now); by UTC if it was written in another boot.
        """
        boot = boot_name()
        if self.boot_id == boot is not None:
            return max(0.0, ((elapsed_ns() if now_ns is None else now_ns) - self.boot_ns) / NS_PER_S)
        return max(0.0, (time.time_ns() - self.utc_ns) / NS_PER_S)


UNREADABLE = StoredState(
    state=DriveState(must_switch_off=True), utc_ns=0, boot_ns=0, boot_id="unreadable", heard_boot_ns=0
)
"""State for an unreadable file: the output counts as on, without a command."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """Address of the supply process: port, key in hexadecimal, and fingerprint of the configuration."""

    port: int
    key: str
    fingerprint: str


def hold_supply_lock(folder: Path, address: Address) -> AbstractContextManager[object]:
    """Return a context that holds the supply's lock, with an address readable only by this user.

    Entering it raises BusyError if another process holds the lock, StorageUnavailableError if its file cannot
    be opened.
    """
    text = f"process {os.getpid()}\n{json.dumps(asdict(address))}"
    return hold_lock(folder, DRIVE_LOCK, text, holder="process of the drive", mode=0o600)


def read_address(folder: Path) -> Address:
    """Read port, key and fingerprint of the process that holds, or held last, the supply's lock.

    Raises
    ------
    ValueError, TypeError
        The address is not written yet, or belongs to another user.
    """
    return Address(**json.loads(read_lock_owner(folder, DRIVE_LOCK).partition("\n")[2]))


def read_process_number(folder: Path) -> int:
    """Read the process number of the lock's holder; ValueError if it is not written yet or unreadable."""
    return int(read_lock_owner(folder, DRIVE_LOCK).partition("\n")[0].removeprefix("process "))


def stamp_state(state: DriveState, **values: Any) -> StoredState:
    """Build a stored state with present time stamps: UTC and boot time in ns, and name of the boot.

    ``values`` set further fields of `StoredState`, or replace stamps.
    """
    now_ns = elapsed_ns()
    stamps = {"utc_ns": time.time_ns(), "boot_ns": now_ns, "boot_id": boot_name(), "heard_boot_ns": now_ns}
    return StoredState(state=state, **{**stamps, **values})


def write_stored_state(folder: Path, stored: StoredState) -> None:
    """Write the state to ``drive.json`` atomically and sync it to disk; blocks until then.

    Raises
    ------
    OSError
        The file cannot be written; an existing one stays, old or new.
    """
    # Not the suffix of hints, which a starting recorder removes.
    temporary = (folder / DRIVE_FILE).with_suffix(".new")
    content = json.dumps(asdict(stored), default=sorted).encode()
    write_durably(folder / DRIVE_FILE, content, temporary=temporary)


def read_stored_state(folder: Path) -> StoredState | None:
    """Read the state from ``drive.json``, also of an older version; None if there is no file.

    For a file that cannot be read, log a warning and return `UNREADABLE`: a switch-off is then pending.
    """
    path = folder / DRIVE_FILE
    try:
        values = json.loads(path.read_bytes())
        state = values.pop("state")
        if "output_on" in state:  # file of an older version, without commands
            state["command"] = {} if state.pop("output_on") else None
            state["latched"] = ["supply_watchdog_trip"] if state.pop("unwatched") else []
        command = state["command"]
        state["command"] = None if command is None else Command(**command)
        state["latched"] = frozenset(EARLIER_ALARM_KINDS.get(kind, kind) for kind in state["latched"])
        return StoredState(state=DriveState(**{**state, "charge": Charge(**state["charge"])}), **values)
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, LookupError, AttributeError) as error:
        log.warning("%s cannot be read (%s: %s)", path, type(error).__name__, error)
        return UNREADABLE


@dataclass(frozen=True, slots=True, kw_only=True)
class SupplyStatus:
    """Status of the supply, read from the data folder.

    Attributes
    ----------
    state
        "unknown" where the newest reading is too old.
    last, age_s
        Newest reading, and its age; None: there was none.
    switch_off_pending
        The output must be off and has not been read as off yet.
    process
        The supply process runs; None: unknown.
    written_age_s
        Age of the file, s.
    """

    state: SupplyState
    quality: ReadingQuality
    last: SupplyState
    age_s: float | None
    tripped: str | None
    watchdog_trip: bool
    switch_off_pending: bool
    process: bool | None
    written_age_s: float


def read_supply_status(folder: Path) -> SupplyStatus | None:
    """Read the present status of the supply from the folder; None if it never had a supply process.

    An unreadable file counts as a pending switch-off. Without a process, or with an old reading, the state is
    ``unknown``; ``last`` still has it.
    """
    stored, process = read_stored_state(folder), is_held(folder, DRIVE_LOCK)
    if stored is None:
        return None
    written_age_s = stored.compute_file_age_s()
    age_s = None if stored.age_s is None else stored.age_s + written_age_s
    good = process is not False and age_s is not None and age_s <= stored.good_for_s
    return SupplyStatus(
        state=stored.output if good else "unknown",
        quality="good" if good else "stale" if process else "no_communication",
        last=stored.output,
        age_s=age_s,
        tripped=stored.state.tripped,
        watchdog_trip="supply_watchdog_trip" in stored.state.latched,
        switch_off_pending=stored.state.must_switch_off,
        process=process,
        written_age_s=written_age_s,
    )


def describe_supply(status: SupplyStatus) -> str:
    """Describe the supply's status in one line: output, age of the reading, pending switch-off, trip.

    If the reading is not good, also the age of the file; a missing supply process is named.
    """
    last = "" if status.quality == "good" else f"{status.last} when it was "
    age = "never read" if status.age_s is None else f"{last}read {status.age_s:.0f} s ago"
    parts = [f"{status.state}, {age}"]
    parts += ["switch-off pending, output may be ON"] if status.switch_off_pending else []
    parts += [f"tripped: {status.tripped}"] if status.tripped is not None else []
    parts += [f"state written {status.written_age_s:.0f} s ago"] if status.quality != "good" else []
    parts += ["no process owns its port"] if status.process is False else []
    return "; ".join(parts)
