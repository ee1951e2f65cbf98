"""Run the processes of a test for ``run``, ``record`` and ``serve``, together or alone."""

from __future__ import annotations

import gc
import logging
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import asdict
from functools import partial, wraps
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from daq_service.catalogue import check_owner
from daq_service.cli.terminal import ProgressReport
from daq_service.errors import (
    EXIT_INTERRUPTED,
    EXIT_OK,
    SolimonError,
    StorageUnavailableError,
    TriedAgainError,
    UsageError,
)
from daq_service.processes.child import (
    PROGRAM,
    log_in_thread,
    log_to_file,
    notify_supervisor,
    run_and_announce_exit,
    start_detached_process,
    stop_on_signals,
    stop_when_pipe_closes,
)
from daq_service.processes.data_folder import (
    hold_recorder_lock,
    load_settings_and_folder,
    load_settings_for_reading,
    prepare_data_folder,
    remove_temporary_files,
    require_data_folder,
)
from daq_service.processes.disk_policy import disk_space, refusal
from daq_service.processes.heartbeat import Heartbeat, create_web_beat
from daq_service.processes.notifications.service import notify_while_web_is_silent
from daq_service.processes.printing import print_line
from daq_service.processes.service_manager import forward_to_service_manager, notify_manager
from daq_service.processes.supervisor import ChildPlan, Message, Supervisor
from daq_service.rig.twin import require_twin
from daq_service.settings.tree import Settings, StorageSettings
from daq_service.settings.web import WebSettings
from daq_service.web.port import bind_socket

if TYPE_CHECKING:
    from fastapi import FastAPI

    from daq_service.corrosion_drive.remote import RemoteDrive
    from hardware_drivers.drive_parameters import DriveParameters
    from hardware_drivers.instruments import Clock, PowerSupply, Rig

log = logging.getLogger(__name__)

SWEPT_BY_PYTHON = "ignore:resource_tracker:UserWarning"
"""Warning about locks of a killed recorder's worker, which Python removes itself."""
STOPPED = "the recorder is stopped and strikes no transducer; start it with the same folder to continue"


def run_as_child(carry_out: Callable[..., int]) -> Callable[..., int]:
    """Wrap a command as a child process, which sends its exit code to the supervisor.

    Raises
    ------
    TriedAgainError
        The wrapped command could not write to the disk, and the child was restarted: its supervisor tries
        again. A process that a person started ends with `StorageUnavailableError` instead.
    """

    @wraps(carry_out)
    def run_child(*, restart_reason: str, supervised: bool, **options: object) -> int:
        """Run the command, announce its exit code to the supervisor, and return it.

        Raises as `run_as_child`.
        """

        def run() -> int:
            """Run the command; after a restart raise TriedAgainError for StorageUnavailableError."""
            try:
                return carry_out(restart_reason=restart_reason, supervised=supervised, **options)
            except StorageUnavailableError as error:
                if not restart_reason:
                    raise
                raise TriedAgainError(str(error)) from error

        return run_and_announce_exit(run, supervised=supervised)

    return run_child


def run_supervised(*, config: Path | None, data_dir: Path | None, port: int | None, no_web: bool) -> int:
    """Run `solimon run`: record and serve in child processes under a supervisor; return the exit code.

    Blocks until a signal stops it or, without web service, the schedule ends. 130 after a signal.

    Raises
    ------
    UsageError
        The configuration, a receiver, or the protection of the web service is invalid.
    BusyError
        The port is in use.
    StorageError
        The folder cannot be used, or belongs to another test.
    """
    settings, folder = load_settings_and_folder(config, data_dir)
    require_twin(settings)
    if not no_web:
        bind_socket(settings.web.host, settings.web.port if port is None else port, locked=True).close()
    prepare_data_folder(folder)
    check_owner(settings, folder)
    if not no_web and settings.web.is_reachable:
        from daq_service.web.auth.middleware import refuse_unprotected_service

        refuse_unprotected_service(settings.web, folder)
    if not no_web and settings.notifications.receivers:
        from daq_service.processes.notifications.addresses import validate_receivers

        validate_receivers(settings.notifications)

    log_to_file(folder / "logs" / "supervisor.log")
    with stop_on_signals() as stop, ProgressReport() as progress, ExitStack() as stack:

        def on_message(child: str, message: Message) -> None:
            """Pass a message of a child process to the progress report; print address, stop and end."""
            progress.report_message(child, message)
            if message["event"] == "listening":
                progress.line(f"dashboard: {message['url']}")
            elif message["event"] == "stopped":
                progress.line(STOPPED)
            elif message["event"] == "failed":
                progress.line(
                    f"{child}: ended with exit code {message['code']} (see logs); the dashboard stays"
                )
            elif message["event"] == "finished":
                stays = "Ctrl-C stops the dashboard" if not no_web else "all ends here"
                progress.line(f"{child}: the schedule is done; {stays}")

        progress.line(f"data: {folder}")
        report_full_disk(folder, settings.storage, progress.line)
        supervisor = Supervisor(
            plan_children(config, folder, port=port, web=not no_web, linger=not no_web),
            folder,
            on_message=on_message,
            guard=stack.enter_context(provide_supply_guard(settings, folder)),
        )
        with notify_while_web_is_silent(settings, folder, monitors_recorder=True):
            code = supervisor.run(stop, stay=not no_web)
        return EXIT_INTERRUPTED if stop.is_set() and code == EXIT_OK else code


