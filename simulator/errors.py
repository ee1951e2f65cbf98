"""Errors the twin may raise.

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
    """Anything the twin reports; catch the subclasses to decide what to do."""


class SpecimenError(SimulatorError, ValueError):
    """Parameters that are each within bounds but cannot go together."""


class IntegrationError(SimulatorError):
    """The integration did not conserve energy or left the real numbers, even with a finer step."""


class NoSolitaryWaveError(SimulatorError):
    """The record ends before an incident solitary wave reached the sensor."""
