"""Open a recording session: catalogue, clock, rig; resume where the last one ended."""

from __future__ import annotations

import logging
import threading
import time
import uuid
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, closing, suppress
from dataclasses import asdict, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from daq_service.alarms.states import Moment
from daq_service.archive import Archive, FolderArchive, Results, SetRecord, SetReference
from daq_service.archive.waterfall.cells import extract_anchors
from daq_service.assessment.results_in_file import read_newest_results
from daq_service.assessment.wall_bank import list_bank_arguments
from daq_service.background.disk_watch import DiskWatch
from daq_service.background.finalize_sets import SetFinalizer
from daq_service.background.live_figure import LiveFigure
from daq_service.background.task import BackgroundTask
from daq_service.background.tiles import TileMaker, add_record_to_tiles
from daq_service.background.verification import IdleVerification
from daq_service.background.wall_curves import WallCurves
from daq_service.catalogue import RecorderCatalogue, open_catalogue
from daq_service.catalogue.errors import NoDataYetError
from daq_service.catalogue.experiment_file import ensure_experiment_file, write_experiment_file
from daq_service.catalogue.history import HistoryFollower
from daq_service.catalogue.owner import build_experiment_identity
from daq_service.catalogue.rows import SetRow
from daq_service.clock import WallClock, boot_name, elapsed_ns, parse_utc
from daq_service.errors import PASSING
from daq_service.processes.data_folder import read_identity
from daq_service.processes.heartbeat import Beat, Heartbeat, WebWatch, read_heartbeat
from daq_service.processes.lost_catalogue import is_catalogue_lost
from daq_service.processes.lost_sets import find_lost_sets
from daq_service.processes.recorder_state import FAREWELLS, PROCESS_EVENTS
from daq_service.recording.computer_load import ComputerLoadWatch
from daq_service.recording.opening import Opening, OpeningAlarm, open_rig_with_retries
from daq_service.recording.reassessment.rebuild import rebuild_folder_catalogue
from daq_service.recording.recorder import Recorder
from daq_service.recording.resources import (
    PLAIN,
    THIS_COMPUTER,
    Host,
    Reporter,
    Resources,
    SessionOptions,
    build_present_moment,
)
from daq_service.recording.resumed_time import compute_hour_0_ns, read_previous_time
from daq_service.settings.instruments import list_instruments
from daq_service.settings.tree import ClockSettings, Settings
from hardware_drivers.instruments import Clock, Rig
from hardware_drivers.measurement import SetKey
from hardware_drivers.methods import SOLITARY_WAVE
from hardware_drivers.nanoseconds import NS_PER_H
from simulator.clock import SimulatedClock

log = logging.getLogger(__name__)

NOTED_AT_ONCE = 100
"""Files that a start reads: more than a crash leaves, and done long before a heartbeat is missed."""

RigOpener = Callable[[Settings, Clock, int], AbstractContextManager[Rig]]


