"""Commands that shelve alarms or take them out of service, and end that."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import AfterValidator, Field

from daq_service.alarms import states
from daq_service.alarms.operator_actions import LONGEST_SHELF_H, end_suppression, shelve, take_out_of_service
from daq_service.catalogue.rows import AlarmRow
from daq_service.commands.kinds import LARGEST_ID, SEEN, AlarmArguments, Facts, Refusal, StoredCommand, Strict
from daq_service.settings.foreign_text import require_visible_text

if TYPE_CHECKING:
    from daq_service.commands.running_test import StoredTest

Reason = Annotated[
    str,
    Field(min_length=1, max_length=500, json_schema_extra=SEEN, description="Why; shown to everybody"),
    AfterValidator(partial(require_visible_text, message="give the reason")),
]


class OutOfServiceArguments(Strict):
    """Which alarm, and why."""

    alarm_id: int = Field(ge=1, le=LARGEST_ID)
    reason: Reason


class ShelfArguments(OutOfServiceArguments):
    """Which alarm, for how long, and why."""

    for_h: float = Field(gt=0.0, le=LONGEST_SHELF_H, allow_inf_nan=False, description="Duration in hours")


class _AlarmOrder(StoredCommand):
    def _build_change(self, row: AlarmRow, moment: states.Moment) -> states.Change:
        """Return the alarm's change, not stored; ValueError if the alarm's state does not allow it.

        Each kind implements it; the default raises NotImplementedError.
        """
        raise NotImplementedError

    def _find_refusal(self, facts: Facts) -> Refusal | None:
        """Return the refusal of an alarm that is unknown, not the newest, or in a wrong state; else None.

        The newest is that of the same position and kind. An unknown alarm is marked as ``missing``.
        """
        wanted = self.arguments.alarm_id
        row = next((row for row in facts.alarms if row.id == wanted), None)
        if row is None:
            return Refusal(f"there is no alarm {wanted}", "/api/v1/alarms lists them.", missing=True)
        alike = (other for other in facts.alarms if (other.position, other.kind) == (row.position, row.kind))
        newest = max(other.id or 0 for other in alike)
        if newest != wanted:
            return Refusal(f"alarm {wanted} is over, alarm {newest} came after it", f"Choose alarm {newest}.")
        try:
            self._build_change(row, states.Moment(utc_ns=0, due_h=0.0, set_index=None))
        except ValueError as error:
            return Refusal(str(error), "/api/v1/alarms has its present state.")
        return None

    def carry_out_stored(self, test: StoredTest) -> str:
        """Store the alarm with its changed suppression and event; return the command's kind in words.

        Raise ValueError if the alarm's state does not allow the change.
        """
        moment = test.moment()
        test.store_alarm_changes(moment, self._build_change(test.find_alarm(self.arguments.alarm_id), moment))
        return self.kind.replace("_", " ")


class ShelveAlarm(_AlarmOrder):
    """Suppress an alarm for a limited time."""

    kind: Literal["shelve_alarm"]
    arguments: ShelfArguments

    def _build_change(self, row: AlarmRow, moment: states.Moment) -> states.Change:
        """Return the change that shelves the alarm for ``for_h`` hours, replacing a running shelf.

        Raise ValueError if the alarm is normal or out of service.
        """
        arguments = self.arguments
        return shelve(row, self.author, arguments.reason.strip(), arguments.for_h, moment, time.time_ns())


class UnshelveAlarm(_AlarmOrder):
    """End the shelving of an alarm."""

    kind: Literal["unshelve_alarm"]
    arguments: AlarmArguments

    def _build_change(self, row: AlarmRow, moment: states.Moment) -> states.Change:
        """Return the change that unshelves the alarm, not stored; ValueError if it is not shelved."""
        return end_suppression(row, "shelved", self.author, self.arguments.note, moment)


class TakeOutOfService(_AlarmOrder):
    """Suppress an alarm until it is returned to service."""

    kind: Literal["take_out_of_service"]
    arguments: OutOfServiceArguments

    def _build_change(self, row: AlarmRow, moment: states.Moment) -> states.Change:
        """Return the change that takes the alarm out of service and unshelves it.

        Raise ValueError if it is out of service already.
        """
        return take_out_of_service(row, self.author, self.arguments.reason.strip(), moment)


class ReturnToService(_AlarmOrder):
    """Return an alarm to service."""

    kind: Literal["return_to_service"]
    arguments: AlarmArguments

    def _build_change(self, row: AlarmRow, moment: states.Moment) -> states.Change:
        """Return the change that returns the alarm to service; ValueError if it is not out of service."""
        return end_suppression(row, "out_of_service", self.author, self.arguments.note, moment)
