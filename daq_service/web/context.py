"""Shared parts of the routes: settings, data folder, catalogue, hub, live figures, freshness."""

from __future__ import annotations

import math
from asyncio import Event, create_task, to_thread, wait_for
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from fastapi import Depends, FastAPI
from starlette.requests import HTTPConnection

from daq_service.alarms.evidence import build_alarm_columns
from daq_service.archive import FolderSetReader
from daq_service.archive.waterfall.image import WaterfallReader
from daq_service.catalogue.access import CatalogueAccess
from daq_service.catalogue.rows import AlarmRow, BaselineRow, Row, SetRow, as_dict
from daq_service.catalogue.store import Catalogue, NoDataYetError
from daq_service.commands.audit import Audit
from daq_service.errors import StorageError
from daq_service.processes import freshness
from daq_service.processes.data_folder import BACKUP_FILE
from daq_service.processes.heartbeat import WEB_BEATS_EVERY_S, WEB_DEADLINE_S, WEB_FILE, Heartbeat
from daq_service.processes.lost_catalogue import describe_loss
from daq_service.processes.notifications.service import Notifications
from daq_service.settings.tree import Settings
from daq_service.web.answers.json_answer import add_utc, format_rfc3339
from daq_service.web.answers.problem import Problem, create_catalogue_lost, create_no_data_error, not_found
from daq_service.web.auth.middleware import AccessPolicy
from daq_service.web.streams.hub import EventHub
from daq_service.web.streams.live_figures import LiveFigures

if TYPE_CHECKING:
    from daq_service.background.twin_waveforms import TwinWaveforms


class CatalogueEvents:
    """Events of the catalogue for the hub (`hub.EventSource`)."""

    def __init__(self, access: CatalogueAccess) -> None:
        self._access = access
        self._epoch_utc_ns: int | None = None

    def last_id(self) -> int | None:
        """Return the id of the newest event; None before the first record.

        Raises StorageError if the catalogue cannot be read.
        """
        try:
            return self._access.get().last_event_id()
        except NoDataYetError:
            return None

    def after(self, event_id: int, limit: int) -> Sequence[Mapping[str, Any]]:
        """Read at most ``limit`` events after an id, ascending, with RFC 3339 times.

        Empty before the first record. Raises StorageError if the catalogue cannot be read.
        """
        try:
            catalogue = self._access.get()
        except NoDataYetError:
            return []
        if self._epoch_utc_ns is None:
            self._epoch_utc_ns = catalogue.read_experiment().epoch_utc_ns
        rows = catalogue.read_events_after(event_id, limit=limit)
        epoch_utc_ns = self._epoch_utc_ns
        return [
            {**add_utc(as_dict(row), epoch_utc_ns), "payload": add_utc(row.payload, epoch_utc_ns)}
            for row in rows
        ]


