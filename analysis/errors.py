"""Errors of the analysis.

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
    """Anything the analysis refuses to do."""


class InvalidInputError(AnalysisError, ValueError):
    """The input breaks a documented condition."""


class RecordError(InvalidInputError):
    """The record cannot hold what is looked for, whatever was measured."""


class NotEnoughDataError(AnalysisError):
    """The result would not be trustworthy yet."""


class NotEnoughSetsError(NotEnoughDataError):
    """Too few sets for a baseline."""


class NotEnoughPointsError(NotEnoughDataError):
    """Too few points for a trend."""


class SingularCovarianceError(AnalysisError):
    """The baseline's covariance has no usable inverse."""


class EchoNotFoundError(AnalysisError):
    """No back-wall echo stands out where it is expected."""
