"""The recorder's side: orders are rows of ``commands``, carried out and answered one at a time."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from daq_service.catalogue import RecorderCatalogue
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
            order_id, kind, author = row.id, row.kind, row.author
            try:
                order = read_order(kind, author, row.arguments)
                result = order.carry_out(self._test, order_id, self._facts())
            except (UsageError, ValueError) as error:
                log.warning("order %d (%s) refused: %s", order_id, kind, error)
                self._catalogue.finish_command(order_id, "refused", str(error))
            else:
                log.info("order %d (%s) of %s: %s", order_id, kind, author, result)
                self._catalogue.finish_command(order_id, "done", result)
            # What is stored says it, as after a restart.
            self._held = self._catalogue.held() or ""

    def _facts(self) -> Facts:
        return Facts(
            can_skip_time=isinstance(self._test.clock, SimulatedClock),
            held=self._held,
            positions=self._test.positions,
            has_supply=self._test.supply is not None,
            alarms=list(self._test.alarms.values()),
        )
