"""The alarms of the data themselves: what cannot be stored, what cannot be read."""

from __future__ import annotations

from collections.abc import Sequence

from daq_service.alarms.states import Condition


def damage_condition(set_aside: Sequence[str]) -> Condition:
    """Alarm while damaged sets lie in quarantine.

    Parameters
    ----------
    set_aside
        What lies there, by the archive's names.
    """
    return Condition(
        position=None,
        kind="data_damaged",
        family="device",
        severity="medium",
        present=bool(set_aside),
        message=f"damaged and without rows, set aside: {', '.join(set_aside)}; remove what nobody needs",
        proof={"set_aside": list(set_aside)},
    )


def space_condition(told: str, *, present: bool, stops: bool) -> Condition:
    """Alarm while little of the volume is free; severe once nothing more is stored.

    Parameters
    ----------
    told
        How much is free.
    """
    follows = "nothing more is stored until some is freed" if stops else "soon nothing more is stored"
    return Condition(
        position=None,
        kind="disk_space",
        family="device",
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
        position=None,
        kind="storage_unavailable",
        family="device",
        severity="high",
        present=present,
        message=f"the disk refuses, what is taken waits in the {waits_in}: {message}",
    )
