"""The alarm of the rig itself: its instruments end a set, or answer to nothing in it."""

from __future__ import annotations

from collections.abc import Sequence

from daq_service.acquisition.schedule import DueSet
from daq_service.acquisition.take_set import MissedShot
from daq_service.alarms.states import Condition
from daq_service.archive import MissedRecord
from hardware_drivers.errors import BusyError, ConnectionLostError, InstrumentError

PASSING = (BusyError.__name__, ConnectionLostError.__name__)
"""What may be over by the next set: a board that is busy or gone may be free or back by then."""


def lost_cause(missed: Sequence[MissedShot | MissedRecord]) -> str:
    """Last cause, where every one of these attempts lost its connection; else empty.

    Parameters
    ----------
    missed
        Everything that was tried with an instrument, none of which left a record.
    """
    if not missed or any(item.reason != "connection_lost" for item in missed):
        return ""
    return missed[-1].cause


def rig_condition(due: DueSet, trouble: str, unanswered: str, *, proven: bool) -> Condition:
    """Alarm while the instruments do not answer, belong to somebody else, or cannot do what is asked.

    Parameters
    ----------
    trouble
        What ended the set, ``class: message``; empty if nothing did.
    unanswered
        Why nothing in the set was answered (`lost_cause`); empty if anything was.
    proven
        These instruments have taken a whole set here: whatever they say now, the next one is tried.
    """
    error, _, message = trouble.partition(": ")
    happened = "ended early"
    if not trouble and unanswered:
        error, message, happened = ConnectionLostError.__name__, unanswered, "got no answer"
    outlook = "the next set tries again"
    if error not in PASSING and not proven:
        outlook = "the recorder has stopped: mend the cause and start it again; it goes on with the schedule"
    return Condition(
        kind="rig_unavailable",
        severity="high",
        present=bool(trouble or unanswered),
        message=f"set {due.set_index} {happened}: {message}; {outlook}",
        proof={"set_index": due.set_index, "error": error},
    )


def opening_condition(trouble: InstrumentError | None) -> Condition:
    """Alarm while a test that has begun waits for its rig to open; its proof names no set."""
    return Condition(
        kind="rig_unavailable",
        severity="high",
        present=trouble is not None,
        message=f"the rig cannot be opened: {trouble}; the recorder tries again until it can",
        proof={"error": type(trouble).__name__},
    )
