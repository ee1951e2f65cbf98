"""Notifications of one test: a thread a receiver, beside the requests; one web service of a test sends."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

from daq_service.catalogue.reader import Catalogue
from daq_service.errors import BusyError, SolimonError
from daq_service.processes.data_folder import BACKUP_FILE, hold_lock
from daq_service.settings.notifications import ReceiverSettings
from daq_service.settings.tree import Settings
from daq_service.web.notifications.addresses import address_of
from daq_service.web.notifications.by_apprise import notify
from daq_service.web.notifications.delivery_log import DeliveryLog
from daq_service.web.notifications.messages import Message
from daq_service.web.notifications.receiver import ReceiverLine
from daq_service.web.notifications.source import Source
from daq_service.web.notifications.webhook import Bounds, Cut, Outcome, post

log = logging.getLogger(__name__)

LOCK_FILE = "notifier.lock"
TROUBLE_PAUSE_S = 5.0
"""After the catalogue could not be read, or while another web service of this test sends."""
LONGEST_END_S = 0.5
"""How long the end waits for attempts that were cut: their threads end with the process anyway."""


class Notifications:
    """Tells receivers of alarms, from `start` to `close`; without receivers it does nothing.

    Parameters
    ----------
    catalogue
        Opens it, or returns the open one; `NoDataYetError` before the first record.
    bounds
        How long a webhook is waited for.
    """

    def __init__(
        self,
        settings: Settings,
        folder: Path,
        catalogue: Callable[[], Catalogue],
        *,
        bounds: Bounds | None = None,
    ) -> None:
        self.settings, self._folder = settings.notifications, folder
        self.deliveries = DeliveryLog(folder)
        self._source = Source(settings, folder, catalogue)
        self._bounds, self._cuts = bounds or Bounds(), [Cut()]
        self._stop = threading.Event()
        self._threads: list[threading.Thread] = []
        self.lines = {name: self._line(name, own) for name, own in self.settings.receivers.items()}
        self.why_silent = "the service has not begun" if self.lines else "no receivers are configured"

    def start(self) -> None:
        """Send from now on, as soon as no other web service of this test does."""
        if self.lines and (self._folder / BACKUP_FILE).exists():
            self.why_silent = "this is a backup; the test's own folder tells"
        elif self.lines:
            self._run(self._own, "notifications")

    def close(self) -> None:
        """End soon: attempts that are under way are cut, and made again by the next start."""
        self._stop.set()
        for cut in self._cuts:
            cut.close()

    def join(self) -> None:
        """Wait a moment for the threads after `close`."""
        for thread in self._threads:
            thread.join(LONGEST_END_S)

    def _run(self, body: Callable[[], None], name: str) -> threading.Thread:
        thread = threading.Thread(target=body, name=name, daemon=True)
        self._threads.append(thread)
        thread.start()
        return thread

    def _line(self, name: str, own: ReceiverSettings) -> ReceiverLine:
        return ReceiverLine(
            name,
            self.settings,
            self._source,
            self.deliveries,
            partial(self._send, name, own, self._new_cut()),
            partial(self._send, name, own, self._new_cut()),
        )

    def _new_cut(self) -> Cut:
        self._cuts.append(Cut())
        return self._cuts[-1]

    def _send(self, name: str, own: ReceiverSettings, cut: Cut, message: Message) -> Outcome:
        address = address_of(name, own)
        if own.kind == "apprise":
            return notify(address, message)
        return post(address, message, bounds=self._bounds, cut=cut)

    def _own(self) -> None:
        """Body of the thread that holds the lock while the others send."""
        while not self._stop.is_set():
            try:
                with hold_lock(
                    self._folder, LOCK_FILE, f"process {os.getpid()}", who="web service", patience_s=0.0
                ):
                    self.why_silent = ""
                    senders = [
                        self._run(partial(self._follow, line), f"tell-{line.name}")
                        for line in self.lines.values()
                    ]
                    for sender in senders:
                        sender.join()
            except BusyError:
                self.why_silent = "another web service of this test sends"
                self._stop.wait(TROUBLE_PAUSE_S)
            except SolimonError as error:
                self._tell_trouble(str(error))
                self._stop.wait(TROUBLE_PAUSE_S)

    def _follow(self, line: ReceiverLine) -> None:
        """Body of a receiver's thread."""
        while not self._stop.is_set():
            try:
                pause_s = line.step()
                self.why_silent = ""
            except Exception as error:  # noqa: BLE001 - the next message may be delivered
                self._tell_trouble(str(error))
                pause_s = TROUBLE_PAUSE_S
            self._stop.wait(pause_s)

    def _tell_trouble(self, told: str) -> None:
        if told != self.why_silent:
            log.warning("no notifications now, tried again: %s", told)
        self.why_silent = told
