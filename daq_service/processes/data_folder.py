"""Data folder: creation, write test, and ownership by one recorder at a time.

The owner holds an OS lock on ``recorder.lock`` for as long as its process lives: a crash releases it and
no cleanup is needed. Only the lock shows whether a recorder runs. The file's text names the owner for a
person.
"""

from __future__ import annotations

import logging
import os
import sys
import uuid
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import IO

import orjson
from pydantic import ValidationError

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.earlier_names import to_current_row
from daq_service.catalogue.errors import CatalogueError
from daq_service.catalogue.experiment_file import EXPERIMENT_FILE, HISTORY_FILE, read_experiment_file
from daq_service.catalogue.network_folder import find_network_type
from daq_service.errors import BusyError, StorageError, StorageUnavailableError, UsageError
from daq_service.settings.file import load_settings
from daq_service.settings.stored import rename_old_keys
from daq_service.settings.tree import Settings, StorageSettings
from daq_service.shared_file import HINT_SUFFIX, PATIENCE_S, read_shared, remove_quietly, retry, write_durably

log = logging.getLogger(__name__)

if sys.platform == "win32":
    import msvcrt

    def try_lock(file: IO[bytes]) -> None:
        """Lock an open file until it is closed, without waiting; OSError if another process holds it."""
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)

    def is_file_locked(file: IO[bytes]) -> bool:
        """Return whether another process holds the lock of an open file, after retries of 0.1 s.

        The check itself holds the lock for an instant, so concurrent checks may disturb each other.
        """
        try:
            retry(lambda: try_lock(file), patience_s=0.1)
        except OSError:
            return True
        msvcrt.locking(file.fileno(), msvcrt.LK_UNLCK, 1)
        return False

else:
    import fcntl

    def try_lock(file: IO[bytes]) -> None:
        """Lock an open file until it is closed, without waiting; OSError if another process holds it."""
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def is_file_locked(file: IO[bytes]) -> bool:
        """Return whether another process holds the lock of an open file, without waiting.

        The check takes a shared lock until the file is closed, so concurrent checks do not disturb each
        other.
        """
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        return False


class FolderGoneError(StorageUnavailableError):
    """The folder of a test that has started is missing."""


_OWNER_OFFSET = 1
"""The first byte is the locked one: on Windows a locked byte cannot be read by others."""


CONFIGURATION_FILE = "configuration.json"
"""Configuration of a test that was run without a configuration file."""

BACKUP_FILE = "backup.json"
"""Source test of a folder that `solimon backup` made."""

SOURCES = frozenset(
    {
        "audit.jsonl",
        BACKUP_FILE,
        "catalogue.sqlite",
        "drive.json",
        EXPERIMENT_FILE,
        HISTORY_FILE,
        "journal",
        "logs",
        "notifications.jsonl",
        "quarantine",
        "sets",
        "tokens.json",
    }
)
"""Files and folders that nothing can make again."""
LOCKS = frozenset(
    {"audit.lock", "drive.lock", "notifications.lock", "notifier.lock", "recorder.lock", "tokens.lock"}
)
CACHES = frozenset({CONFIGURATION_FILE, "heartbeat.json", "live", "reserve", "tiles", "web_heartbeat.json"})
"""Files and folders that may be deleted at any time: solimon makes them again or does without them."""
OWN_NAMES = SOURCES | LOCKS | CACHES
LOCK_FILE = "recorder.lock"
DRIVE_LOCK, DRIVE_FILE = "drive.lock", "drive.json"
WRITE_TEST = ".write-test-"


def read_identity(folder: Path) -> Mapping[str, object] | None:
    """Read the identity of the test from which a backup folder was made: the row of its experiment.

    Returns None if the folder is no backup, and an empty mapping if `BACKUP_FILE` is invalid. Raises OSError
    if it cannot be read.
    """
    try:
        found = orjson.loads(read_shared(folder / BACKUP_FILE))
        return to_current_row("experiment", found)  # those of earlier versions have no UUID
    except FileNotFoundError:
        return None
    except (ValueError, LookupError, TypeError, AttributeError):
        return {}


def build_new_folder_path(purpose: str) -> Path:
    """Return an unused path in the working directory, ``solimon-PURPOSE-DATE-TIME``, with a number if needed.

    The folder is not created.
    """
    base = Path.cwd() / f"solimon-{purpose}-{datetime.now().astimezone():%Y%m%d-%H%M%S}"
    folder, number = base, 1
    while folder.exists():
        number += 1
        folder = base.with_name(f"{base.name}-{number}")
    return folder


