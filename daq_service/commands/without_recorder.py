"""Orders to a test that nobody records: carried out by the web service in one transaction.

It holds the recorder's lock meanwhile. The order with its answer, what it changes and the event that tells of
it are stored together: whoever is killed has done all of it or nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from daq_service.alarms.states import Moment
from daq_service.assessment.transaction import Transaction
from daq_service.catalogue import Catalogue
from daq_service.catalogue.history import HistoryFollower
from daq_service.catalogue.rows import AlarmRow, AnnotationRow, CommandRow
from daq_service.catalogue.store import open_for_one_command
from daq_service.commands.kinds import DeskOrder, Facts
from daq_service.commands.running_test import StoredTest
from daq_service.processes.data_folder import own_data_folder


def carry_out_unattended(
    folder: Path,
    order: DeskOrder,
    *,
    facts: Callable[[Catalogue], Facts],
    moment: Callable[[], Moment],
) -> int:
    """Carry an order out in the recorder's place, and return its id.

    Parameters
    ----------
    facts, moment
        Asked once nobody else may change the test.

    Raises
    ------
    BusyError
        A recorder has come meanwhile: give it the order. Nothing was done.
    OrderRefusedError
        It cannot be carried out. Nothing was done.
    StorageError
        The folder cannot be written, or its catalogue is damaged. Nothing was done.
    """
    with own_data_folder(folder), open_for_one_command(folder) as catalogue:
        history = HistoryFollower(folder, catalogue)
        history.begin()
        order.refuse_forbidden(facts(catalogue))
        done: list[Transaction] = []
        test = StoredTest(
            moment=moment,
            alarms={(row.position, row.kind): row for row in catalogue.rows(AlarmRow)},
            annotations=lambda: catalogue.rows(AnnotationRow),
            store=done.append,
        )
        result = order.carry_out_stored(test)
        (transaction,) = done
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
