"""Rows and alarms of a set that gave no record."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from daq_service.alarms.rig_trouble import lost_cause, rig_condition
from daq_service.alarms.states import Moment
from daq_service.assessment.assessor import PositionResult
from daq_service.catalogue import SetCommit
from daq_service.recording.acquire_set import TakenSet
from daq_service.recording.confirmations import add_confirmation
from daq_service.recording.persistence import Persistence
from daq_service.recording.set_assessor import SetAssessor, add_position
from hardware_drivers.measurement import DueSet

log = logging.getLogger(__name__)


def store_nothing_taken(
    assessor: SetAssessor,
    persistence: Persistence,
    due: DueSet,
    reasons: Mapping[str, str],
    *,
    utc_ns: int,
    tried: TakenSet | None = None,
) -> None:
    """Store the rows of a set without a record (`nothing_taken`) after what waits for the disk."""
    rows = partial(nothing_taken, assessor, due, reasons, utc_ns=utc_ns, tried=tried)
    persistence.post(rows, assessor.commit)


def nothing_taken(
    assessor: SetAssessor,
    due: DueSet,
    reasons: Mapping[str, str],
    *,
    utc_ns: int,
    tried: TakenSet | None = None,
) -> SetCommit:
    """Return the rows of a set without a record, with the reasons but no file; to be committed.

    Parameters
    ----------
    reasons
        Why there is none, by position.
    tried
        The attempts, which show the state of the instruments; None: there were none.
    """
    moment = Moment.of_set(due, utc_ns)
    transaction = SetCommit()
    disabled = assessor.disabled() if tried is None else tried.disabled
    for position in assessor.positions_of(due):
        gone = position in disabled
        missed = (
            []
            if tried is None
            else [key for key in (item.key for item in tried.missed) if key.position == position]
        )
        restrikes = sum(key.attempt > 0 for key in missed)
        position_result = PositionResult()
        if tried is not None and not gone and due.position is None:
            position_result = assessor.assessors[position].assess_empty_set(due, len(missed) - restrikes)
        row = replace(
            assessor.without_records(
                due,
                position,
                disabled=gone,
                reason=disabled.get(position) or reasons[position],
            ),
            n_missed=len(missed),
            n_restrikes=restrikes,
        )
        add_position(transaction, row, [], position_result, moment)
        for condition in position_result.conditions:
            assessor.carry_alarm(condition, moment, transaction)
    if tried is not None and (tried.trouble is not None or tried.missed):
        unanswered = "" if tried.trouble is not None else lost_cause(tried.missed)
        payload = rig_condition(due, tried.instrument_error(), unanswered, proven=assessor.proven)
        assessor.carry_alarm(payload, moment, transaction)
    log.warning("set %s missed: %s", due.set_key, next(iter(reasons.values())))
    if due.position is not None:
        add_confirmation(assessor.alarms, due.position, transaction, moment)
        return transaction
    return assessor.with_environment(due, moment, transaction)