def report_full_disk(folder: Path, storage: StorageSettings, report: Callable[[str], None]) -> None:
    """Report the reason if the disk is too full to record, which no alarm can show yet; else nothing.

    Raises OSError if the volume cannot be measured.
    """
    if reason := refusal(disk_space(folder, storage), storage):
        report(f"WAITING: {reason}")


def plan_children(
    config: Path | None,
    folder: Path,
    *,
    port: int | None,
    web: bool,
    linger: bool,
    environment: Mapping[str, str] = MappingProxyType({}),
) -> list[ChildPlan]:
    """Build the command lines of the recorder and, if ``web``, of the web service.

    A lingering recorder takes commands after its last set. ``port`` None: that of the configuration.

    Parameters
    ----------
    environment
        Added to the recorder's: where the vendor's libraries are found.
    """
    common = [*([] if config is None else [str(config)]), "--data-dir", str(folder), "--supervised"]
    common += ["--restart-reason", "{cause}"]
    recorder = ["record", *common, *(["--linger"] if linger else [])]
    quiet = {"PYTHONWARNINGS": ",".join(filter(None, (os.environ.get("PYTHONWARNINGS"), SWEPT_BY_PYTHON)))}
    plans = [
        ChildPlan(name="recorder", arguments=recorder, watched=True, environment={**quiet, **environment})
    ]
    if web:
        at = [] if port is None else ["--port", str(port)]
        plans.append(ChildPlan(name="web", arguments=["serve", *common, *at]))
    return plans


@run_as_child
def record_alone(
    *,
    config: Path | None,
    data_dir: Path | None,
    restart_reason: str,
    linger: bool,
    log_json: bool,
    supervised: bool,
) -> int:
    """Run `solimon record`: record until the schedule ends (0) or a person stops it (130).

    With ``linger`` it takes commands after the last set; with ``log_json`` it notifies the supervisor of each
    stored shot. Holds the folder's lock and removes temporary files. Errors are logged to
    ``logs/recorder.log``.

    Raises
    ------
    BusyError
        Another recorder owns the folder.
    SolimonError
        The configuration, the rig or the folder cannot be used.
    """
    from daq_service.recording.resources import SessionOptions
    from daq_service.recording.session import record_test

    settings, folder = load_settings_and_folder(config, data_dir)
    require_twin(settings)
    prepare_data_folder(folder, may_create=not restart_reason)
    with stop_on_signals() as stop, hold_recorder_lock(folder), ExitStack() as stack:
        log_to_file(folder / "logs" / "recorder.log")
        remove_temporary_files(folder)
        report = notify_supervisor
        if not supervised:
            report = stack.enter_context(forward_to_service_manager(stack.enter_context(ProgressReport())))
            stack.enter_context(notify_while_web_is_silent(settings, folder, monitors_recorder=False))
        abandoned = stop_when_pipe_closes(stop) if supervised else threading.Event()
        try:
            drive = None
            if settings.rig.driven is not None:
                drive = stack.enter_context(create_supply_client(settings, settings.rig.driven, folder))
            finished = record_test(
                settings,
                folder,
                partial(_open_rig_without_supply, report, folder),
                stop=stop,
                report=report,
                options=SessionOptions(
                    restart_reason=restart_reason,
                    linger=linger,
                    unsupervised=abandoned,
                    acknowledged=_notify_shot_stored if log_json else lambda shot_id: None,
                    remote_drive=drive,
                ),
            )
        except SolimonError as error:
            log.error("%s", error)
            raise
        except BaseException:  # a driver may also raise SystemExit
            log.exception("the recorder failed")
            raise
        return EXIT_OK if finished else EXIT_INTERRUPTED


