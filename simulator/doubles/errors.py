"""Errors of the doubles' own making; what a board answers is a `Status`.

::

    SimulatorError
    └── DoublesError
        ├── LibraryBuildError       the C library cannot be built here
        └── DoublesProcessError     the double's process did not start, or is gone
"""

from __future__ import annotations

from simulator.errors import SimulatorError


class DoublesError(SimulatorError):
    """Anything about running a double."""


class LibraryBuildError(DoublesError):
    """No C compiler, not Linux, or the compiler refused."""


class DoublesProcessError(DoublesError):
    """The double's process did not come up, or does not answer."""
