"""The recorder's side: orders are rows of ``commands``, carried out and answered one at a time.

An order is marked as started before it is carried out, and what is found open at a start is closed: nobody
carries it out again. What an order stores is stored together with its answer, so one that does nothing else
is done or has expired. Of one that does more, such as to switch the supply, nobody knows how far its
recorder came before it died: it is told as failed. One that was not begun by its deadline, or before its
recorder ended, expires.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace

from daq_service.assessment.transaction import Transaction
from daq_service.catalogue import RecorderCatalogue
from daq_service.catalogue.rows import CommandRow, CommandState
from daq_service.clock import SimulatedClock
from daq_service.commands.deadline import as_it_stands, expired_reason, left_now_s
from daq_service.commands.kinds import Facts, Order
from daq_service.commands.registry import KINDS, parse_command
from daq_service.commands.running_test import Awaited, RunningTest
from daq_service.errors import StorageError, UsageError
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

Answer = tuple[CommandState, str]

FAILED: Answer = (
    "failed",
    "the recorder ended while carrying it out; look before you give it again",
)
HARMLESS_TWICE = ("stop", "supply_off")
"""Carried out also where the disk does not take the mark before."""
LISTEN_EVERY_S = 0.2
"""A person does not notice a fifth of a second; SQLite does not notice five queries a second."""


class CommandExecutor:
    """Obeys orders, one at a time, between shots and while waiting.

    Parameters
    ----------
    listen_every_s
        Shortest time between two looks, on the machine's monotonic clock.
    left_s
        Tells the time that an order has left, in real time whatever clock the test runs on.
    adopt
        Takes over the alarm that another process may have raised or cleared.
    """

    def __init__(
        self,
        catalogue: RecorderCatalogue,
        test: RunningTest,
        *,
        listen_every_s: float = LISTEN_EVERY_S,
        mono_ns: Callable[[], int] = time.monotonic_ns,
        left_s: Callable[[CommandRow], float] = left_now_s,
        adopt: Callable[[], None] = lambda: None,
    ) -> None:
        self._catalogue = catalogue
        self._test = test
        self._listen_every_ns = round(listen_every_s * NS_PER_S)
        self._mono_ns = mono_ns
        self._left_s, self._adopt = left_s, adopt
        self._begun = False
        self._listened_ns: int | None = None
        self._answers: dict[int, Answer] = {}
        self._awaited: dict[int, Awaited] = {}
        # Whatever ended the last recorder: a restart never ends a hold.
        self._held = catalogue.held() or ""

    @property
    def held(self) -> str:
        """Who holds the test and why; empty while it runs. A hold outlives a restart."""
        return self._held

    def begin(self) -> None:
        """Close what an earlier recorder left open: nothing of it is carried out any more."""
        if not self._begun:
            self.close("it was given before this recorder began")
            self._begun = True

    def close(self, why: str) -> None:
        """Answer every open order without carrying it out."""
        for row in self._catalogue.open_commands():
            unknown = row.state == "started" and not KINDS.get(row.kind, Order).rows_only
            left_open = FAILED if unknown else ("expired", expired_reason(why))
            self._finish(row, self._answers.get(row.id, left_open))

    def listen(self) -> None:
        """Carry out what is waiting; a refused order is answered with the reason."""
        self.begin()
        now_ns = self._mono_ns()
        if self._listened_ns is not None and now_ns - self._listened_ns < self._listen_every_ns:
            return
        self._listened_ns = now_ns
        for row in self._catalogue.open_commands():
            # Once: an answer that the disk did not take must not switch a supply on a second time.
            answer = self._answers.get(row.id) or self._carried_out(row)
            # What is stored says it, as after a restart.
            self._held = self._catalogue.held() or ""
            if answer is not None:
                self._answers[row.id] = answer
                self._finish(row, answer)

    def _finish(self, row: CommandRow, answer: Answer) -> None:
        self._catalogue.finish_command(row.id, *answer)
        self._answers.pop(row.id, None)
        if answer[0] in ("expired", "failed"):
            log.warning("order %d (%s) of %s: %s: %s", row.id, row.kind, row.author, *answer)

    def _carried_out(self, row: CommandRow) -> Answer | None:
        """Carry an order out; its state and result, None where they are stored with what it did.

        None also where an instrument has not answered yet.
        """
        if (awaited := self._awaited.get(row.id)) is not None:
            return self._answered(row, awaited)
        if row.state == "pending" and self._left_s(row) > 0.0:
            try:
                self._catalogue.start_command(row.id)
            except StorageError:
                if row.kind not in HARMLESS_TWICE:
                    raise
        # Asked again: whoever still found it pending at its deadline was told that nobody begins it.
        standing = as_it_stands(replace(row, state="pending"), self._left_s(row))
        if standing.state == "expired":
            return "expired", standing.result or ""
        told: list[Transaction] = []
        self._adopt()
        try:
            order = parse_command(row.kind, row.author, row.arguments)
            result = order.carry_out(replace(self._test, store=told.append), row.id, self._facts())
        except (UsageError, ValueError) as error:
            return _refused(row, error)
        if callable(result):
            self._awaited[row.id] = result
            return self._answered(row, result)
        log.info("order %d (%s) of %s: %s", row.id, row.kind, row.author, result)
        if not told:
            return "done", result
        (transaction,) = told
        transaction.order = replace(row, state="done", result=result, finished_wall_utc_ns=time.time_ns())
        self._test.store(transaction)
        return None

    def _answered(self, row: CommandRow, awaited: Awaited) -> Answer | None:
        """Return the answer of an instrument to a command that was sent to it; None while there is none."""
        try:
            if (result := awaited()) is None:
                return None
        except ValueError as error:
            del self._awaited[row.id]
            return _refused(row, error)
        del self._awaited[row.id]
        log.info("command %d (%s) of %s: %s", row.id, row.kind, row.author, result)
        return "done", result

    def _facts(self) -> Facts:
        return Facts(
            can_skip_time=isinstance(self._test.clock, SimulatedClock),
            held=self._held,
            positions=self._test.positions,
            has_supply=self._test.supply is not None,
            alarms=list(self._test.alarms.values()),
            places=self._catalogue.position_names(),
            annotations=self._test.annotations(),
            baselines=self._catalogue.newest_baselines(),
        )


def _refused(row: CommandRow, error: Exception) -> Answer:
    log.warning("command %d (%s) refused: %s", row.id, row.kind, error)
    return "refused", str(error)
