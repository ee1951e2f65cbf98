"""The recorder's side: orders are rows of ``commands``, carried out and answered one at a time."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from daq_service.catalogue import RecorderCatalogue
from daq_service.catalogue.rows import CommandRow
from daq_service.clock import SimulatedClock
from daq_service.errors import UsageError
from daq_service.orders.kinds import Facts, read_order
from daq_service.orders.running_test import RunningTest
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

LISTEN_EVERY_S = 0.2
"""A person does not notice a fifth of a second; SQLite does not notice five queries a second."""


class OrderListener:
    """Obeys orders, one at a time, between shots and while waiting.

    Parameters
    ----------
    listen_every_s
        Shortest time between two looks, on the machine's monotonic clock.
    """

    def __init__(
        self,
        catalogue: RecorderCatalogue,
        test: RunningTest,
        *,
        listen_every_s: float = LISTEN_EVERY_S,
        mono_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._catalogue = catalogue
        self._test = test
        self._listen_every_ns = round(listen_every_s * NS_PER_S)
        self._mono_ns = mono_ns
        self._listened_ns: int | None = None
        self._answers: dict[int, tuple[str, str]] = {}
        # Whatever ended the last recorder: a restart never ends a hold.
        self._held = catalogue.held() or ""

    @property
    def held(self) -> str:
        """Who holds the test and why; empty while it runs. A hold outlives a restart."""
        return self._held

    def listen(self) -> None:
        """Carry out what is waiting; a refused order is answered with the reason."""
        now_ns = self._mono_ns()
        if self._listened_ns is not None and now_ns - self._listened_ns < self._listen_every_ns:
            return
        self._listened_ns = now_ns
        for row in self._catalogue.pending_commands():
            # Once: an answer that the disk did not take must not switch a supply on a second time.
            if row.id not in self._answers:
                self._answers[row.id] = self._carried_out(row)
            # What is stored says it, as after a restart.
            self._held = self._catalogue.held() or ""
            self._catalogue.finish_command(row.id, *self._answers[row.id])
            del self._answers[row.id]

    def _carried_out(self, row: CommandRow) -> tuple[str, str]:
        """Carry an order out; its state and result."""
        try:
            order = read_order(row.kind, row.author, row.arguments)
            result = order.carry_out(self._test, row.id, self._facts())
        except (UsageError, ValueError) as error:
            log.warning("order %d (%s) refused: %s", row.id, row.kind, error)
            return "refused", str(error)
        log.info("order %d (%s) of %s: %s", row.id, row.kind, row.author, result)
        return "done", result

    def _facts(self) -> Facts:
        return Facts(
            can_skip_time=isinstance(self._test.clock, SimulatedClock),
            held=self._held,
            positions=self._test.positions,
            has_supply=self._test.supply is not None,
            alarms=list(self._test.alarms.values()),
        )