@contextmanager
def _open_rig_without_supply(
    report: Callable[..., None], folder: Path, settings: Settings, clock: Clock, epoch_utc_ns: int
) -> Iterator[Rig]:
    """Open the rig without the supply, whose port belongs to the supply process; close it at the end.

    Existing objects are excluded from garbage collection (`gc.freeze`), since they stay until the process
    ends. Raises InstrumentError if an instrument cannot be opened.
    """
    from daq_service.recording.session import compute_longest_call_s
    from daq_service.rig.open_rig import open_rig

    deadline_s = compute_longest_call_s(settings) + settings.rig.stall_timeout_s
    heartbeat = Heartbeat(folder, deadline_s=deadline_s, notify=report)
    heartbeat.stage = "opening"

    def report_preparation(what: str, begins: bool) -> None:
        """Report progress or end of a preparation, such as compiling, to the reporter and the heartbeat."""
        report("preparing" if begins else "prepared", what=what)
        heartbeat.beat(what if begins else "opening the rig", at_once=True)

    without_supply = settings.model_copy(update={"rig": settings.rig.copy_without_supply()})
    with open_rig(without_supply, clock, epoch_utc_ns, preparing=report_preparation) as rig:
        gc.freeze()
        yield rig


def _notify_shot_stored(shot_id: int) -> None:
    """Notify the supervisor that the shot with this id is stored."""
    notify_supervisor("shot_acknowledged", shot_id=shot_id)


def start_supply_process(settings: Settings, folder: Path) -> subprocess.Popen[bytes]:
    """Start the supply process so that it outlives this one, and return it.

    The present settings are passed on its standard input. Raises OSError if it cannot be started.
    """
    command = [*PROGRAM, "supply-process", "--data-dir", str(folder), "--for-recorder"]
    return start_detached_process(command, settings.model_dump_json().encode())


def read_supply_port(settings: Settings) -> str:
    """Return the name of the supply's port, or all its parameters as text if its kind has no port.

    Raises ValueError unless exactly one instrument serves as supply.
    """
    from daq_service.settings.instruments import list_instruments

    (supply,) = (item.parameters for item in list_instruments(settings) if "supply" in item.serves)
    return str(getattr(getattr(supply, "line", supply), "port", supply))


def create_supply_client(
    settings: Settings, parameters: DriveParameters, folder: Path, *, watches: bool = True
) -> RemoteDrive:
    """Create the client of the supply process of this configuration, which it can start.

    With ``watches=False`` it only checks whether the process is alive, and the process regards the recorder
    as absent. Close it as a context manager; the process keeps running. Raises ValueError as
    `read_supply_port`.
    """
    from daq_service.corrosion_drive.remote import RemoteDrive

    start = partial(start_supply_process, settings, folder)
    return RemoteDrive(parameters, folder, start, supply_port=read_supply_port(settings), watches=watches)


@contextmanager
def provide_supply_guard(settings: Settings, folder: Path) -> Iterator[Callable[[], None]]:
    """Provide a function that restarts the supply process while no recorder runs; call it repeatedly.

    It does nothing without a driven supply.
    """
    from daq_service.corrosion_drive.guard import DriveGuard

    if settings.rig.driven is None:
        yield lambda: None
        return
    with create_supply_client(settings, settings.rig.driven, folder, watches=False) as remote:
        yield DriveGuard(folder, remote, check_every_s=settings.rig.driven.watchdog_timeout_s).check


