"""Open a recording session: catalogue, clock, rig; resume where the last one ended."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, ExitStack, closing, suppress
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from daq_service.alarms.states import Moment
from daq_service.archive import Archive, FolderArchive, Results, SetRecord, SetReference
from daq_service.archive.waterfall.cells import anchors_of
from daq_service.assessment.results_in_file import results_in
from daq_service.background.finalize_sets import SetFinalizer
from daq_service.background.live_figure import LiveFigure
from daq_service.background.tiles import TileMaker, add_record_to_tiles
from daq_service.background.verification import IdleVerification
from daq_service.background.write_retry_queue import PASSING
from daq_service.catalogue import RecorderCatalogue, open_catalogue
from daq_service.catalogue.errors import NoDataYetError
from daq_service.catalogue.experiment_file import keep_experiment
from daq_service.catalogue.history import HistoryFollower
from daq_service.catalogue.owner import experiment_identity
from daq_service.catalogue.rows import SetRow
from daq_service.clock import Before, SimulatedClock, WallClock, boot_name, elapsed_ns, parse_utc
from daq_service.commands.execution import LISTEN_EVERY_S
from daq_service.corrosion_drive.remote import RemoteDrive
from daq_service.processes.disk_policy import DiskWatch, Usage, disk_usage
from daq_service.processes.heartbeat import Beat, Heartbeat, WebWatch, read_heartbeat
from daq_service.processes.lost_catalogue import is_catalogue_lost
from daq_service.processes.lost_sets import lost_sets
from daq_service.processes.recorder_state import FAREWELLS, PROCESS_EVENTS
from daq_service.processes.worker import one_worker
from daq_service.recording.computer_load import ComputerLoadWatch
from daq_service.recording.opening import WAITS_FOR_RIG_S, Opening, OpeningAlarm, open_patiently
from daq_service.recording.persistence import Helpers
from daq_service.recording.reassessment.rebuild import rebuild
from daq_service.recording.recorder import Recorder, Reporter
from daq_service.recording.resumed_time import hour_0, time_before
from daq_service.settings.instruments import configured
from daq_service.settings.tree import Settings
from hardware_drivers.instruments import Clock, Rig
from hardware_drivers.nanoseconds import NS_PER_H

log = logging.getLogger(__name__)

NOTED_AT_ONCE = 100
"""Files that a start reads: more than a crash leaves, and done long before a heartbeat is missed."""

RigOpener = Callable[[Settings, Clock, int], AbstractContextManager[Rig]]


def record(
    settings: Settings,
    folder: Path,
    open_rig: RigOpener,
    *,
    stop: threading.Event,
    report: Reporter,
    restart_reason: str = "",
    linger: bool = False,
    unsupervised: threading.Event | None = None,
    acknowledged: Callable[[int], None] = lambda shot_id: None,
    compaction_worker: Callable[[], Executor] = one_worker,
    listen_every_s: float = LISTEN_EVERY_S,
    waits_for_rig_s: Sequence[float] = WAITS_FOR_RIG_S,
    wall_clock: Callable[[Before], Clock] = WallClock,
    remote_drive: RemoteDrive | None = None,
    disk_usage: Usage = disk_usage,
) -> bool:
    """Follow the schedule to its end; the caller owns the folder.

    Parameters
    ----------
    report
        Called with the name of an event and its values: ``beat``, ``begun`` (the first set is waited for or
        taken), ``progress``, ``alarm``, ``gap``, ``finished``,
        ``waits`` (for the rig, whose alarm stands).
    linger
        Stay after the last set and carry out orders (acknowledgements) until ``stop``.
    unsupervised
        Set where ``stop`` is, because the supervisor is gone.
    acknowledged
        Called with the id of each shot (``shots.sequence``) once it is durable.
    compaction_worker
        Makes the executor in which sets get their files.
    listen_every_s
        Shortest time between two looks for orders.
    waits_for_rig_s
        Wait before each further try to open the rig of a test that has begun; the last one repeats.
    wall_clock
        Makes the clock of a test in real time, of what is known of the time before.
    remote_drive
        The supply in a process of its own; None: the rig's supply, where it has one, is driven here.
    disk_usage
        Tells free and all bytes of the folder's volume.

    Returns
    -------
    bool
        True when every planned set has its row, False when ``stop`` came first.

    Raises
    ------
    StorageError, RigError
        What cannot be mended here; every taken shot is stored.
    """
    began_ns, last_beat = time.monotonic_ns(), read_heartbeat(folder)
    deadline_s = longest_call_s(settings) + settings.rig.stall_timeout_s
    rebuilt = _rebuilt_if_lost(settings, folder, Heartbeat(folder, deadline_s=deadline_s, notify=report))
    with ExitStack() as stack:
        catalogue = stack.enter_context(open_catalogue(folder, writer=True, settings=settings))
        cause = _why_not_running(catalogue, last_beat, restart_reason)
        epoch_ns = _experiment_epoch(catalogue, settings)
        keep_experiment(folder, catalogue.experiment_row())
        if rebuilt:
            newest = catalogue.events_after(catalogue.last_event_id() - 1, limit=1)
            now_ns = newest[0].utc_ns if newest else epoch_ns
            catalogue.add_event(utc_ns=now_ns, topic="service", kind="catalogue_rebuilt", payload=rebuilt)
        history = HistoryFollower(folder, catalogue)
        history.begin()
        archive = stack.enter_context(closing(FolderArchive(folder)))

        def note_file(set_index: int, file: str, sha256: str) -> None:
            catalogue.set_digest(set_index, file, sha256)
            history.note_digest(file, sha256)

        _note_digests(catalogue, archive, note_file)
        clock: Clock
        if settings.clock.kind == "wall":
            clock = wall_clock(
                time_before(
                    catalogue,
                    last_beat,
                    opened_utc_ns=[item.last_utc_ns for item in archive.open_sets().values()],
                    boot=boot_name(),
                    elapsed_ns=elapsed_ns(),
                    doubt_after_h=settings.clock.doubt_after_h,
                )
            )
        else:
            start_ns = _resume_utc_ns(catalogue, archive, epoch_ns)
            clock = SimulatedClock(start_ns, pace_h_per_s=settings.clock.pace_h_per_s)
        line = clock.line if isinstance(clock, WallClock) else lambda: None
        heartbeat = Heartbeat(folder, deadline_s=deadline_s, notify=report, time_line=line)

        def moment() -> Moment:
            now_ns = clock.utc_ns()
            return Moment(utc_ns=now_ns, due_h=(now_ns - epoch_ns) / NS_PER_H, set_index=None)

        since_mono_ns = clock.mono_ns() - (time.monotonic_ns() - began_ns)
        rig, did = open_patiently(
            lambda: stack.enter_context(open_rig(settings, clock, epoch_ns)),
            resuming=bool(catalogue.rows(SetRow, limit=1)),
            restarted=bool(restart_reason),
            heartbeat=heartbeat,
            stop=stop,
            waits_s=waits_for_rig_s,
            alarm=OpeningAlarm(catalogue, history, moment, report),
        )
        if rig is None:
            _store_stop(catalogue, history, heartbeat, moment(), unsupervised)
            return False
        disk = DiskWatch(folder, settings.storage, usage=disk_usage)
        stack.callback(disk.free_reserve)
        experiment = experiment_identity(catalogue.experiment_row())

        def has_room() -> bool:
            return disk.space.level in ("ample", "warn")

        def tiles(set_index: int, results: Results) -> Callable[[SetRecord], str] | None:
            return (
                partial(add_record_to_tiles, folder, experiment, anchors_of(results)) if has_room() else None
            )

        finalizer = SetFinalizer(
            folder,
            archive,
            start=compaction_worker,
            results=partial(results_in, catalogue),
            filed=note_file,
            also=tiles,
        )
        # One that has no rows yet gets them first: its file holds a copy of them.
        for set_index in sorted(catalogue.committed_sets(archive.to_compact())):
            finalizer.put(set_index)
        stack.callback(finalizer.close)
        checker = IdleVerification(
            folder, finalizer, partial(lost_sets, folder, catalogue), catalogue.digest_of, note_file
        )
        live = LiveFigure(folder, rig.kind)
        tile_maker = TileMaker(
            folder,
            experiment,
            finalizer,
            partial(catalogue.files_but_of, ()),
            partial(results_in, catalogue),
            has_room=has_room,
        )
        machine = ComputerLoadWatch(clock, space=lambda: disk.space, files_read=lambda: checker.files_read)
        recorder = Recorder(
            settings,
            archive,
            catalogue,
            rig,
            epoch_ns,
            live=live,
            heartbeat=heartbeat,
            stop=stop,
            report=report,
            unsupervised=unsupervised,
            helpers=Helpers(
                compaction=finalizer,
                idle_check=checker,
                tiling=tile_maker,
                history=history,
                disk=disk,
                machine=machine,
                web=WebWatch(folder),
                acknowledged=acknowledged,
            ),
            listen_every_s=listen_every_s,
            remote_drive=remote_drive,
        )
        stack.callback(recorder.leave)
        finished = recorder.run(
            not_running_reason=cause, opening=Opening(since_mono_ns=since_mono_ns, text=did)
        )
        if finished:
            report("finished")
            if linger:
                recorder.linger()
        return finished


def _rebuilt_if_lost(settings: Settings, folder: Path, heartbeat: Heartbeat) -> dict[str, Any]:
    """Rebuild a lost catalogue before recording; return the event's payload, empty: none was lost."""
    if not is_catalogue_lost(folder):
        return {}
    log.error("the catalogue of %s is lost and made again from sets, journal and history", folder)
    made = rebuild(
        folder,
        settings=settings,
        progress=lambda done, total: heartbeat.beat(f"making the catalogue again: set {done} of {total}"),
    )
    for warning in made.warnings:
        log.warning("%s", warning)
    return asdict(made)


