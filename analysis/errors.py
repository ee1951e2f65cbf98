"""Errors that the analysis raises.

::

    AnalysisError
    ├── InvalidInputError          the values contradict the function's terms (also a ValueError)
    │   └── RecordError            a record that cannot be analysed: too short, too coarse, no pre-trigger
    ├── NotEnoughDataError         wait for more measurements
    │   ├── NotEnoughSetsError     a baseline of too few sets
    │   └── NotEnoughPointsError   a trend through too few points
    ├── SingularCovarianceError    a baseline in which some feature is constant or a copy of others
    └── EchoNotFoundError          no back-wall echo to take as the ultrasonic reference

A poor shot is not an error: it comes back with flags and a quality. Each message names the value,
the limit and the remedy.
"""

from __future__ import annotations


class AnalysisError(Exception):
    """Base class of all errors of the analysis."""


class InvalidInputError(AnalysisError, ValueError):
    """Error: the input breaks a documented condition."""


class RecordError(InvalidInputError):
    """Error: the record is too short for the wanted feature, independent of its content."""


class NotEnoughDataError(AnalysisError):
    """Error: too little data for a trustworthy result."""


class NotEnoughSetsError(NotEnoughDataError):
    """Error: too few sets for a baseline."""


class NotEnoughPointsError(NotEnoughDataError):
    """Error: too few points for a trend."""


class SingularCovarianceError(AnalysisError):
    """Error: the baseline's covariance has no usable inverse."""


class EchoNotFoundError(AnalysisError):
    """Error: no back-wall echo is above the noise where it is expected."""