class Context:
    """Shared parts of one test, injected by `ContextOf`.

    Parameters
    ----------
    access_policy
        Policy of a service with several tests; None: the test's own.
    no_person
        No token is required.
    open_streams
        Counts the open event streams of that service; None: only those of this test.
    """

    def __init__(
        self,
        settings: Settings,
        data_folder: Path,
        *,
        access_policy: AccessPolicy | None = None,
        no_person: bool = False,
        open_streams: Callable[[], int] | None = None,
    ) -> None:
        self.settings = settings
        self.data_folder = data_folder
        self.archive = FolderSetReader(data_folder)
        self.catalogue_access = CatalogueAccess(data_folder)
        self.events = CatalogueEvents(self.catalogue_access)
        self.hub = EventHub(self.events)
        self.live = LiveFigures(data_folder / "live", settings.positions)
        self.access_policy = access_policy or AccessPolicy(settings.web, data_folder, no_person=no_person)
        self.audit = self.access_policy.audit if access_policy is None else Audit(data_folder)
        self.waterfall = WaterfallReader(self.archive)
        self.notifications = Notifications(settings, data_folder, self.catalogue_access.get)
        self.open_streams = open_streams or (lambda: self.hub.clients)
        self.first_answers: tuple[float, Mapping[bytes, bytes]] = (-math.inf, {})
        """Monotonic time of reading, and the answers embedded in the page, by path."""
        self._has_data = False

    @cached_property
    def twin_waveforms(self) -> TwinWaveforms:
        """Return the simulated waveforms; the first call imports what they need."""
        from daq_service.background.twin_waveforms import TwinWaveforms

        return TwinWaveforms()

    @asynccontextmanager
    async def run_background_tasks(self) -> AsyncIterator[None]:
        """Follow events and live figures, notify and write heartbeats while the context is open.

        On exit open streams are ended, all tasks awaited and the catalogue closed.
        """
        await self.hub.start()
        await self.live.start()
        self.notifications.start()
        stopping = Event()
        heartbeat_task = create_task(self._send_heartbeats(stopping))
        try:
            yield
        finally:
            stopping.set()
            self.close_streams()
            await heartbeat_task
            await self.hub.join()
            await self.live.join()
            await to_thread(self.notifications.join)
            self.catalogue_access.close()

    async def _send_heartbeats(self, stopping: Event) -> None:
        """Write the heartbeat of the web service every second until ``stopping``, then mark its end.

        Writes nothing in a backup.
        """
        if await to_thread((self.data_folder / BACKUP_FILE).exists):
            return
        heartbeat = Heartbeat(self.data_folder, deadline_s=WEB_DEADLINE_S, file=WEB_FILE)
        while not stopping.is_set():
            await to_thread(heartbeat.beat, "serving")
            with suppress(TimeoutError):
                await wait_for(stopping.wait(), WEB_BEATS_EVERY_S)
        heartbeat.stage = "ended"
        await to_thread(heartbeat.beat, "leaving", at_once=True)

    def catalogue(self) -> Catalogue:
        """Return the open catalogue, which is opened at the first call.

        Raises a Problem (503) before the first set or if the catalogue is lost, and StorageError if it cannot
        be read.
        """
        try:
            catalogue = self.catalogue_access.get()
        except NoDataYetError:
            if reason := describe_loss(self.data_folder):
                raise create_catalogue_lost(reason) from None
            raise create_no_data_error() from None
        if not self._has_data:
            if not catalogue.rows(SetRow, limit=1):
                raise create_no_data_error()
            self._has_data = True
        return catalogue

    def has_data(self) -> bool:
        """Return whether the catalogue can be opened and has a set; errors of storage count as no."""
        try:
            self.catalogue()
        except (Problem, StorageError):
            return False
        return True

    def close_streams(self) -> None:
        """Request the end of event streams, live figures, waterfall reads and notifications, without waiting.

        Called before the server waits for its responses.
        """
        self.waterfall.close()
        self.hub.close()
        self.live.close()
        self.notifications.close()
        if "twin_waveforms" in vars(self):
            self.twin_waveforms.close()

    def validate_position(self, position: str) -> str:
        """Return the name of a position unchanged if the test has it, since it becomes part of file names.

        Raises
        ------
        Problem
            404: this test has no such position.
        """
        if position not in self.settings.positions:
            raise not_found(
                f"There is no position {position!r}.",
                f"The positions are {', '.join(self.settings.positions)}.",
            )
        return position

    def read_freshness(self) -> Freshness:
        """Read time of the test, age of the data and status of the recorder at this moment.

        Raises the errors of `catalogue`.
        """
        return Freshness(self)


class Freshness(freshness.Freshness):
    """Freshness for answers, with times as text."""

    def __init__(self, context: Context) -> None:
        self._catalogue = context.catalogue()
        super().__init__(context.data_folder, self._catalogue, context.settings.clock.kind)

    @cached_property
    def _baselines(self) -> dict[int, BaselineRow]:
        """Return all baselines by id, read once."""
        return self._catalogue.read_baselines_by_id()

    def as_of(self) -> dict[str, object]:
        """Return the object ``as_of`` of an answer: clock, present time, age of the data, recorder."""
        return {
            "clock": self.clock,
            "now_utc": format_rfc3339(self.now_utc_ns),
            "now_h": self.now_h,
            "last_write_wall_utc": format_rfc3339(self.written_ns),
            "wall_age_s": self.wall_age_s,
            "recorder": self.recorder.status,
            "pace_h_per_s": None if self.recorder.beat is None else self.recorder.beat.pace_h_per_s,
        }

    def row(self, row: Row, **extra_columns: object) -> dict[str, object]:
        """Convert a row of the catalogue for an answer: RFC 3339 times, and its age in h if it has an hour.

        ``extra_columns`` are added. An alarm also gets its texts (`build_alarm_columns`; StorageError if the
        baselines cannot be read), and an expired shelf is removed.
        """
        if isinstance(row, AlarmRow):
            row = self.expire_shelf(row)
            extra_columns |= build_alarm_columns(row, self._baselines)
        answer = add_utc({**as_dict(row), **extra_columns}, self.epoch_utc_ns)
        dated_h = answer.get("raised_h", answer.get("due_h"))
        return answer | {"age_h": self.age_h(dated_h)} if isinstance(dated_h, int | float) else answer


def find_app_context(app: FastAPI) -> Context:
    """Return the `Context` (settings, catalogue, streams) that was set for an application."""
    context = app.state.context
    assert isinstance(context, Context)
    return context


def find_request_context(connection: HTTPConnection) -> Context:
    """Return the context of the test that a request addresses, or else that of its application."""
    context = getattr(connection.state, "test", None)
    return context if isinstance(context, Context) else find_app_context(connection.app)


async def _provide_context(connection: HTTPConnection) -> Context:
    """Return `find_request_context` as dependency of routes; a coroutine needs no thread of the pool."""
    return find_request_context(connection)


ContextOf = Annotated[Context, Depends(_provide_context)]
