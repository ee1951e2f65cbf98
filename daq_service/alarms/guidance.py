"""Guidance for each kind of alarm: one table for page, API, report and documentation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from types import MappingProxyType

from daq_service.alarms.states import TEXTS


@dataclass(frozen=True, slots=True, kw_only=True)
class Guidance:
    """What an operator needs to know of a kind of alarm.

    Attributes
    ----------
    meaning, limitations
        What has been found, and what that does not prove.
    checks
        Likely reasons, in the order in which to check them.
    action
        What to do; names in braces are those of the alarm.
    consequence
        What follows if nobody responds.
    contact
        Responsibility (a key of `alarms.contacts`) of the person to ask.
    """

    meaning: str
    limitations: str
    checks: Sequence[str]
    action: str
    consequence: str
    contact: str


GUIDANCE: Mapping[str, Guidance] = {
    kind: Guidance(**{field.name: texts[field.name] for field in fields(Guidance)})
    for kind, texts in TEXTS["kinds"].items()
}
"""By kind of alarm, the most urgent for the wall first."""


def name_contact(kind: str, contacts: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return the person to ask about a kind of alarm: the configured name, or the responsibility in words.

    Parameters
    ----------
    contacts
        Names by responsibility. A kind without guidance has the responsibility "rig".
    """
    guidance = GUIDANCE.get(kind)
    responsibility = "rig" if guidance is None else guidance.contact
    return contacts.get(responsibility) or f"the person responsible for the {responsibility}"


def join_numbered_steps(steps: Sequence[str]) -> str:
    """Join steps, numbered from 1, to one text; empty for no steps."""
    return " ".join(f"{number}. {step}" for number, step in enumerate(steps, start=1))