def record_test(
    settings: Settings,
    folder: Path,
    open_rig: RigOpener,
    *,
    stop: threading.Event,
    report: Reporter,
    options: SessionOptions = PLAIN,
    host: Host = THIS_COMPUTER,
) -> bool:
    """Create or resume a test, and record it to the end of its schedule; the caller holds the folder's lock.

    Returns
    -------
    bool
        True when every scheduled set has its row, False when ``stop`` came first.

    Raises
    ------
    StorageError, RigError
        What cannot be repaired here; every taken shot is stored.
    """
    started_ns, last_beat = time.monotonic_ns(), read_heartbeat(folder)
    deadline_s = compute_longest_call_s(settings) + settings.rig.stall_timeout_s
    rebuilt = _rebuild_if_lost(settings, folder, Heartbeat(folder, deadline_s=deadline_s, notify=report))
    with ExitStack() as stack:
        catalogue = stack.enter_context(open_catalogue(folder, writer=True, settings=settings))
        not_running_reason = _find_downtime_reason(catalogue, last_beat, options.restart_reason)
        epoch_ns = _create_or_read_epoch(catalogue, settings)
        _assign_copy_uuid(folder, catalogue, epoch_ns)
        ensure_experiment_file(folder, catalogue.read_experiment())
        if rebuilt:
            _store_rebuilt_event(catalogue, rebuilt, epoch_ns)
        history = HistoryFollower(folder, catalogue)
        history.begin()
        archive = stack.enter_context(closing(FolderArchive(folder)))
        _store_missing_digests(catalogue, archive, partial(_store_file_digest, catalogue, history))
        clock = _create_clock(settings.clock, catalogue, archive, last_beat, host)
        line = clock.line if isinstance(clock, WallClock) else lambda: None
        pace = clock.measure_late_pace_h_per_s if isinstance(clock, SimulatedClock) else lambda: None
        heartbeat = Heartbeat(folder, deadline_s=deadline_s, notify=report, time_line=line, pace=pace)
        moment = partial(build_present_moment, clock, epoch_ns)
        since_mono_ns = clock.mono_ns() - (time.monotonic_ns() - started_ns)
        rig, did = open_rig_with_retries(
            lambda: stack.enter_context(open_rig(settings, clock, epoch_ns)),
            resuming=bool(catalogue.rows(SetRow, limit=1)),
            restarted=bool(options.restart_reason),
            heartbeat=heartbeat,
            stop=stop,
            waits_s=host.waits_for_rig_s,
            alarm=OpeningAlarm(catalogue, history, moment, report),
        )
        if rig is None:
            _store_stop(catalogue, history, heartbeat, moment(), options.unsupervised)
            return False
        bare = Resources(
            settings=settings,
            archive=archive,
            catalogue=catalogue,
            rig=rig,
            heartbeat=heartbeat,
            live=LiveFigure(folder, rig.kind),
            stop=stop,
            report=report,
            options=options,
            host=host,
        )
        resources = _add_background_tasks(bare, folder, archive, history)
        for task in reversed(resources.tasks):
            stack.callback(task.close)
        recorder = Recorder(resources)
        stack.callback(recorder.commands.expire_open_commands)
        finished = recorder.run(
            not_running_reason=not_running_reason, opening=Opening(since_mono_ns=since_mono_ns, text=did)
        )
        if finished:
            report("finished")
            if options.linger:
                recorder.waiting.linger()
        return finished


def _create_clock(
    clock: ClockSettings, catalogue: RecorderCatalogue, archive: Archive, last_beat: Beat | None, host: Host
) -> Clock:
    """Create the clock of the test, which goes on where the last recorder ended.

    A simulated clock starts at the last record, a real one knows the last times.
    """
    if clock.kind != "wall":
        epoch_ns = catalogue.read_experiment().epoch_utc_ns
        start_ns = _find_resume_utc_ns(catalogue, archive, epoch_ns)
        return SimulatedClock(start_ns, pace_h_per_s=clock.pace_h_per_s)
    return host.wall_clock(
        read_previous_time(
            catalogue,
            last_beat,
            opened_utc_ns=[item.last_utc_ns for item in archive.open_sets().values()],
            boot=boot_name(),
            elapsed_ns=elapsed_ns(),
            doubt_after_h=clock.doubt_after_h,
        )
    )


