"""Errors that the twin may raise.

::

    SimulatorError
    ├── SpecimenError           the parameters contradict each other: change them (also a ValueError)
    ├── IntegrationError        the time integration lost energy or diverged: no numbers are returned
    └── NoSolitaryWaveError     the force holds no incident solitary wave: lengthen the record

A single parameter out of its bounds is a plain ValueError of `parameters`.
Each message names the value, the limit and the remedy.
"""

from __future__ import annotations


class SimulatorError(Exception):
    """Base class of the twin's errors; catch the subclasses to decide what to do."""


class SpecimenError(SimulatorError, ValueError):
    """Error: parameters within their bounds contradict each other."""


class IntegrationError(SimulatorError):
    """Error: the integration did not conserve energy or produced NaN, even with a finer step."""


class NoSolitaryWaveError(SimulatorError):
    """Error: the record ends before an incident solitary wave reached the sensor."""