def run_supply_process_alone(*, config: Path | None, data_dir: Path | None, for_recorder: bool) -> int:
    """Run `solimon supply-process`: log, keep the interlock, switch off if no recorder watches.

    Blocks; returns 0 once the output is off without a recorder, 130 if stopped. A process of a recorder reads
    its settings from standard input.

    Raises
    ------
    UsageError
        The configuration has no supply.
    BusyError
        Another process owns the supply.
    RigError
        The supply may still be on after the end.
    StorageError
        The folder cannot be used.
    """
    from daq_service.clock import WallClock
    from daq_service.corrosion_drive.own_process import run_supply_process
    from daq_service.rig.open_rig import open_supply

    def announce_and_open_supply() -> AbstractContextManager[PowerSupply]:
        """Report that the process is ready and open the supply; the caller holds its lock."""
        if not for_recorder:
            notify_manager("READY=1")  # the lock is held: no recorder starts another process
        return open_supply(settings, clock=WallClock())

    def notify_watchdog() -> None:
        """Notify the watchdog of the service manager, unless a recorder started this process."""
        if not for_recorder:
            notify_manager("WATCHDOG=1")

    if for_recorder:
        assert data_dir is not None, "a recorder says which folder"
        settings, folder = Settings.model_validate_json(sys.stdin.buffer.read()), data_dir
    else:
        settings, folder = load_settings_and_folder(config, data_dir)
        prepare_data_folder(folder)
    parameters = settings.rig.driven
    if parameters is None:
        raise UsageError("this configuration has no supply; add the table [rig.supply]")
    with log_in_thread(folder / "logs" / "drive.log"), stop_on_signals() as stop:
        try:
            was_left = run_supply_process(
                parameters,
                folder,
                announce_and_open_supply,
                stop,
                supply_port=read_supply_port(settings),
                stays=not for_recorder,
                beat=notify_watchdog,
            )
        except SolimonError as error:
            log.error("%s", error)
            raise
        return EXIT_OK if was_left else EXIT_INTERRUPTED


def serve_alone(
    *, config: Path | None, data_dir: Path | None, port: int | None, restart_reason: str, supervised: bool
) -> int:
    """Serve one data folder until a person stops it, and return the exit code.

    Raises
    ------
    UsageError
        At a first start the folder is missing or holds other files, or a receiver has no address; or the
        address needs protection that is missing.
    BusyError
        The port is in use.
    StorageError
        The folder is missing after a restart, or cannot be written.
    """
    from daq_service.processes.notifications.addresses import validate_receivers
    from daq_service.web.app import create_app
    from daq_service.web.auth.middleware import refuse_unprotected_service

    settings, folder = load_settings_for_reading(config, data_dir)
    if not restart_reason:
        require_data_folder(folder)
        if config is not None:  # who opens a folder only to look needs no secrets
            validate_receivers(settings.notifications)
    refuse_unprotected_service(settings.web, folder)
    prepare_data_folder(folder, may_create=not restart_reason)
    log_to_file(folder / "logs" / "web.log")
    if restart_reason:
        log.warning("started again: the web service %s", restart_reason)

    return serve_app(create_app(settings, folder), settings.web, port, supervised=supervised)


def serve_app(app: FastAPI, web: WebSettings, port: int | None, *, supervised: bool = False) -> int:
    """Serve an application at its configured address until a person stops it.

    Returns 0 under a supervisor, otherwise 130. ``port`` None: that of the configuration. Raises BusyError if
    the port is in use, UsageError if it cannot be used.
    """
    from daq_service.web.server import reduce_garbage_collection, serve

    reduce_garbage_collection()

    def on_bound(url: str) -> None:
        """Report the address of the web service to the supervisor, or print it."""
        if supervised:
            notify_supervisor("listening", url=url, port=int(url.rstrip("/").rpartition(":")[2]))
        else:
            print_line(f"dashboard: {url}", err=False)

    def on_beat() -> None:
        """Report to the supervisor or the service manager that the web service responds."""
        if supervised:
            notify_supervisor("beat", **asdict(create_web_beat()))
        else:
            notify_manager("READY=1", "WATCHDOG=1")  # each time: a datagram may be lost

    at = web.port if port is None else port
    with stop_on_signals() as stop:
        if supervised:
            stop_when_pipe_closes(stop)
        serve(app, web.host, at, on_bound=on_bound, stop=stop, locks=web, on_beat=on_beat)
        return EXIT_OK if supervised else EXIT_INTERRUPTED
