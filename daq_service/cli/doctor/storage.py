"""Check the data folder: owner, file system, write access, free space."""

from __future__ import annotations

import os
import sys
import time
import uuid
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from daq_service.archive import FolderSetReader
from daq_service.catalogue import check_owner, open_catalogue
from daq_service.catalogue.errors import NoDataYetError, SchemaVersionError
from daq_service.catalogue.network_folder import find_network_type
from daq_service.catalogue.owner import raise_if_other_configuration
from daq_service.cli.doctor.check import Check, State
from daq_service.cli.inspection import describe_plan
from daq_service.errors import BusyError, StorageError, StorageUnavailableError
from daq_service.processes.data_folder import OWN_NAMES, hold_recorder_lock
from daq_service.processes.disk_policy import disk_space
from daq_service.processes.lost_catalogue import describe_loss, is_catalogue_lost, read_folder_history
from daq_service.processes.lost_sets import find_lost_sets
from daq_service.recording.experiment import find_stored_experiment
from daq_service.settings.tree import Settings
from daq_service.shared_file import retry

MOST_SHOWN = 5
SLOW_WRITE_S = 1.0
"""If a small file takes longer to become durable, the disk will delay sets."""
LOOK_S = 0.5
"""Timeout for the recorder's lock; after a wrong refusal a person can try again."""
COMFORTABLE = 2.0
"""Ratio of free space to planned data below which the check warns."""


@contextmanager
def lock_folder(folder: Path) -> Iterator[str]:
    """Hold the recorder's lock while the context is open, so that no recorder starts.

    Waits at most `LOOK_S` (s) for the lock. If another process holds it, or its file cannot be opened, the
    context runs without it.

    Yields
    ------
    str
        Description of the present owner, or why it is unknown; empty: none. A folder without a lock file has
        never had a recorder, and no lock file is created.
    """
    with ExitStack() as stack:
        owner = ""
        if (folder / "recorder.lock").is_file():
            try:
                stack.enter_context(hold_recorder_lock(folder, patience_s=LOOK_S))
            except BusyError as error:
                owner = str(error)
            except StorageUnavailableError as error:
                owner = (
                    f"a recorder may own {folder}: its lock cannot be opened ({error.__cause__}); look as "
                    "the user that runs the recorder"
                )
        yield owner


def read_lock_owner(folder: Path) -> str:
    """Return the description of the recorder that owns the folder; empty if there is none.

    Takes the recorder's lock for a moment, waiting at most `LOOK_S` (s), and releases it at once: a recorder
    that restarts meanwhile would find it taken, and its supervisor would end the test. Raises as
    `lock_folder`.
    """
    with lock_folder(folder) as owner:
        return owner


def refuse_if_owned(what: str, owner: str) -> None:
    """Raise BusyError, naming the refused action ``what``, if ``owner`` is not empty."""
    if owner:
        raise BusyError(f"{what} is refused: {owner}")


def check_storage(settings: Settings, folder: Path) -> list[Check]:
    """Check location, write access, owner, catalogue, sets and free space of the data folder.

    Only a probe file is written, and removed again. Raises OSError if the folder cannot be listed or its
    volume not measured.
    """
    return [
        _check_file_system(folder),
        _check_writable(folder),
        _check_owner(settings, folder),
        *_check_catalogue(folder),
        *_check_stored_sets(folder),
        _check_space(settings, folder),
    ]


def _check_file_system(folder: Path) -> Check:
    """Check the folder's file system: fail on a network, warn on operating systems where that is unknown."""
    kind = find_network_type(folder)
    found, remedy = "on a local file system", ""
    if kind is not None:
        found, remedy = f"on a network file system ({kind})", "choose a local disk with --data-dir"
    elif sys.platform not in ("linux", "win32"):
        found, remedy = "this system does not report whether it is local", "see that it is on a local disk"
    state: State = "fail" if kind is not None else "warn" if remedy else "ok"
    text = f"{folder}: {found}" if state == "warn" else f"{folder} is {found}"
    values = {"folder": str(folder), "network_file_system": kind}
    return Check("folder", "data folder: place", state, text, remedy, values)


