"""``backup``: copy a test, even while it runs, to a folder that opens like the original.

A set gets rows before it moves from the journal to its own file. So the catalogue is copied first, in one
state, then the journal, then the files: a set with rows is in the copy of the journal, or its file existed
before the journal was copied. The copied catalogue gets its name last: until then the destination holds the
previous backup with more files.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from daq_service.archive.errors import BACK
from daq_service.archive.journal.frames import parse_frames
from daq_service.archive.journal.reader import build_segment_path, list_segments, read_journal, read_segments
from daq_service.archive.records import (
    JOURNAL_FOLDER,
    QUARANTINE_FOLDER,
    SETS_FOLDER,
    TEMPORARY_SUFFIX,
    to_references,
)
from daq_service.archive.verification import check_set_file
from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.earlier_names import to_current_row
from daq_service.catalogue.experiment_file import HISTORY_FILE
from daq_service.catalogue.verification import UnchangedCatalogue
from daq_service.cli.maintenance.verify import NOWHERE, Finding, find_stored_sha256
from daq_service.errors import StorageError, StorageUnavailableError
from daq_service.processes.data_folder import BACKUP_FILE, DRIVE_LOCK, LOCK_FILE, OWN_NAMES, read_identity
from daq_service.processes.disk_policy import RESERVE_FILE
from daq_service.processes.heartbeat import FILE_NAME as HEARTBEAT_FILE
from daq_service.processes.heartbeat import WEB_FILE
from daq_service.shared_file import O_BINARY, read_shared, remove_quietly, retry, sync_folder, write_durably

LEFT_OUT = {
    FILE_NAME,
    SETS_FOLDER,
    JOURNAL_FOLDER,
    BACKUP_FILE,
    HISTORY_FILE,
    RESERVE_FILE,
    "live",
    "tiles",
    HEARTBEAT_FILE,
    LOCK_FILE,
    DRIVE_LOCK,
    "audit.lock",
    "notifications.jsonl",
    "notifications.lock",
    "notifier.lock",
    "tokens.json",
    "tokens.lock",
    WEB_FILE,
}
"""Copied separately, or signs of a running test, which a copy is not; tokens and notifications belong to each
copy."""
NAMED_BY = ("uuid", "name", "configuration_hash", "epoch_utc_ns", "created_utc_ns")
"""Columns of the experiment that identify a test."""


@dataclass(slots=True, kw_only=True, eq=False)
class Copied:
    """Result of a backup.

    Attributes
    ----------
    files, n_bytes
        Copied now.
    present
        Files of sets that were there already.
    damage
        Files that are damaged in the folder itself: they lie in the backup's quarantine. Sets that are lost.
    """

    files: int = 0
    n_bytes: int = 0
    present: int = 0
    damage: list[Finding] = field(default_factory=list)


def back_up(
    folder: Path, destination: Path, progress: Callable[[int, int], None] = lambda done, planned: None
) -> Copied:
    """Copy new data of a folder to a backup; each copy is read back and compared.

    Corrupt files go to the backup's quarantine and lost sets are listed; neither stops the backup.
    ``progress`` receives the numbers of copied and of all set files.

    Raises
    ------
    StorageError
        The destination is within the folder, or is no backup of this test; the catalogue is damaged.
    StorageUnavailableError
        The destination cannot be written; copied files stay, and the next backup continues.
    """
    source, target = folder.resolve(), destination.resolve()
    if source == target or source in target.parents or target in source.parents:
        raise StorageError(f"{destination} and {folder} overlap; choose another destination")
    with UnchangedCatalogue(folder) as catalogue:
        copied, snapshot = Copied(), destination / f"{FILE_NAME}{TEMPORARY_SUFFIX}"
        try:
            _mark_destination(destination, catalogue.experiment())
            history = _read_history(folder)
            catalogue.copy_to(snapshot)
            _sync_file(snapshot)
            segment_names = {path.name for path in _copy_journal(folder, destination, copied)}
            _copy_sets(folder, destination, catalogue, copied, progress)
            copied.damage += _list_lost_sets(folder, destination, catalogue, copied)
            _copy_other_files(folder, destination, copied)
            for suffix in ("-wal", "-shm"):  # of a program that wrote to the copy
                remove_quietly(destination / f"{FILE_NAME}{suffix}")
            retry(lambda: os.replace(snapshot, destination / FILE_NAME))  # noqa: PTH105 - the seam is os
            sync_folder(destination)
            _write_copy(destination / HISTORY_FILE, history, copied)
            if not copied.damage:  # else an older segment may have what the file has lost
                for path in list_segments(destination).values():
                    if path.name not in segment_names:
                        remove_quietly(path)
        except OSError as error:
            remove_quietly(snapshot)
            raise StorageUnavailableError(
                f"the backup is not complete: {error}; what is copied stays; the previous one still opens: "
                "free disk space or repair the disk"
            ) from error
    return copied


def _mark_destination(destination: Path, experiment: dict[str, object] | None) -> None:
    """Create the destination with a marker of this test, or check the one that it has.

    Removes unfinished files of an earlier backup. Raises StorageError if the test has not started, or the
    folder is not empty, holds another test, or a recorder has run in it. Raises OSError if the folder cannot
    be written.
    """
    if experiment is None:
        raise StorageError("the test has not started; there is nothing to copy")
    experiment = to_current_row("experiment", experiment)
    identity = {name: experiment[name] for name in NAMED_BY}
    destination.mkdir(parents=True, exist_ok=True)
    marker = destination / BACKUP_FILE
    if not marker.exists():
        found_names = {path.name for path in destination.iterdir()} - {f"{marker.name}{TEMPORARY_SUFFIX}"}
        if names := sorted(found_names):
            raise StorageError(
                f"{destination} is not empty and no backup (it holds {names[0]!r}); choose a new folder"
            )
        content = json.dumps(identity, indent=1).encode()
        write_durably(marker, content, temporary=destination / f"{BACKUP_FILE}{TEMPORARY_SUFFIX}")
    found = read_identity(destination) or {}
    if found != identity:
        raise StorageError(
            f"{destination} holds a backup of another test ({found.get('name')!r}, configuration "
            f"{found.get('configuration_hash')}); choose another folder"
        )
    if (destination / LOCK_FILE).exists():
        raise StorageError(
            f"a recorder continued the test in {destination}, so it is not a backup; choose another folder"
        )
    for name in (SETS_FOLDER, JOURNAL_FOLDER):
        (destination / name).mkdir(exist_ok=True)
        for path in (destination / name).glob(f"*{TEMPORARY_SUFFIX}"):
            remove_quietly(path)


def _read_history(folder: Path) -> bytes:
    """Read the bytes of the folder's history file; empty without a file. Raises OSError if it is unreadable.

    It must be read before the catalogue is copied, since it must not contain more.
    """
    try:
        return read_shared(folder / HISTORY_FILE)
    except FileNotFoundError:
        return b""


def _copy_journal(folder: Path, destination: Path, copied: Copied) -> Iterator[Path]:
    """Copy the used part of each journal segment and yield the path of each copy.

    Updates ``copied``; raises OSError if a copy cannot be written.
    """
    for number, content in read_segments(folder):
        ends = [frame.end for frame in parse_frames(content)]
        # Without the room for what is to come.
        used = content[: max([len(content.rstrip(b"\0")), *ends])]
        path = build_segment_path(destination, number)
        _write_copy(path, used, copied)
        yield path


def _copy_sets(
    folder: Path,
    destination: Path,
    catalogue: UnchangedCatalogue,
    copied: Copied,
    progress: Callable[[int, int], None],
) -> None:
    """Copy new files of sets; put corrupt ones into the backup's quarantine and list them in ``copied``.

    A file that the backup has with equal size is not copied again but counted as present. Calls ``progress``
    with the numbers of set files done and in all; raises OSError if a copy cannot be written.
    """
    files = to_references(path.name for path in (folder / SETS_FOLDER).glob("*.h5"))
    for number, (set_key, file) in enumerate(files.items()):
        progress(number, len(files))
        source, target = folder / file, destination / file
        if target.exists() and target.stat().st_size == source.stat().st_size:
            copied.present += 1
            continue
        checked = check_set_file(source, sha256=find_stored_sha256(catalogue.of_set("sets", set_key), file))
        if checked.touched or checked.damages:
            description = f"{checked.damages[0] if checked.damages else 'its SHA-256 differs'}; {BACK}"
            copied.damage.append(Finding("set_unreadable", file, description))
            target = destination / QUARANTINE_FOLDER / target.name
            target.parent.mkdir(exist_ok=True)
        if checked.n_bytes:  # else nothing of it can be read
            _write_copy(target, read_shared(source), copied)
    progress(len(files), len(files))


def _list_lost_sets(
    folder: Path, destination: Path, catalogue: UnchangedCatalogue, copied: Copied
) -> list[Finding]:
    """List the sets with rows that have neither a file nor journal frames.

    Files are listed first: the copied journal is read only if some are missing. Files with a finding in
    ``copied`` are left out. Raises OSError if the copied journal cannot be read.
    """
    named = {finding.file for finding in copied.damage}
    files = {f"{SETS_FOLDER}/{path.name}" for path in (folder / SETS_FOLDER).glob("*.h5")} | named
    missing = {file: index for index, file in catalogue.files().items() if file not in files}
    journal = read_journal(destination) if missing else {}
    journaled = {item.reference for item in journal.values()}
    return [
        Finding("set_missing", file, f"{NOWHERE}; {BACK}")
        for file in missing
        # A set may have left the journal for a file between the two looks.
        if file not in journaled and not (folder / file).exists()
    ]


def _copy_other_files(folder: Path, destination: Path, copied: Copied) -> None:
    """Copy configuration, experiment, supply state, logs, audit log and quarantine of a folder.

    Temporary files and those that vanish meanwhile are skipped. Updates ``copied``; raises OSError if a copy
    cannot be written.
    """
    for name in sorted(OWN_NAMES - LEFT_OUT):
        place = folder / name
        paths = sorted(place.rglob("*")) if place.is_dir() else [place]
        for path in paths:
            if path.is_file() and path.suffix != TEMPORARY_SUFFIX:
                target = destination / path.relative_to(folder)
                target.parent.mkdir(parents=True, exist_ok=True)
                with suppress(FileNotFoundError):  # a log that was rotated meanwhile
                    _write_copy(target, read_shared(path), copied)


def _write_copy(target: Path, content: bytes, copied: Copied) -> None:
    """Write a copy durably unless an equal one exists, read it back from the disk, and count it.

    Adds the file and its size to ``copied`` if it was written.

    Raises
    ------
    OSError
        It cannot be written, or reads differently; then it is removed.
    """
    if target.exists() and target.stat().st_size == len(content) and read_shared(target) == content:
        return
    write_durably(target, content, temporary=target.with_name(f"{target.name}{TEMPORARY_SUFFIX}"))
    _drop_from_cache(target)
    if read_shared(target) != content:
        remove_quietly(target)
        raise OSError(f"{target} does not read as it was written")
    copied.files += 1
    copied.n_bytes += len(content)


def _drop_from_cache(path: Path) -> None:
    """Drop a file from the system's cache, so that the next read is from the disk.

    Does nothing where Python has no `os.posix_fadvise` (Windows, macOS). Raises OSError if it fails.
    """
    if hasattr(os, "posix_fadvise"):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
        finally:
            os.close(descriptor)


def _sync_file(path: Path) -> None:
    """Flush a file to the disk (fsync); raise OSError if that fails."""
    descriptor = os.open(path, os.O_RDWR | O_BINARY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
