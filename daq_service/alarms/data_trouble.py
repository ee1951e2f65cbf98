"""Alarms of stored data: corrupt files, low disk space, failed writes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from daq_service.alarms.states import Condition

SHOWN = 5
"""Maximum number of files in a message."""


def build_data_condition(
    set_aside: Sequence[str], damaged: Mapping[str, str] = MappingProxyType({})
) -> Condition:
    """Return the condition ``data_corrupt``: sets in quarantine, or stored files that are corrupt or missing.

    It is present if either argument has an entry; its priority is high with damaged files, else medium. The
    message names every set in quarantine and at most `SHOWN` damaged files; the evidence has all of both.

    Parameters
    ----------
    set_aside
        Sets in quarantine, by the archive's names.
    damaged
        Fault of each damaged file: files of sets that have rows, and copies of journal segments.
    """
    messages = [f"{file} {_describe_file_problem(fault)}" for file, fault in list(damaged.items())[:SHOWN]]
    messages += [f"and {len(damaged) - SHOWN} more"] if len(damaged) > SHOWN else []
    messages += ["solimon verify names all of it, solimon repair what helps"] if damaged else []
    if set_aside:
        messages.append(f"set aside because of damage: {', '.join(set_aside)}; remove what nobody needs")
    return Condition(
        kind="data_corrupt",
        priority="high" if damaged else "medium",
        present=bool(set_aside or damaged),
        message="; ".join(messages),
        evidence={"set_aside": list(set_aside), "damaged": dict(damaged)},
    )


def _describe_file_problem(fault: str) -> str:
    """Format a file's fault as a predicate: "is damaged: <fault>"; unchanged if it starts with "is "."""
    return fault if fault.startswith("is ") else f"is damaged: {fault}"


def build_disk_condition(free_space: str, *, present: bool, stops: bool) -> Condition:
    """Return the condition ``disk_space``: priority medium, or high if ``stops`` (nothing more is stored).

    Parameters
    ----------
    free_space
        Text with the free space, the start of the message.
    present
        False: the alarm returns to normal.
    """
    consequence = "nothing more is stored until some is freed" if stops else "soon nothing more is stored"
    return Condition(
        kind="disk_space",
        priority="high" if stops else "medium",
        present=present,
        message=f"{free_space}: {consequence}; free some, or take other data off the volume",
    )


def build_write_condition(message: str, *, present: bool, waits_in: str = "memory") -> Condition:
    """Return the condition ``write_failed`` (priority high): a write failed, and the sets wait to be written.

    Parameters
    ----------
    message
        Error message of the disk or the operating system, the end of the alarm's message.
    present
        False: the alarm returns to normal.
    waits_in
        Where the sets wait: ``memory``, or ``journal`` for complete sets.
    """
    return Condition(
        kind="write_failed",
        priority="high",
        present=present,
        message=f"the disk refuses, what is taken waits in the {waits_in} and is stored by itself once it "
        f"takes data again: {message}",
    )
