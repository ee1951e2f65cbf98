"""Notification service of one test: a thread per receiver; a lock selects the process that sends.

The web service sends. The supervisor, or a recorder without one, is on standby: it sends while no web service
responds, and continues at the progress in the delivery log.
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
from daq_service.processes.data_folder import BACKUP_FILE, hold_lock, read_lock_owner
from daq_service.processes.heartbeat import WEB_FILE, read_heartbeat, read_web_state
from daq_service.processes.notifications.addresses import read_address
from daq_service.processes.notifications.by_apprise import deliver_by_apprise
from daq_service.processes.notifications.delivery_log import DeliveryLog
from daq_service.processes.notifications.messages import Message
from daq_service.processes.notifications.receiver import ReceiverQueue
from daq_service.processes.notifications.source import Source
from daq_service.processes.notifications.webhook import Cut, Outcome, post_message
from daq_service.processes.recorder_watch import RecorderWatch
from daq_service.settings.notifications import ReceiverSettings
from daq_service.settings.tree import Settings
from daq_service.shared_file import remove_quietly

log = logging.getLogger(__name__)

LOCK_FILE = "notifier.lock"
NO_RECEIVERS = "no receivers are configured"
TROUBLE_PAUSE_S = 5.0
"""Pause after the catalogue could not be read."""
LOOK_EVERY_S = 1.0
"""Interval of checks of the recorder and of the sending process."""
LONGEST_END_S = 0.5
"""Longest wait for aborted attempts at the end: their threads end with the process anyway."""


class Notifications:
    """Sends notifications to receivers, from `start` to `close`; without receivers it does nothing.

    Parameters
    ----------
    catalogue
        Opens the catalogue, or returns the open one; `NoDataYetError` before the first record.
    monitors_recorder
        The sending process also monitors the recorder, which is another process.
    is_standby
        Send only while no web service of this test responds.
    """

    def __init__(
        self,
        settings: Settings,
        folder: Path,
        catalogue: Callable[[], Catalogue],
        *,
        monitors_recorder: bool = True,
        is_standby: bool = False,
    ) -> None:
        self.settings, self._folder = settings.notifications, folder
        self._watch = None
        if monitors_recorder:
            self._watch = RecorderWatch(settings.schedule, settings.clock.kind, folder, catalogue)
        self._is_standby = is_standby
        self.deliveries = DeliveryLog(folder)
        self._source = Source(settings, folder, catalogue)
        self._cuts = [Cut()]
        self._stop = threading.Event()
        self._threads: list[threading.Thread] = []
        self.queues = self._create_queues()
        self.silent_reason = "the service has not started" if self.queues else NO_RECEIVERS

    def start(self) -> None:
        """Start the thread that sends whenever no other process of this test does; return at once.

        Nothing starts in a backup (`silent_reason` is set), or without receivers and monitoring.
        """
        if not (self._folder / BACKUP_FILE).exists():
            if self.queues or self._watch:
                self._start_thread(self._send_while_owner, "notifications")
        elif self.queues:
            self.silent_reason = "this is a backup; only the test's own folder sends"

    def close(self) -> None:
        """Request the end of sending without waiting.

        Running attempts are aborted and repeated after the next start.
        """
        self._stop.set()
        for cut in self._cuts:
            cut.close()

    def join(self) -> None:
        """Wait up to `LONGEST_END_S` (0.5 s) for each thread after `close`."""
        for thread in self._threads:
            thread.join(LONGEST_END_S)

    def _start_thread(self, target: Callable[[], None], name: str) -> threading.Thread:
        """Start a daemon thread, keep it for `join`, and return it."""
        thread = threading.Thread(target=target, name=name, daemon=True)
        self._threads.append(thread)
        thread.start()
        return thread

    def _create_queues(self) -> dict[str, ReceiverQueue]:
        """Create an idle queue for each receiver, with switches with which `close` aborts its deliveries."""
        parts, queues = (self.settings, self._source, self.deliveries), dict[str, ReceiverQueue]()
        for name, receiver in self.settings.receivers.items():
            send, send_test = (
                partial(self._send_message, name, receiver, self._create_abort_switch()) for _ in range(2)
            )
            queues[name] = ReceiverQueue(name, *parts, send, send_test)
        return queues

    def _create_abort_switch(self) -> Cut:
        """Create a switch with which `close` aborts a delivery."""
        self._cuts.append(Cut())
        return self._cuts[-1]

    def _send_message(self, name: str, receiver: ReceiverSettings, cut: Cut, message: Message) -> Outcome:
        """Try once to deliver a message by webhook or apprise; ``cut`` aborts a webhook.

        Raises UsageError if the address or secret of the receiver is missing or invalid.
        """
        address = read_address(name, receiver)
        if receiver.kind == "apprise":
            return deliver_by_apprise(address, message)
        return post_message(address, message, cut=cut)

    def _send_while_owner(self) -> None:
        """Send while this process holds the lock, until `close`; wait while another process sends.

        A standby waits also while the web service responds. Problems are logged and tried again after 1 s or
        5 s.
        """
        while not self._stop.is_set():
            if self._is_web_service_sending():
                self._stop.wait(LOOK_EVERY_S)
                continue
            text = f"process {os.getpid()}"
            try:
                with hold_lock(self._folder, LOCK_FILE, text, holder="process", patience_s=0.0) as lock:
                    self._send_until_released(lock)
            except BusyError:
                self._report_problem("another process of this test sends")
                self._remove_stalled_lock()
                self._stop.wait(LOOK_EVERY_S)
            except SolimonError as error:
                self._report_problem(str(error))
                self._stop.wait(TROUBLE_PAUSE_S)

    def _send_until_released(self, lock: IO[bytes]) -> None:
        """Run a thread for each receiver and monitor the recorder until `close`, or another process sends.

        Also ends if the lock file is removed. Errors of the monitoring are logged. Waits for the threads at
        the end.
        """
        self.silent_reason, released = "" if self.queues else NO_RECEIVERS, threading.Event()
        self.queues = self._create_queues()  # another process may have sent since: the log holds the progress
        senders = [
            self._start_thread(partial(self._run_queue, queue, lock, released), f"notify-{queue.name}")
            for queue in self.queues.values()
        ]
        while not self._stop.is_set() and self._is_lock_held(lock) and not self._is_web_service_sending():
            try:
                if self._watch is not None:
                    self._watch.check()
            except (SolimonError, OSError) as error:
                _warn_once(f"the recorder is not watched, tried again: {error}")
            self._stop.wait(LOOK_EVERY_S)
        released.set()
        for sender in senders:
            sender.join()

    def _is_web_service_sending(self) -> bool:
        """Return whether this process is on standby and a web service of this test responds."""
        return self._is_standby and read_web_state(self._folder) == "responding"

    def _is_lock_held(self, lock: IO[bytes]) -> bool:
        """Return whether the open lock file still has its name; it is removed to replace a suspended process.

        False, too, if the file cannot be examined.
        """
        try:
            return os.path.samestat(os.fstat(lock.fileno()), (self._folder / LOCK_FILE).stat())
        except OSError:
            return False

    def _remove_stalled_lock(self) -> None:
        """Delete the lock file of a suspended web service, which does not release it; only on standby.

        Windows keeps the name of an open file: there the end of the service is awaited.
        """
        if self._is_standby and read_web_state(self._folder) == "not_responding":
            beat, owner = read_heartbeat(self._folder, WEB_FILE), read_lock_owner(self._folder, LOCK_FILE)
            if beat is not None and owner == f"process {beat.process}":
                remove_quietly(self._folder / LOCK_FILE)

    def _run_queue(self, queue: ReceiverQueue, lock: IO[bytes], released: threading.Event) -> None:
        """Advance the queue of a receiver until its release or the loss of the lock (body of its thread).

        Every error is logged and tried again after 5 s.
        """
        while not released.is_set() and self._is_lock_held(lock):
            try:
                pause_s = queue.step()
                self.silent_reason = ""
            except Exception as error:  # noqa: BLE001 - the next message may be delivered
                self._report_problem(str(error))
                pause_s = TROUBLE_PAUSE_S
            released.wait(pause_s)

    def _report_problem(self, problem: str) -> None:
        """Log and store the reason why nothing is sent at present, once for each reason in a row."""
        if self.queues and problem != self.silent_reason:
            log.warning("no notifications now, tried again: %s", problem)
            self.silent_reason = problem


@lru_cache(maxsize=8)
def _warn_once(message: str) -> None:
    """Log a warning once for each of the latest 8 texts."""
    log.warning("%s", message)


@contextmanager
def notify_while_web_is_silent(
    settings: Settings, folder: Path, *, monitors_recorder: bool
) -> Iterator[None]:
    """Send notifications while no web service of this test responds, until the context ends.

    On exit running attempts are aborted and their threads awaited for 0.5 s each.

    Parameters
    ----------
    monitors_recorder
        Also monitor the recorder.
    """
    access = CatalogueAccess(folder)
    notifications = Notifications(
        settings, folder, access.get, monitors_recorder=monitors_recorder, is_standby=True
    )
    notifications.start()
    try:
        yield
    finally:
        notifications.close()
        notifications.join()
        access.close()
