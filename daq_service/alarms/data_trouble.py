"""The alarm of the data themselves: sets that cannot be read and were set aside."""

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