def _note_digests(
    catalogue: RecorderCatalogue, archive: Archive, note_file: Callable[[int, str, str], None]
) -> None:
    """Note the SHA-256 of files that a crash kept from being noted; a whole older folder's come when idle."""
    for set_index, file in sorted(catalogue.without_digest().items())[-NOTED_AT_ONCE:]:
        sha256 = archive.digest(SetReference(file))
        if sha256 is not None:
            note_file(set_index, file, sha256)


def longest_call_s(settings: Settings) -> float:
    """Longest a bounded call of an instrument may take; what has no bound of its own is not counted."""
    rig = settings.rig
    longest_s = max(item.kind.longest_call_s(item.parameters) for item in configured(settings))
    return max(rig.read_timeout_s, longest_s)


def _experiment_epoch(catalogue: RecorderCatalogue, settings: Settings) -> int:
    """Hour 0 of this folder's experiment; a new folder is given to this configuration."""
    with suppress(NoDataYetError):
        row = catalogue.experiment_row()
        if row.solimon_version != version("solimon"):
            log.warning(
                "solimon %s goes on with a test that %s began", version("solimon"), row.solimon_version
            )
        return row.epoch_utc_ns
    simulated = settings.clock.kind == "simulated"
    row = catalogue.create_experiment(
        name=settings.name,
        configuration_hash=settings.configuration_hash(),
        configuration=settings.model_dump(mode="json"),
        epoch_utc_ns=parse_utc(settings.clock.epoch) if simulated else hour_0(time.time_ns()),
        clock=settings.clock.kind,
        solimon_version=version("solimon"),
    )
    return row.epoch_utc_ns


