"""Execution of commands in the recorder: rows of ``commands``, executed and answered one at a time.

A command is marked as started before it is executed. Commands that are open at a start of the recorder are
closed and never executed again. The changes of a command are stored together with its answer, so a command
that changes only rows is done or has expired. Any other command, such as to switch the supply, may be
executed in part when the recorder dies: it is reported as failed. A command that is not started by its
deadline, or before its recorder ends, expires.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace

from daq_service.catalogue import RecorderCatalogue, SetCommit
from daq_service.catalogue.rows import CommandRow, CommandState
from daq_service.commands.deadline import describe_expiry, mark_if_expired, remaining_now_s
from daq_service.commands.kinds import Command, Facts
from daq_service.commands.registry import KINDS, parse_command
from daq_service.commands.running_test import PendingAnswer, RunningTest
from daq_service.errors import StorageError, UsageError
from simulator.clock import SimulatedClock

log = logging.getLogger(__name__)

Answer = tuple[CommandState, str]

FAILED: Answer = (
    "failed",
    "the recorder ended while executing it; check the result before you send it again",
)
HARMLESS_TWICE = ("stop", "supply_off")
"""Commands that are executed even if the disk cannot store the mark before."""


class CommandExecutor:
    """Executor of commands, one at a time, between shots and while waiting.

    Parameters
    ----------
    left_s
        Returns the remaining time of a command in s of real time, for any clock of the test.
    adopt
        Takes over the alarm that another process may have raised or cleared.

    Attributes
    ----------
    paused
        Who paused the test and why; empty while it runs. A pause continues after a restart.
    """

    def __init__(
        self,
        catalogue: RecorderCatalogue,
        test: RunningTest,
        *,
        left_s: Callable[[CommandRow], float] = remaining_now_s,
        adopt: Callable[[], None] = lambda: None,
    ) -> None:
        """Read from the catalogue whether the test is paused; no command is executed here."""
        self._catalogue = catalogue
        self._test = test
        self._left_s, self._adopt = left_s, adopt
        self._has_started = False
        self._answers: dict[int, Answer] = {}
        self._awaited: dict[int, PendingAnswer] = {}
        # A restart never ends a pause.
        self.paused = catalogue.paused() or ""

    def close_earlier_commands(self) -> None:
        """Close the commands that an earlier recorder left open, without executing them, as `close` does.

        After a call that succeeded, later calls do nothing.
        """
        if not self._has_started:
            self.close("it was sent before this recorder started")
            self._has_started = True

    def close(self, reason: str) -> None:
        """Store an answer to every open command without executing it: expired, for this reason.

        A started command that changes more than rows is answered as failed: its outcome is unknown. An answer
        that could not be stored before is stored now. StorageError of the catalogue passes through.
        """
        for row in self._catalogue.list_open_commands():
            is_unknown = row.state == "started" and not KINDS.get(row.kind, Command).rows_only
            answer = FAILED if is_unknown else ("expired", describe_expiry(reason))
            self._store_answer(row, self._answers.get(row.id, answer))

    def expire_open_commands(self) -> None:
        """Answer the commands that are still open when this recorder ends, as `close` does.

        A StorageError or OSError is logged as a warning, not raised: the next recorder answers them.
        """
        try:
            self.close("the recorder has ended")
        except (StorageError, OSError) as error:
            log.warning("open commands are not answered; the next recorder does it: %s", error)

    def execute_open_commands(self) -> None:
        """Execute the open commands, oldest first, store each answer, and update `paused`.

        Commands of an earlier recorder are closed first. A rejection is stored as the answer. An answer that
        an instrument owes is polled at the next call. Raise StorageError if a start or an answer cannot be
        stored; an answer that was not stored is stored by a later call, without a second execution.
        """
        self.close_earlier_commands()
        for row in self._catalogue.list_open_commands():
            # Once: if the disk cannot store an answer, the supply must not be switched on a second time.
            answer = self._answers.get(row.id) or self._execute_command(row)
            # Read from the catalogue, as after a restart.
            self.paused = self._catalogue.paused() or ""
            if answer is not None:
                self._answers[row.id] = answer
                self._store_answer(row, answer)

    def _store_answer(self, row: CommandRow, answer: Answer) -> None:
        """Store a command's state and result, then forget the remembered answer.

        An expired or failed command is logged as a warning. A StorageError passes through, such as
        CatalogueConflictError for a command that has an answer already; the remembered answer is then kept.
        """
        self._catalogue.finish_command(row.id, *answer)
        self._answers.pop(row.id, None)
        if answer[0] in ("expired", "failed"):
            log.warning("command %d (%s) of %s: %s: %s", row.id, row.kind, row.author, *answer)

    def _execute_command(self, row: CommandRow) -> Answer | None:
        """Mark a command as started, execute it, and return its state and result.

        Return None if they are stored with its changes, and while an instrument has not responded. An expired
        command is not executed; a rejected one returns the reason. Raise StorageError if start or changes
        cannot be stored; the start of `HARMLESS_TWICE` commands need not be.
        """
        if (awaited := self._awaited.get(row.id)) is not None:
            return self._poll_answer(row, awaited)
        if row.state == "pending" and self._left_s(row) > 0.0:
            try:
                self._catalogue.start_command(row.id)
            except StorageError:
                if row.kind not in HARMLESS_TWICE:
                    raise
        # Checked again: a reader that found it pending at its deadline has reported it as expired.
        current_row = mark_if_expired(replace(row, state="pending"), self._left_s(row))
        if current_row.state == "expired":
            return "expired", current_row.result or ""
        transactions: list[SetCommit] = []
        self._adopt()
        try:
            order = parse_command(row.kind, row.author, row.arguments)
            result = order.carry_out(
                replace(self._test, store=transactions.append), row.id, self._collect_facts()
            )
        except (UsageError, ValueError) as error:
            return _log_rejection(row, error)
        if callable(result):
            self._awaited[row.id] = result
            return self._poll_answer(row, result)
        log.info("command %d (%s) of %s: %s", row.id, row.kind, row.author, result)
        if not transactions:
            return "done", result
        (transaction,) = transactions
        transaction.order = replace(row, state="done", result=result, finished_wall_utc_ns=time.time_ns())
        self._test.store(transaction)
        return None

    def _poll_answer(self, row: CommandRow, awaited: PendingAnswer) -> Answer | None:
        """Poll an instrument's answer to a command by calling ``awaited``; return None while there is none.

        A ValueError of the call is returned as state ``rejected``. An answered command is polled no further.
        """
        try:
            if (result := awaited()) is None:
                return None
        except ValueError as error:
            del self._awaited[row.id]
            return _log_rejection(row, error)
        del self._awaited[row.id]
        log.info("command %d (%s) of %s: %s", row.id, row.kind, row.author, result)
        return "done", result

    def _collect_facts(self) -> Facts:
        """Collect the present facts of test and catalogue that decide whether a command can be executed.

        Errors of the catalogue pass through.
        """
        return Facts(
            can_skip_time=isinstance(self._test.clock, SimulatedClock),
            paused=self.paused,
            positions=self._test.positions,
            has_supply=self._test.supply is not None,
            alarms=list(self._test.alarms.values()),
            places=self._catalogue.list_position_names(),
            annotations=self._test.annotations(),
            baselines=self._catalogue.read_newest_baselines(),
        )


def _log_rejection(row: CommandRow, error: Exception) -> Answer:
    """Log a warning that a command is rejected; return state ``rejected`` and the text of the error."""
    log.warning("command %d (%s) rejected: %s", row.id, row.kind, error)
    return "rejected", str(error)
