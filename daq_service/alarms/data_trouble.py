"""The alarms of the data themselves: what cannot be stored, what cannot be read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from daq_service.alarms.states import Condition

SHOWN = 5
"""A message names this many files: nobody reads more."""


def damage_condition(
    set_aside: Sequence[str], damaged: Mapping[str, str] = MappingProxyType({})
) -> Condition:
    """Alarm while damaged sets lie in quarantine, or stored ones are damaged or gone.

    Parameters
    ----------
    set_aside
        What lies there, by the archive's names.
    damaged
        Files of sets that have rows, and copies of segments of the journal, and what is wrong with each.
    """
    told = [f"{file} {_sentence(what)}" for file, what in list(damaged.items())[:SHOWN]]
    told += [f"and {len(damaged) - SHOWN} more"] if len(damaged) > SHOWN else []
    told += ["solimon verify names all of it, solimon repair what helps"] if damaged else []
    if set_aside:
        told.append(f"set aside because of damage: {', '.join(set_aside)}; remove what nobody needs")
    return Condition(
        kind="data_damaged",
        severity="high" if damaged else "medium",
        present=bool(set_aside or damaged),
        message="; ".join(told),
        proof={"set_aside": list(set_aside), "damaged": dict(damaged)},
    )


def _sentence(what: str) -> str:
    return what if what.startswith("is ") else f"is damaged: {what}"


def space_condition(told: str, *, present: bool, stops: bool) -> Condition:
    """Alarm while little of the volume is free; severe once nothing more is stored.

    Parameters
    ----------
    told
        How much is free.
    """
    follows = "nothing more is stored until some is freed" if stops else "soon nothing more is stored"
    return Condition(
        kind="disk_space",
        severity="high" if stops else "medium",
        present=present,
        message=f"{told}: {follows}; free some, or take other data off the volume",
    )


def storage_condition(message: str, *, present: bool, waits_in: str = "memory") -> Condition:
    """Alarm while sets wait in memory, or whole ones in the journal, because the disk takes nothing.

    Parameters
    ----------
    message
        What the disk, or the system, says.
    """
    return Condition(
        kind="storage_unavailable",
        severity="high",
        present=present,
        message=f"the disk refuses, what is taken waits in the {waits_in} and is stored by itself once it "
        f"takes data again: {message}",
    )
