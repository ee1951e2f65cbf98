"""Commands to a test without a recorder: the web service executes them in one transaction.

It holds the recorder's lock meanwhile. Command, answer, changes and event are stored together, so a killed
process has stored all of them or none.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from daq_service.alarms.states import Moment
from daq_service.catalogue import Catalogue, SetCommit
from daq_service.catalogue.history import HistoryFollower
from daq_service.catalogue.rows import AlarmRow, AnnotationRow, CommandRow
from daq_service.catalogue.store import open_for_command
from daq_service.commands.kinds import Facts, StoredCommand
from daq_service.commands.running_test import StoredTest
from daq_service.processes.data_folder import hold_recorder_lock


def execute_without_recorder(
    folder: Path,
    order: StoredCommand,
    *,
    facts: Callable[[Catalogue], Facts],
    moment: Callable[[], Moment],
) -> int:
    """Execute a command in place of the recorder, holding its lock; return the command's id.

    Command, answer, changes and event are stored in one transaction, then in the history file.

    Parameters
    ----------
    facts, moment
        Called after the lock is held.

    Raises
    ------
    BusyError
        A recorder has started meanwhile: send it the command. Nothing was changed.
    CommandRejectedError
        It cannot be executed. Nothing was changed.
    StorageError
        The folder cannot be written, or its catalogue is corrupt. Nothing was changed.
    """
    with hold_recorder_lock(folder), open_for_command(folder) as catalogue:
        history = HistoryFollower(folder, catalogue)
        history.begin()
        order.require_allowed(facts(catalogue))
        transactions: list[SetCommit] = []
        test = StoredTest(
            moment=moment,
            alarms={(row.position, row.kind): row for row in catalogue.rows(AlarmRow)},
            annotations=lambda: catalogue.rows(AnnotationRow),
            store=transactions.append,
        )
        result = order.carry_out_stored(test)
        (transaction,) = transactions
        now_ns = time.time_ns()
        transaction.order = CommandRow(
            id=0,
            wall_utc_ns=now_ns,
            author=order.author,
            kind=order.kind,
            arguments=order.arguments.model_dump(),
            state="done",
            result=result,
            finished_wall_utc_ns=now_ns,
        )
        order_id = catalogue.commit_set(transaction).order_id
        assert order_id is not None, "the transaction carries an order"
        history.follow(now=True)
        return order_id
