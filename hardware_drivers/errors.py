"""Errors that an instrument may raise.

::

    InstrumentError
    ├── ConfigurationError      stop and say it: the request can never succeed as written
    │   └── UnknownStatusError  no table names it: as above, but a test that has started asks again
    ├── BusyError               someone else owns the board or port: name the owner, back off
    ├── AcquisitionTimeoutError no trigger within the deadline: a missed strike
    └── ConnectionLostError     the instrument or its driver is gone: rebuild, bounded

A vendor's own exception never crosses a driver's border: it is raised again as one of these with
``raise ... from``. Each message names the value, the limit and the remedy.
"""

from __future__ import annotations


class InstrumentError(Exception):
    """Base class of the errors of an instrument; catch the subclasses to decide what to do."""


class ConfigurationError(InstrumentError):
    """Error: the request contradicts the hardware or itself; a repeat cannot help."""


class UnknownStatusError(ConfigurationError):
    """Error: a vendor's status that no table names; whether a repeat helps is unknown."""


class BusyError(InstrumentError):
    """Error: another owner holds the resource."""


class AcquisitionTimeoutError(InstrumentError):
    """Error: no record arrived within the deadline, so the strike was missed.

    Attributes
    ----------
    last_attempt
        The shot cannot be struck again: a recording has no further attempt.
    """

    last_attempt = False


class ConnectionLostError(InstrumentError):
    """Error: the instrument stopped responding; a fresh connection may help."""