def prepare_data_folder(folder: Path, *, may_create: bool = True) -> None:
    """Create the data folder with its subfolders and check by a test file that it can be written.

    If ``live`` or ``logs`` cannot be created, a warning is logged.

    Parameters
    ----------
    may_create
        False where a test has started: a missing folder must be restored and is not created again.

    Raises
    ------
    FolderGoneError
        ``may_create`` is false, and the folder is missing or has no ``sets``.
    StorageUnavailableError
        It cannot be created or written.
    StorageError
        It holds only foreign files, or is on a network file system.
    OSError
        It cannot be listed.
    """
    # The lock is no evidence: a recorder that was killed during its start has not created it.
    if not may_create and not (folder / "sets").is_dir():
        raise FolderGoneError(
            f"{folder} is gone, or another one in its place; bring back the test's own folder"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageUnavailableError(
            f"cannot make the data folder {folder}: {error.strerror}; choose another with --data-dir"
        ) from error
    kind = find_network_type(folder)
    if kind is not None:
        raise StorageError(
            f"{folder} is on a network file system ({kind}), which cannot lock a catalogue; "
            "choose a local disk with --data-dir"
        )
    if foreign := _find_foreign_file(folder):
        raise StorageError(
            f"{folder} is not empty and not a data folder of solimon (it holds {foreign!r}); "
            "choose a new or empty one with --data-dir"
        )
    probe = folder / f"{WRITE_TEST}{uuid.uuid4().hex}"
    try:
        retry(lambda: probe.write_bytes(b"solimon"))
        remove_quietly(probe)
        (folder / "sets").mkdir(exist_ok=True)
        for name in ("live", "logs"):
            _create_optional_folder(folder / name)
    except OSError as error:
        raise StorageUnavailableError(
            f"the data folder {folder} cannot be written: {error.strerror}; correct its permissions or "
            "choose another with --data-dir"
        ) from error


def _create_optional_folder(folder: Path) -> None:
    """Create a folder that the test can do without; an OSError is only logged, as a warning."""
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        log.warning("%s cannot be made: %s; the test continues without it", folder, error)


def remove_temporary_files(folder: Path) -> None:
    """Delete the temporary files that killed writers left in a data folder and its ``live`` subfolder.

    Only the owner of the folder may call this: it is the only writer of such files. A file that cannot be
    deleted within `PATIENCE_S` is logged and stays.
    """
    for directory in (folder, folder / "live"):
        for pattern in (f"*{HINT_SUFFIX}", f"{WRITE_TEST}*"):
            for path in directory.glob(pattern):
                remove_quietly(path)


def _find_foreign_file(folder: Path) -> str:
    """Return the first name in a folder that holds no file of solimon; empty for other or empty folders.

    Files of the write test are ignored. Raises OSError if the folder cannot be listed.
    """
    names = {path.name for path in folder.iterdir() if not path.name.startswith(WRITE_TEST)}
    return min(names) if names and not names & OWN_NAMES else ""


def require_data_folder(folder: Path) -> None:
    """Raise UsageError unless a folder is a data folder or empty; nothing is created or changed.

    Raises
    ------
    UsageError
        The folder is missing, is no folder, cannot be read, or holds only foreign files.
    """
    remedy = (
        "name the folder of the test with --data-dir, or its configuration; only `solimon run`, `record` "
        "and `demo` make one"
    )
    try:
        foreign = _find_foreign_file(folder)
    except FileNotFoundError as error:
        raise UsageError(f"there is no data folder {folder}; {remedy}") from error
    except OSError as error:
        raise UsageError(f"the data folder {folder} cannot be read: {error.strerror}; {remedy}") from error
    if foreign:
        raise UsageError(f"{folder} is not a data folder of solimon (it holds {foreign!r}); {remedy}")


def hold_recorder_lock(folder: Path, *, patience_s: float = PATIENCE_S) -> AbstractContextManager[object]:
    """Hold the recorder's lock of a folder within a context; its text names this process (`hold_lock`).

    Raises `BusyError` on entry if another recorder holds it for ``patience_s`` seconds, and
    StorageUnavailableError if the lock file cannot be opened.
    """
    text = f"process {os.getpid()}"
    return hold_lock(folder, LOCK_FILE, text, holder="recorder", patience_s=patience_s)


@contextmanager
def hold_lock(
    folder: Path,
    name: str,
    text: str,
    *,
    holder: str,
    mode: int | None = None,
    patience_s: float = PATIENCE_S,
) -> Iterator[IO[bytes]]:
    """Hold a lock of the folder within a context and yield its open file; ``text`` in it describes the owner.

    A text that cannot be written, because the disk is full, is no error.

    Parameters
    ----------
    text
        First line: the owner, for a person. The rest is never shown.
    holder
        Kind of process that holds the lock, for the error message.
    mode
        Permissions of the file; None: those of the user's other files.
    patience_s
        How long a held lock is retried: a check for a running recorder (`is_held`) holds it for an instant.

    Raises
    ------
    BusyError
        Another process holds it after ``patience_s``.
    StorageUnavailableError
        The lock file cannot be opened.
    """
    path = folder / name
    with ExitStack() as stack:
        try:
            if mode is not None:
                retry(lambda: path.touch(mode))
                path.chmod(mode)
            file = stack.enter_context(retry(lambda: path.open("a+b")))
        except OSError as error:
            raise StorageUnavailableError(
                f"{path} cannot be opened: {error.strerror}; remove it if it is not a file of solimon, or "
                "give this user the right to write it"
            ) from error
        file.seek(0)
        try:
            retry(
                lambda: try_lock(file),
                is_refusal=lambda error: isinstance(error, BlockingIOError | PermissionError),
                patience_s=patience_s,
            )
        except OSError as error:
            owner, _, _ = read_lock_owner(folder, name).partition("\n")
            raise BusyError(
                f"another {holder} owns {folder} ({owner}); stop it first, or choose another "
                "folder with --data-dir"
            ) from error
        with suppress(OSError):  # a full disk: the lock counts, not the text
            file.truncate(0)
            file.write(b"\0" * _OWNER_OFFSET + text.encode())
            file.flush()
        yield file


@contextmanager
def lock_for_change(path: Path) -> Iterator[None]:
    """Hold ``NAME.lock`` next to a file within a context, so that processes change the file in turn.

    Waits up to `PATIENCE_S` (5 s) for another holder.

    Raises
    ------
    OSError
        The lock cannot be created, or another process held it all the time.
    """
    lock = path.with_suffix(".lock")
    with retry(lambda: lock.open("a+b")) as file:
        refusals = (BlockingIOError, PermissionError)
        retry(lambda: try_lock(file), is_refusal=lambda error: isinstance(error, refusals))
        yield


def is_held(folder: Path, name: str = LOCK_FILE) -> bool | None:
    """Return whether a process, such as the recorder, holds a lock of the folder; None if it cannot be read.

    A missing lock file counts as not held.

    Parameters
    ----------
    name
        Name of another lock to check.
    """
    try:
        with (folder / name).open("rb") as file:
            return is_file_locked(file)
    except FileNotFoundError:
        return False
    except OSError as error:
        log.debug("the lock of %s cannot be read: %s", folder, error)
        return None


def read_lock_owner(folder: Path, name: str) -> str:
    """Return the owner's text in a lock file, at most 1000 bytes.

    If it is unreadable or empty, a phrase about that is returned.
    """
    # On Windows the locked byte cannot be read by others, so only the bytes after it are read.
    try:
        with (folder / name).open("rb", buffering=0) as file:
            file.seek(_OWNER_OFFSET)
            return file.read(1000).decode("ascii", "replace") or "process unknown"
    except OSError as error:
        return f"owner unreadable: {error.strerror}"


def choose_folder(storage: StorageSettings, config: Path | None, data_dir: Path | None) -> Path:
    """Return the absolute path of the option ``--data-dir``, or else of the configured folder.

    A relative configured folder counts from the configuration file, or from the working directory without
    one.
    """
    if data_dir is not None:
        return data_dir.absolute()
    base = Path.cwd() if config is None else config.absolute().parent
    return base / storage.folder


def load_settings_and_folder(config: Path | None, data_dir: Path | None) -> tuple[Settings, Path]:
    """Read the configuration and return it with the absolute path of its data folder.

    If ``config`` is the configuration file of a data folder and is rejected or missing, the configuration
    stored next to it (`experiment.json` or catalogue) is used and a warning logged.

    Raises
    ------
    UsageError
        The configuration is rejected, with the reason.
    """
    try:
        settings = load_settings(config)
    except UsageError as error:
        stored = (
            None if config is None or config.name != CONFIGURATION_FILE else _stored_settings(config.parent)
        )
        if stored is None:
            raise
        log.warning("going on with the configuration that the catalogue keeps: %s", error)
        settings = stored
    return settings, choose_folder(settings.storage, config, data_dir)


def load_settings_for_reading(config: Path | None, data_dir: Path | None) -> tuple[Settings, Path]:
    """Read the configuration for commands that only read, and return it with the absolute data folder.

    If only ``data_dir`` is given, the configuration stored in that folder is read; without a valid one, the
    shipped configuration.

    Raises
    ------
    UsageError
        The configuration is rejected, with the reason.
    """
    if config is None and data_dir is not None and (stored := _stored_settings(data_dir)) is not None:
        return stored, data_dir.absolute()
    return load_settings_and_folder(config, data_dir)


def _stored_settings(folder: Path) -> Settings | None:
    """Read the settings from experiment.json, or without that file from the catalogue.

    Returns None if there are none or they are invalid in this version; the reason is logged at DEBUG.
    """
    try:
        stored = read_experiment_file(folder)
        if stored is None:
            with open_catalogue(folder) as catalogue:
                stored = catalogue.read_experiment()
        return Settings(**rename_old_keys(stored.configuration))
    except (CatalogueError, ValidationError) as error:
        log.debug("%s keeps no configuration for this version: %s", folder, error)
        return None


def write_configuration(settings: Settings, folder: Path) -> Path:
    """Write the settings as JSON durably to `CONFIGURATION_FILE` in the data folder and return its path.

    Child processes and later starts read it. It replaces an earlier one: pace and end of a test may change.
    Raises StorageUnavailableError if it cannot be written.
    """
    config = folder / CONFIGURATION_FILE
    content = settings.model_dump_json(indent=1).encode()
    try:
        write_durably(config, content, temporary=config.with_suffix(HINT_SUFFIX))
    except OSError as error:
        raise StorageUnavailableError(
            f"{config} cannot be written: {error.strerror}; free disk space or repair the disk"
        ) from error
    return config
