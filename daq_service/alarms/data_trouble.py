"""Alarms of stored data: corrupt files, low disk space, failed writes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from daq_service.alarms.states import Condition


def build_data_condition(
    set_aside: Sequence[str], damaged: Mapping[str, str] = MappingProxyType({})
) -> Condition:
    """Return the condition ``data_corrupt``: sets in quarantine, or stored files that are corrupt or missing.

    It is present if either argument has an entry; its priority is high with damaged files, else medium.

    Parameters
    ----------
    set_aside
        Sets in quarantine, by the archive's names.
    damaged
        Fault of each damaged file: files of sets that have rows, and copies of journal segments.
    """
    return Condition(
        kind="data_corrupt",
        priority="high" if damaged else "medium",
        present=bool(set_aside or damaged),
        evidence={"set_aside": list(set_aside), "damaged": dict(damaged)},
    )


def build_disk_condition(
    free_bytes: int, total_bytes: int, stop_bytes: float, *, present: bool, stops: bool
) -> Condition:
    """Return the condition ``disk_space``: priority medium, or high if ``stops`` (recording has stopped).

    Parameters
    ----------
    free_bytes, total_bytes
        Free space and size of the volume.
    stop_bytes
        Free space below which recording stops.
    present
        False: the alarm returns to normal.
    """
    return Condition(
        kind="disk_space",
        priority="high" if stops else "medium",
        present=present,
        evidence={
            "free_percent": 100.0 * free_bytes / max(1, total_bytes),
            "stop_percent": 100.0 * stop_bytes / max(1, total_bytes),
            "free_gb": free_bytes / 1e9,
            "stopped": stops,
        },
    )


def build_write_condition(error: str, *, present: bool, waits_in: str = "memory") -> Condition:
    """Return the condition ``write_failed`` (priority high): a write failed, and the sets wait to be written.

    Parameters
    ----------
    error
        Error message of the disk or the operating system.
    present
        False: the alarm returns to normal.
    waits_in
        Where the sets wait: ``memory``, or ``journal`` for complete sets.
    """
    return Condition(
        kind="write_failed", priority="high", present=present, evidence={"error": error, "waits_in": waits_in}
    )