def _add_background_tasks(
    bare: Resources, folder: Path, archive: FolderArchive, history: HistoryFollower
) -> Resources:
    """Return the resources with the tasks between sets added, such as set files, checks and tiles.

    Complete sets with rows that the last recorder left in the journal get their files first.
    """
    catalogue, note_file = bare.catalogue, partial(_store_file_digest, bare.catalogue, history)
    experiment = build_experiment_identity(catalogue.read_experiment())
    disk = DiskWatch(folder, bare.settings.storage, usage=bare.host.disk_usage)

    def has_room() -> bool:
        """Return whether the volume has space for tiles (level "ample" or "warn")."""
        return disk.space.level in ("ample", "warn")

    def build_tile_job(set_key: SetKey, results: Results) -> Callable[[SetRecord], str] | None:
        """Build the function that adds a set with these results to the tiles; None if space is short."""
        if not has_room():
            return None
        return partial(add_record_to_tiles, folder, experiment, extract_anchors(results))

    results, files = partial(read_newest_results, catalogue), partial(catalogue.list_files_except, ())
    finalizer = SetFinalizer(
        folder, archive, start=bare.host.worker, results=results, filed=note_file, also=build_tile_job
    )
    # One that has no rows yet gets them first: its file holds a copy of them.
    for set_key in sorted(catalogue.list_committed_sets(archive.list_sets_to_finalize())):
        finalizer.after_set(set_key)
    verification = IdleVerification(
        folder, finalizer, partial(find_lost_sets, folder, catalogue), catalogue.read_digest, note_file
    )
    return replace(
        bare,
        finalizer=finalizer,
        verification=verification,
        disk=disk,
        further_tasks=(
            history,
            TileMaker(folder, experiment, finalizer, files, results, has_room=has_room),
            bare.live,
            *_build_wall_curves(bare),
        ),
        computer_load=ComputerLoadWatch(
            bare.rig.clock, space=lambda: disk.space, files_read=lambda: verification.files_read
        ),
        web=WebWatch(folder),
    )


def _build_wall_curves(bare: Resources) -> list[BackgroundTask]:
    """Return the task that simulates missing wall curves; none for a rehearsal or in simulated time."""
    places = [bare.settings.positions[name] for name in bare.settings.list_positions(SOLITARY_WAVE)]
    if bare.rig.dry_run or bare.settings.clock.kind != "wall":
        return []
    return [WallCurves([list_bank_arguments(place) for place in places])]


def _store_rebuilt_event(catalogue: RecorderCatalogue, rebuilt: dict[str, Any], epoch_ns: int) -> None:
    """Store the event that the catalogue was lost and rebuilt, at the time of its newest event.

    Raises CatalogueError.
    """
    newest = catalogue.read_events_after(catalogue.last_event_id() - 1, limit=1)
    now_ns = newest[0].utc_ns if newest else epoch_ns
    catalogue.add_service_event(utc_ns=now_ns, kind="catalogue_rebuilt", payload=rebuilt)


def _store_file_digest(
    catalogue: RecorderCatalogue, history: HistoryFollower, set_key: SetKey, file: str, sha256: str
) -> None:
    """Store the SHA-256 of a set's file in the catalogue and add it to the next lines of the history.

    Raises CatalogueError.
    """
    catalogue.store_digest(set_key, file, sha256)
    history.add_digest(file, sha256)


def _rebuild_if_lost(settings: Settings, folder: Path, heartbeat: Heartbeat) -> dict[str, Any]:
    """Rebuild a lost catalogue before recording; return the event's payload, empty if none was lost.

    Logs warnings and writes the heartbeat; raises the errors of `rebuild_folder_catalogue`.
    """
    if not is_catalogue_lost(folder):
        return {}
    log.error("the catalogue of %s is lost and made again from sets, journal and history", folder)
    made = rebuild_folder_catalogue(
        folder,
        settings=settings,
        progress=lambda done, total: heartbeat.beat(f"making the catalogue again: {done} of {total} sets"),
    )
    for warning in made.warnings:
        log.warning("%s", warning)
    return asdict(made)


def _store_missing_digests(
    catalogue: RecorderCatalogue, archive: Archive, note_file: Callable[[SetKey, str, str], None]
) -> None:
    """Compute and store the SHA-256 of the newest 100 files that a crash left without one.

    ``note_file`` stores each. Those of an older folder follow when the recorder is idle.
    """
    for set_key, file in sorted(catalogue.list_sets_without_digest().items())[-NOTED_AT_ONCE:]:
        sha256 = archive.digest(SetReference(file))
        if sha256 is not None:
            note_file(set_key, file, sha256)


def compute_longest_call_s(settings: Settings) -> float:
    """Compute the longest time in s that a call of an instrument, or reading a record, may take."""
    rig = settings.rig
    longest_s = max(item.kind.longest_call_s(item.parameters) for item in list_instruments(settings))
    return max(rig.read_timeout_s, longest_s)