def _check_writable(folder: Path) -> Check:
    """Write, sync and remove a probe file; fail if that is impossible or the folder holds only foreign files.

    Warns if the write takes longer than `SLOW_WRITE_S`. A missing folder is probed at its nearest parent.
    Raises OSError if the folder cannot be listed.
    """
    name = "data folder: writable"
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    if not existing.is_dir():
        return _make_failure(name, f"{existing} is a file", "choose another folder with --data-dir")
    if existing == folder:
        names = {path.name for path in folder.iterdir()}
        if names and not names & OWN_NAMES:
            found = f"{folder} is not empty and no data folder of solimon (it holds {min(names)!r})"
            return _make_failure(name, found, "choose a new or empty folder with --data-dir")
    probe = existing / f".write-test-{uuid.uuid4().hex}"
    started_s = time.monotonic()
    try:
        with probe.open("xb") as file:
            file.write(b"solimon")
            file.flush()
            os.fsync(file.fileno())
        retry(probe.unlink)
    except OSError as error:
        found = f"{existing} cannot be written: {error.strerror}"
        return _make_failure(name, found, "correct its permissions or choose another folder with --data-dir")
    took_s = time.monotonic() - started_s
    found = f"{folder}{'' if existing == folder else ' (to be made)'}; a small file is durable after "
    found += f"{took_s * 1e3:.0f} ms"
    values = {"exists": existing == folder, "durable_write_s": took_s}
    state: State = "ok" if took_s <= SLOW_WRITE_S else "warn"
    return Check("folder", name, state, found, "use a faster disk, or find what keeps it busy", values)


def _make_failure(name: str, found: str, remedy: str) -> Check:
    """Create a failed check of area ``folder`` with the finding ``found`` and a remedy."""
    return Check("folder", name, "fail", found, remedy)


def _check_owner(settings: Settings, folder: Path) -> Check:
    """Check that the folder is free or belongs to the test of this configuration.

    If the catalogue is lost, the stored sets identify the test. Any StorageError gives a failed check.
    """
    name, own_hash = "data folder: configuration", settings.configuration_hash()
    try:
        check_owner(settings, folder)
        if is_catalogue_lost(folder):  # then the sets identify the test
            experiment = find_stored_experiment(folder, read_folder_history(folder), FolderSetReader(folder))
            if experiment is not None:
                raise_if_other_configuration(experiment, folder, settings)
    except StorageError as error:
        return _make_failure(
            name, str(error), "use this test's own folder or configuration, or a new --data-dir"
        )
    found = f"free for this configuration ({own_hash[:12]})"
    return Check("folder", name, "ok", found, values={"configuration_hash": own_hash})


def _check_catalogue(folder: Path) -> list[Check]:
    """Return a failed check if the catalogue of a started test is lost, otherwise no check.

    An unreadable one gives none here: `_check_owner` reports it.
    """
    try:
        reason = describe_loss(folder)
    except StorageError:
        return []
    remedy = "look with solimon verify first; a backup of the folder has the catalogue, too"
    return [_make_failure("data folder: catalogue", reason, remedy)] if reason else []


def _check_stored_sets(folder: Path) -> list[Check]:
    """Check that each set with rows has a file that is not empty; contents are not read.

    Returns no check if no test has started or the catalogue has an earlier version. At most `MOST_SHOWN`
    files are named. A catalogue that cannot be read gives a failed check.
    """
    name = "data folder: sets"
    try:
        with open_catalogue(folder) as catalogue:
            lost = find_lost_sets(folder, catalogue)
    except (NoDataYetError, SchemaVersionError):
        return []  # not started, or an earlier version's: `_check_owner` reports that
    except (StorageError, OSError) as error:
        return [_make_failure(name, str(error), "run solimon verify for details")]
    values = {"lost_sets": len(lost)}
    if not lost:
        return [Check("folder", name, "ok", "every set that has rows is there", values=values)]
    sentences = "; ".join(f"{file} {reason}" for file, reason in list(lost.items())[:MOST_SHOWN])
    rest = f"; and {len(lost) - MOST_SHOWN} more" if len(lost) > MOST_SHOWN else ""
    remedy = "restore them with solimon repair --from BACKUP; solimon verify checks everything"
    return [Check("folder", name, "fail", f"{sentences}{rest}", remedy, values)]


def _check_space(settings: Settings, folder: Path) -> Check:
    """Compare the free disk space with the size of the data still to come, in bytes.

    Fails if it does not suffice or the recorder would stop now; warns below `COMFORTABLE` times that size.
    Raises OSError if the volume cannot be measured.
    """
    facts = describe_plan(settings, folder)
    stored = FolderSetReader(folder).n_bytes()
    needed, free = max(0, facts["stored_bytes"] - stored), int(facts["free_bytes"])
    level = disk_space(folder, settings.storage).level
    enough = free >= needed and level != "stop"
    return Check(
        "folder",
        "disk: space",
        "fail" if not enough else "ok" if free >= COMFORTABLE * needed and level == "ample" else "warn",
        f"{free / 1e9:.2f} GB free, about {needed / 1e9:.2f} GB still to come "
        f"({facts['sets']} sets planned, {stored / 1e9:.2f} GB stored)",
        "free space, or choose a larger disk with --data-dir",
        {"free_bytes": free, "needed_bytes": needed, "stored_bytes": stored, "level": level},
    )
