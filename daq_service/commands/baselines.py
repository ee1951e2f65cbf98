"""Commands about baselines: approve one, or renew it after a repair or a re-seat."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import AfterValidator, Field

from daq_service.alarms.operator_actions import reset_alarm
from daq_service.alarms.states import ALARMS_OF_CHANGE, NOT_ASSESSED
from daq_service.assessment.baseline_lifecycle import APPROVED, COLLECTING, RETIRED, approve_row, renew
from daq_service.commands.kinds import SEEN, Facts, Refusal, TransducerArguments, TransducerCommand
from daq_service.settings.foreign_text import require_visible_text

if TYPE_CHECKING:
    from daq_service.commands.running_test import RunningTest


class RenewalArguments(TransducerArguments):
    """Whose baseline is retired, and why."""

    note: Annotated[
        str,
        Field(min_length=1, max_length=2000, json_schema_extra=SEEN),
        AfterValidator(partial(require_visible_text, message="state why the baseline is retired")),
    ]


class ApproveBaseline(TransducerCommand):
    """Sign a proposed baseline."""

    kind: Literal["approve_baseline"]

    def _find_refusal(self, facts: Facts) -> Refusal | None:
        """Return the refusal unless the newest baseline of the position is proposed, with limits; else None.

        An unknown position is refused, too.
        """
        position = self.arguments.position
        unknown = super()._find_refusal(facts)
        row = facts.baselines.get(position)
        state = "collecting" if row is None else row.state
        if unknown is None and row is not None and state == "proposed" and row.limit_reason:
            reason = f"the baseline of {position} has no limits: {row.limit_reason}"
            return Refusal(reason, "It assesses no set, approved or not.")
        if unknown is not None or state == "proposed":
            return unknown
        reason = f"the baseline of {position} is {state}: there is nothing to sign"
        return Refusal(reason, "A baseline waits for a signature where baseline.approval is by_a_person.")

    def _find_refusal_at(self, position: str, disabled: str | None) -> Refusal | None:
        """Return None for any state of the transducer: a baseline can be approved while that is disabled."""
        return None

    def _carry_out(self, test: RunningTest, order_id: int) -> str:
        """Store the baseline as approved by the author, with its event; return the result as text."""
        row = test.baseline(self.arguments.position)
        assert row is not None, "a proposed baseline has a row"
        moment = test.moment()
        test.change_baselines(moment, (approve_row(row, self.author, moment.utc_ns), APPROVED))
        return f"{row.name} is approved"


class RenewBaseline(TransducerCommand):
    """Retire a baseline: its successor collects from the next planned set on."""

    kind: Literal["renew_baseline"]
    arguments: RenewalArguments

    def _carry_out(self, test: RunningTest, order_id: int) -> str:
        """Retire the baseline, reset the alarms that depend on it and start a new one, in one transaction.

        Return the result as text, with the sets that the new baseline collects. Raise ValueError, and change
        nothing, if the schedule leaves too few sets for it.
        """
        position, moment, reason = self.arguments.position, test.moment(), self.arguments.note.strip()
        retired, collecting = renew(
            position,
            test.settings,
            test.baseline(position),
            first_set=test.next_set(),
            author=self.author,
            reason=reason,
            utc_ns=moment.utc_ns,
        )
        # Nothing has returned to normal: what they were judged by is gone.
        ended = [
            reset_alarm(row, self.author, f"its baseline was retired: {reason}", moment)
            for kind in (*ALARMS_OF_CHANGE, NOT_ASSESSED)
            if (row := test.alarms.get((position, kind))) is not None and row.state != "normal"
        ]
        test.change_baselines(moment, (retired, RETIRED), (collecting, COLLECTING), ended=ended)
        test.renewed(position)
        return (
            f"{retired.name} is retired; {collecting.name} collects sets {collecting.first_set_index} to "
            f"{collecting.last_set_index}, and no set is assessed at {position} till then"
        )
