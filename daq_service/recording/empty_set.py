"""Rows and alarms of a set that gave no record."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from daq_service.alarms.rig_trouble import build_rig_condition, find_connection_loss
from daq_service.alarms.states import Moment
from daq_service.assessment.assessor import PositionResult
from daq_service.catalogue import SetCommit
from daq_service.recording.acquire_set import TakenSet
from daq_service.recording.confirmations import add_confirmation_evidence
from daq_service.recording.persistence import Persistence
from daq_service.recording.set_assessor import SetAssessor, add_position_rows
from hardware_drivers.measurement import DueSet

log = logging.getLogger(__name__)


def store_empty_set(
    assessor: SetAssessor,
    persistence: Persistence,
    due: DueSet,
    reasons: Mapping[str, str],
    *,
    utc_ns: int,
    tried: TakenSet | None = None,
) -> None:
    """Store the rows of a set without a record (`build_empty_set_rows`) after all queued jobs.

    If the disk refuses, they stay queued and no error is raised.
    """
    rows = partial(build_empty_set_rows, assessor, due, reasons, utc_ns=utc_ns, tried=tried)
    persistence.post(rows, assessor.commit)


def build_empty_set_rows(
    assessor: SetAssessor,
    due: DueSet,
    reasons: Mapping[str, str],
    *,
    utc_ns: int,
    tried: TakenSet | None = None,
) -> SetCommit:
    """Build the rows, alarms and events of a set without a record; the caller commits them.

    Logs a warning. The assessors of the tried positions count their missed strikes.

    Parameters
    ----------
    reasons
        Why there is none, by position; at least one.
    utc_ns
        Time of the events and alarms.
    tried
        The attempts, which show the state of the instruments; None: there were none.
    """
    moment = Moment.of_set(due, utc_ns)
    transaction = SetCommit()
    disabled = assessor.disabled() if tried is None else tried.disabled
    for position in assessor.list_set_positions(due):
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
            assessor.build_empty_row(
                due,
                position,
                disabled=gone,
                reason=disabled.get(position) or reasons[position],
            ),
            n_missed=len(missed),
            n_restrikes=restrikes,
        )
        add_position_rows(transaction, row, [], position_result, moment)
        for condition in position_result.conditions:
            assessor.apply_alarm(condition, moment, transaction)
    if tried is not None and (tried.trouble is not None or tried.missed):
        unanswered = "" if tried.trouble is not None else find_connection_loss(tried.missed)
        payload = build_rig_condition(due, tried.format_error(), unanswered, proven=assessor.proven)
        assessor.apply_alarm(payload, moment, transaction)
    log.warning("set %s missed: %s", due.set_key, next(iter(reasons.values())))
    if due.position is not None:
        add_confirmation_evidence(assessor.alarms, due.position, transaction, moment)
        return transaction
    return assessor.add_environment(due, moment, transaction)
