"""Notifications of one test: a thread per receiver; one process of the test sends, which a lock decides.

The web service sends. The supervisor, or a recorder without one, stands by: it sends while no web service
responds, and goes on from the delivery log where that one stopped.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache, partial
from pathlib import Path
from typing import IO

from daq_service.catalogue.access import CatalogueAccess
from daq_service.catalogue.reader import Catalogue
from daq_service.errors import BusyError, SolimonError
from daq_service.processes.data_folder import BACKUP_FILE, hold_lock, lock_text
from daq_service.processes.heartbeat import WEB_FILE, read_heartbeat, web_state
from daq_service.processes.notifications.addresses import address_of
from daq_service.processes.notifications.by_apprise import notify
from daq_service.processes.notifications.delivery_log import DeliveryLog
from daq_service.processes.notifications.messages import Message
from daq_service.processes.notifications.receiver import ReceiverLine
from daq_service.processes.notifications.source import Source
from daq_service.processes.notifications.webhook import Bounds, Cut, Outcome, post
from daq_service.processes.recorder_watch import RecorderWatch
from daq_service.settings.notifications import ReceiverSettings
from daq_service.settings.tree import Settings
from daq_service.shared_file import remove_quietly

log = logging.getLogger(__name__)

LOCK_FILE = "notifier.lock"
NO_RECEIVERS = "no receivers are configured"
TROUBLE_PAUSE_S = 5.0
"""After the catalogue could not be read."""
LOOK_EVERY_S = 1.0
"""At the recorder, and at the process that sends."""
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
    watches
        The process that sends also looks after the recorder: it is another one.
    stands_by
        Send only while no web service of this test responds.
    """

    def __init__(
        self,
        settings: Settings,
        folder: Path,
        catalogue: Callable[[], Catalogue],
        *,
        bounds: Bounds | None = None,
        watches: bool = True,
        stands_by: bool = False,
    ) -> None:
        self.settings, self._folder = settings.notifications, folder
        self._watch = RecorderWatch(settings, folder, catalogue) if watches else None
        self._stands_by = stands_by
        self.deliveries = DeliveryLog(folder)
        self._source = Source(settings, folder, catalogue)
        self._bounds, self._cuts = bounds or Bounds(), [Cut()]
        self._stop = threading.Event()
        self._threads: list[threading.Thread] = []
        self.lines = self._new_lines()
        self.why_silent = "the service has not begun" if self.lines else NO_RECEIVERS

    def start(self) -> None:
        """Send from now on, as soon as no other process of this test does."""
        if not (self._folder / BACKUP_FILE).exists():
            if self.lines or self._watch:
                self._run(self._own, "notifications")
        elif self.lines:
            self.why_silent = "this is a backup; the test's own folder tells"

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

    def _new_lines(self) -> dict[str, ReceiverLine]:
        parts, found = (self.settings, self._source, self.deliveries), dict[str, ReceiverLine]()
        for name, own in self.settings.receivers.items():
            send, try_out = (partial(self._send, name, own, self._new_cut()) for _ in range(2))
            found[name] = ReceiverLine(name, *parts, send, try_out)
        return found

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
            if self._web_responds():
                self._stop.wait(LOOK_EVERY_S)
                continue
            text = f"process {os.getpid()}"
            try:
                with hold_lock(self._folder, LOCK_FILE, text, who="process", patience_s=0.0) as lock:
                    self._attend(lock)
            except BusyError:
                self._report_trouble("another process of this test sends")
                self._take_from_stalled()
                self._stop.wait(LOOK_EVERY_S)
            except SolimonError as error:
                self._report_trouble(str(error))
                self._stop.wait(TROUBLE_PAUSE_S)

    def _attend(self, lock: IO[bytes]) -> None:
        """Send and watch until the end, or until another process does."""
        self.why_silent, over = "" if self.lines else NO_RECEIVERS, threading.Event()
        self.lines = self._new_lines()  # another process may have sent since: the log states how far it came
        senders = [
            self._run(partial(self._follow, line, lock, over), f"tell-{line.name}")
            for line in self.lines.values()
        ]
        while not self._stop.is_set() and self._holds(lock) and not self._web_responds():
            try:
                if self._watch is not None:
                    self._watch.look()
            except (SolimonError, OSError) as error:
                _warn_once(f"the recorder is not watched, tried again: {error}")
            self._stop.wait(LOOK_EVERY_S)
        over.set()
        for sender in senders:
            sender.join()

    def _web_responds(self) -> bool:
        return self._stands_by and web_state(self._folder) == "responding"

    def _holds(self, lock: IO[bytes]) -> bool:
        """Return whether the lock's file still has its name: of a process that stalled it is taken away."""
        try:
            return os.path.samestat(os.fstat(lock.fileno()), (self._folder / LOCK_FILE).stat())
        except OSError:
            return False

    def _take_from_stalled(self) -> None:
        """Take the lock's name from a web service that is stopped and will not let go of it.

        Windows keeps the name of an open file; there the service's end is waited for.
        """
        if self._stands_by and web_state(self._folder) == "not_responding":
            beat, owner = read_heartbeat(self._folder, WEB_FILE), lock_text(self._folder, LOCK_FILE)
            if beat is not None and owner == f"process {beat.process}":
                remove_quietly(self._folder / LOCK_FILE)

    def _follow(self, line: ReceiverLine, lock: IO[bytes], over: threading.Event) -> None:
        """Body of a receiver's thread."""
        while not over.is_set() and self._holds(lock):
            try:
                pause_s = line.step()
                self.why_silent = ""
            except Exception as error:  # noqa: BLE001 - the next message may be delivered
                self._report_trouble(str(error))
                pause_s = TROUBLE_PAUSE_S
            over.wait(pause_s)

    def _report_trouble(self, told: str) -> None:
        if self.lines and told != self.why_silent:
            log.warning("no notifications now, tried again: %s", told)
            self.why_silent = told


@lru_cache(maxsize=8)
def _warn_once(told: str) -> None:
    log.warning("%s", told)


@contextmanager
def standing_by(settings: Settings, folder: Path, *, watches: bool) -> Iterator[None]:
    """Send notifications meanwhile whenever no web service of this test responds.

    Parameters
    ----------
    watches
        Look after the recorder as well.
    """
    access = CatalogueAccess(folder)
    notifications = Notifications(settings, folder, access.get, watches=watches, stands_by=True)
    notifications.start()
    try:
        yield
    finally:
        notifications.close()
        notifications.join()
        access.close()
