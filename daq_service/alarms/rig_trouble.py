"""The alarm of the instruments: they end a set early, or do not respond."""

from __future__ import annotations

from collections.abc import Sequence

from daq_service.alarms.states import Condition
from hardware_drivers.errors import BusyError, ConnectionLostError, InstrumentError
from hardware_drivers.measurement import DueSet, MissedShot

RIG_UNAVAILABLE = "instruments_unavailable"
PASSING = (BusyError.__name__, ConnectionLostError.__name__)
"""Errors that may be gone at the next set: a busy board may be free, a lost connection restored."""


def find_connection_loss(missed: Sequence[MissedShot]) -> str:
    """Return the cause of the last missed shot if all of them lost the connection; otherwise an empty text.

    Parameters
    ----------
    missed
        All missed shots of an instrument that has no record in the set; may be empty.
    """
    if not missed or any(item.reason != "connection_lost" for item in missed):
        return ""
    return missed[-1].cause


def build_rig_condition(due: DueSet, trouble: str, unanswered: str, *, proven: bool) -> Condition:
    """Return the condition ``instruments_unavailable`` (priority high) after a set.

    It is present if an error ended the set or no instrument responded. Its evidence has whether the recorder
    stopped: neither after `PASSING` errors nor with ``proven``.

    Parameters
    ----------
    trouble
        Error that ended the set, ``class: message``; empty if there was none.
    unanswered
        Why no instrument responded in the set (`find_connection_loss`); empty if one did.
    proven
        These instruments have recorded a complete set before, so the next set is tried after any error.
    """
    error, _, message = trouble.partition(": ")
    if not trouble and unanswered:
        error, message = ConnectionLostError.__name__, unanswered
    return Condition(
        kind=RIG_UNAVAILABLE,
        priority="high",
        present=bool(trouble or unanswered),
        evidence={
            "set_index": due.set_index,
            "unscheduled_index": due.unscheduled_index,
            "error": error,
            "error_message": message,
            "stopped": bool(error) and error not in PASSING and not proven,
        },
    )


def build_opening_condition(trouble: InstrumentError | None) -> Condition:
    """Return the condition ``instruments_unavailable`` (priority high) of a rig that cannot be opened yet.

    Its evidence has the class of the error, but no set. It is not present if ``trouble`` is None.
    """
    return Condition(
        kind=RIG_UNAVAILABLE,
        priority="high",
        present=trouble is not None,
        evidence={"error": type(trouble).__name__, "error_message": str(trouble)},
    )