def _create_or_read_epoch(catalogue: RecorderCatalogue, settings: Settings) -> int:
    """Return hour 0 (ns of UTC) of this folder's test; create the test in a new folder.

    Raises UsageError if a test in real time would start with a clock that is not set. Another version of
    solimon is logged as a warning.
    """
    with suppress(NoDataYetError):
        row = catalogue.read_experiment()
        if row.solimon_version != version("solimon"):
            log.warning(
                "solimon %s continues a test that %s started", version("solimon"), row.solimon_version
            )
        return row.epoch_utc_ns
    simulated = settings.clock.kind == "simulated"
    row = catalogue.create_experiment(
        name=settings.name,
        configuration_hash=settings.configuration_hash(),
        configuration=settings.model_dump(mode="json"),
        epoch_utc_ns=parse_utc(settings.clock.epoch) if simulated else compute_hour_0_ns(time.time_ns()),
        clock=settings.clock.kind,
        solimon_version=version("solimon"),
        site=settings.site or None,
    )
    return row.epoch_utc_ns


def _assign_copy_uuid(folder: Path, catalogue: RecorderCatalogue, epoch_ns: int) -> None:
    """Assign a new UUID to a backup that continues the test, in catalogue and experiment.json.

    Stores an event with both and logs a warning. The original keeps its UUID; a folder that is no backup is
    left as it is. Raises CatalogueError.
    """
    row, original = catalogue.read_experiment(), read_identity(folder)
    if original is None or original.get("uuid") != row.uuid:
        return
    separated = replace(row, uuid=str(uuid.uuid4()))
    catalogue.restore_rows([separated])
    write_experiment_file(folder, separated)
    payload = {"uuid": separated.uuid, "original_uuid": row.uuid}
    utc_ns = catalogue.find_last_end_utc_ns() or epoch_ns
    catalogue.add_service_event(utc_ns=utc_ns, kind="copy_continued", payload=payload)
    log.warning("this folder is a backup: it continues as test %s", separated.uuid)


def _find_resume_utc_ns(catalogue: RecorderCatalogue, archive: Archive, epoch_ns: int) -> int:
    """Find the time (ns of UTC) of the last stored record, hour 0 if none, to resume a simulated clock."""
    opened = [item.last_utc_ns for item in archive.open_sets().values()]
    ended_ns = catalogue.find_last_end_utc_ns()
    return max([*opened, *([] if ended_ns is None else [ended_ns])], default=epoch_ns)


def _store_stop(
    catalogue: RecorderCatalogue,
    history: HistoryFollower,
    heartbeat: Heartbeat,
    moment: Moment,
    unsupervised: threading.Event,
) -> None:
    """Store the event that a recorder was stopped before its rig was open; log a failure of the disk.

    Writes the last heartbeat, and the history at once.
    """
    heartbeat.stage = "ended"
    heartbeat.beat("leaving", at_once=True)
    alone = unsupervised.is_set()
    kind = "recorder_left_alone" if alone else "recorder_stopped"
    try:
        catalogue.add_service_event(utc_ns=moment.utc_ns, kind=kind, payload={})
        history.follow(now=True)
    except PASSING as error:
        log.warning("the stop is not stored: %s", error)


def _find_downtime_reason(catalogue: RecorderCatalogue, beat: Beat | None, restart_reason: str) -> str:
    """Return why no recorder ran until now, from supervisor, catalogue or heartbeat, as one text.

    The supervisor's reason comes first; without any trace the recorder was starting.
    """
    if restart_reason:
        return f"the recorder {restart_reason}"
    last_event = catalogue.read_last_service_event(*PROCESS_EVENTS)
    if last_event is not None and last_event.kind in FAREWELLS and (beat is None or beat.stage == "ended"):
        return f"the recorder was {FAREWELLS[last_event.kind][1].partition(';')[0]}"
    if beat is not None:
        return f"the recorder was down; it was last seen {beat.doing}"
    if last_event is None:
        return "the recorder was starting"
    seen_ns = max(last_event.utc_ns, catalogue.find_last_end_utc_ns() or last_event.utc_ns)
    seen_h = (seen_ns - catalogue.read_experiment().epoch_utc_ns) / NS_PER_H
    return f"the recorder was down; it was last seen at hour {seen_h:.2f}"
