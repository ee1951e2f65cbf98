"""Errors of the service and the one table of exit codes.

::

    SolimonError
    ├── UsageError      exit 2   a command line or configuration that cannot work
    ├── RigError        exit 3   an instrument failed beyond recovery by the recorder
    ├── StorageError    exit 4   the data folder cannot be written, read or trusted
    ├── BusyError       exit 5   another recorder, process or port owner is in the way
    └── EndedByLibraryError  exit 1   a driver or library tried to end the process

``0`` is success, ``130`` an interruption by the operator, ``1`` a fault of solimon itself; ``6``
a test whose acceptance report does not pass, or a receiver of notifications that was not reached: nothing
failed here, but a criterion is not met or not decided.
"""

from __future__ import annotations

EXIT_OK = 0
EXIT_FAULT = 1
EXIT_NOT_MET = 6
EXIT_INTERRUPTED = 130


class SolimonError(Exception):
    """An error whose message is written for the operator: value, limit, remedy."""

    exit_code = EXIT_FAULT


class UsageError(SolimonError):
    """The command line or the configuration cannot work as written."""

    exit_code = 2


class RigError(SolimonError):
    """The rig failed beyond recovery by the recorder."""

    exit_code = 3


class StorageError(SolimonError):
    """The data folder cannot be written, read or trusted."""

    exit_code = 4


class StorageUnavailableError(StorageError):
    """The disk refuses for now: full, missing, failing, or locked by another program.

    The message names the remedy, not the consequence: a running test continues by itself.
    """


class TriedAgainError(StorageUnavailableError):
    """`StorageUnavailableError` in a child that its supervisor restarted and restarts again."""

    exit_code = EXIT_FAULT


class BusyError(SolimonError):
    """Another process owns a needed resource."""

    exit_code = 5


class EndedByLibraryError(SolimonError):
    """A driver or library raised an exception that would end the process (SystemExit)."""

    def __init__(self, ending: BaseException) -> None:
        super().__init__(f"a driver or library ended the work by {ending!r}; report it to its author")


PASSING = (StorageUnavailableError, OSError)
"""Trouble of a disk that may be over later: full, gone, failing, locked, no free handle."""
