"""Errors of the doubles themselves; a board answers with a `Status`.

::

    SimulatorError
    └── DoublesError
        ├── LibraryBuildError       the C library cannot be built here
        └── DoublesProcessError     the double's process did not start, or is gone
"""

from __future__ import annotations

from simulator.errors import SimulatorError


class DoublesError(SimulatorError):
    """Base class of errors about running a double."""


class LibraryBuildError(DoublesError):
    """Error: no C compiler, not Linux, or a failed compilation."""


class DoublesProcessError(DoublesError):
    """Error: the double's process did not start, or does not respond."""