def _resume_utc_ns(catalogue: RecorderCatalogue, archive: Archive, epoch_ns: int) -> int:
    """Where a simulated clock goes on: at the end of the last committed set, or within an open one."""
    opened = [item.last_utc_ns for item in archive.open_sets().values()]
    ended_ns = catalogue.last_ended_utc_ns()
    return max([*opened, *([] if ended_ns is None else [ended_ns])], default=epoch_ns)


def _store_stop(
    catalogue: RecorderCatalogue,
    history: HistoryFollower,
    heartbeat: Heartbeat,
    moment: Moment,
    unsupervised: threading.Event | None,
) -> None:
    """Say that a recorder was stopped before its rig could be opened."""
    heartbeat.stage = "ended"
    heartbeat.beat("leaving", at_once=True)
    alone = unsupervised is not None and unsupervised.is_set()
    kind = "recorder_left_alone" if alone else "recorder_stopped"
    try:
        catalogue.add_event(utc_ns=moment.utc_ns, topic="service", kind=kind, payload={})
        history.follow(now=True)
    except PASSING as error:
        log.warning("the stop is not stored: %s", error)


def _why_not_running(catalogue: RecorderCatalogue, beat: Beat | None, restart_reason: str) -> str:
    """Return why no recorder ran until now, by the supervisor, the catalogue or the heartbeat."""
    if restart_reason:
        return f"the recorder {restart_reason}"
    last_event = catalogue.last_service_event(*PROCESS_EVENTS)
    if last_event is not None and last_event.kind in FAREWELLS and (beat is None or beat.stage == "ended"):
        return f"the recorder was {FAREWELLS[last_event.kind][1].partition(';')[0]}"
    if beat is not None:
        return f"the recorder was down; it was last seen {beat.doing}"
    if last_event is None:
        return "the recorder was starting"
    seen_ns = max(last_event.utc_ns, catalogue.last_ended_utc_ns() or last_event.utc_ns)
    seen_h = (seen_ns - catalogue.experiment_row().epoch_utc_ns) / NS_PER_H
    return f"the recorder was down; it was last seen at hour {seen_h:.2f}"
