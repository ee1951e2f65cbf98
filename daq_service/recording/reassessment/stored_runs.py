"""Events of a stored test in the order of their commits: the loop of rebuild, replay and explain.

The ids of events are those of their commits. The events of one set are consecutive; an event without a set is
a command, an alarm of a device or a message of the recorder.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from itertools import groupby
from typing import TypeVar

from daq_service.alarms.states import RETIRING
from daq_service.assessment.baseline_lifecycle import STEPS
from daq_service.catalogue.rows import EventRow, Row
from daq_service.recording.set_assessor import PositionAssessors
from hardware_drivers.measurement import SetKey

R = TypeVar("R", bound=Row)
Run = tuple[SetKey | None, Sequence[EventRow]]
Progress = Callable[[int, int], None]
"""Called with the sets that are done and their number."""


def group_sets(events: Iterable[EventRow]) -> Iterator[Run]:
    """Yield runs of consecutive events with the same set, in order, each with its key (None: no set)."""
    for set_key, run in groupby(events, key=lambda event: event.set_key):
        yield set_key, list(run)


def repeat_action(event: EventRow, assessors: PositionAssessors, positions: Container[str | None]) -> None:
    """Repeat a person's action on the assessors: discard a renewed baseline's state, or enable a transducer.

    Other events, and resets at positions that are not in ``positions``, are ignored.
    """
    if event.kind in STEPS:
        assessors.discard_state(str(event.position))
    elif event.kind == "alarm_reset" and event.payload["kind"] in RETIRING and event.position in positions:
        assessors.enable(str(event.position))


def full_row(kind: type[R], event: EventRow, id_name: str = "id") -> R:
    """Build the row of a kind from the columns in an event's payload; ``id_name`` is the key of its id.

    Raises TypeError if a column without default is missing.
    """
    columns = {name: event.payload[name] for name in kind.__slots__ if name in event.payload}
    if id_name in event.payload:
        columns["id"] = event.payload[id_name]
    return kind(**columns)
