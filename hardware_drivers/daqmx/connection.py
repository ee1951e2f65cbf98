"""Connection to the driver by either transport: systems, tasks and watchdogs.

Nothing else creates a vendor object, so nothing else can leave one behind.
"""

from __future__ import annotations

import logging
import os
import re
import socket
import uuid
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from importlib.metadata import version
from typing import TYPE_CHECKING, TypeVar

from hardware_drivers.daqmx.parameters import DaqmxParameters
from hardware_drivers.daqmx.translation import read_metadata, translate_errors
from hardware_drivers.errors import ConfigurationError, ConnectionLostError

if TYPE_CHECKING:
    from nidaqmx import Task
    from nidaqmx.grpc_session_options import GrpcSessionOptions
    from nidaqmx.system import System
    from nidaqmx.system.watchdog import WatchdogTask

    from hardware_drivers.daqmx.remote import Channel

log = logging.getLogger(__name__)

T = TypeVar("T")

NAMES = 2
"""Names a role takes in turn on a server: one that cannot be cleared does not stand in the way."""

NAME_TAKEN = -200089


def build_client_name(parameters: DaqmxParameters) -> str:
    """Return the name that marks this rig's tasks on a server: as configured, else made from the host name.

    That has at most 40 characters; those not allowed in a name are replaced by ``_``.
    """
    return parameters.grpc_client_name or re.sub(r"[^A-Za-z0-9_.-]", "_", socket.gethostname())[:40]


class Connection:
    """Connection to NI's driver, opened again by the last recovery step.

    Parameters
    ----------
    parameters
        Transport, address and deadlines.

    Raises
    ------
    ConfigurationError
        No driver on this computer, or the gRPC extra is not installed.
    """

    def __init__(self, parameters: DaqmxParameters) -> None:
        """Create the gRPC channel, or nothing for the local library; the driver is not called here."""
        self._parameters = parameters
        self._channel: Channel | None = None
        # In the library a name is seen by this process only; on a server a later process must know it.
        remote = parameters.transport == "grpc"
        self._client = build_client_name(parameters) if remote else f"process-{os.getpid()}"
        self._created: Counter[str] = Counter()
        if remote:
            self._channel = _open_grpc_channel(parameters)

    def close(self) -> None:
        """Close the connection; tasks must be cleared before. Repeated calls have no effect."""
        channel, self._channel = self._channel, None
        if channel is not None:
            channel.close()

    def system(self) -> System:
        """Return NI's object of all boards (`nidaqmx.system.System`), of this computer or of the server.

        InstrumentError if the driver is missing or cannot be reached.
        """
        from nidaqmx.system import System

        with translate_errors("reaching NI-DAQmx"):
            if self._channel is None:
                return System()
            return System.remote(_build_options(self._channel, "", attach=False))

    def driver_version(self) -> str:
        """Return the version of NI-DAQmx, as in ``24.8.0``; ``unknown``, with a warning, if there is none.

        InstrumentError if the driver or its server cannot be reached.
        """
        system = self.system()
        return read_metadata(
            lambda: ".".join(str(part) for part in system.driver_version), "unknown", "the driver's version"
        )

    def create_task(self, role: str) -> Task:
        """Create an empty task (`nidaqmx.Task`) with a name from this client, the role and a number.

        Raise InstrumentError if it cannot be created; nothing is left then.
        """
        from nidaqmx import Task

        return self._create_named_task(
            role, lambda name: self._create_task(Task, f"creating the task {name}", name)
        )

    def create_watchdog(self, device: str, role: str, timeout_s: float) -> WatchdogTask:
        """Create the watchdog task (`nidaqmx.system.watchdog.WatchdogTask`) of a board, not started.

        Once started, it expires ``timeout_s`` after its last reset. Raise InstrumentError if it cannot be
        created.
        """
        from nidaqmx.system.watchdog import WatchdogTask

        doing = f"creating the watchdog of {device}"
        return self._create_named_task(
            role, lambda name: self._create_task(WatchdogTask, doing, device, name, timeout_s, session=name)
        )

    def _create_named_task(self, role: str, create: Callable[[str], T]) -> T:
        """Create a task by ``create`` under this client's next name for the role, and return it.

        If that name is taken, log a warning and use a random one. Any other error of ``create`` passes
        through.
        """
        self._created[role] += 1
        number = self._created[role] if self._channel is None else self._created[role] % NAMES
        try:
            return create(self._build_task_name(role, number))
        except ConnectionLostError as error:
            if not _is_name_taken(error):
                raise
            log.warning("a task under its usual name cannot be reached; using another name")
            return create(self._build_task_name(role, uuid.uuid4().hex[:8]))

    def is_own_task(self, owner: str) -> bool:
        """Return whether a text of the driver about a resource's owner names a task of this client."""
        return f"solimon-{self._client}-" in owner

    def _build_task_name(self, role: str, mark: int | str) -> str:
        """Build the name of a task of this client, ``solimon-CLIENT-ROLE-MARK`` (mark: number or text)."""
        return f"solimon-{self._client}-{role}-{mark}"

    def clear_leftover_tasks(self, roles: Sequence[str]) -> bool:
        """Clear the tasks of these roles that a killed process of this client left on a gRPC server.

        Each name is attached to, or created, and then cleared; no other client's name is touched. Without a
        server nothing is done, since the driver ends a process's tasks with it. Instrument errors pass
        through.

        Returns
        -------
        bool
            True if none is left under these names; False where that cannot be known.
        """
        if self._channel is None:
            return False
        from nidaqmx import Task

        reached = True
        for name in (self._build_task_name(role, number) for role in roles for number in range(NAMES)):
            doing = f"clearing what an earlier run may have left as {name}"
            try:
                task = self._create_task(Task, doing, name, attach=True)
                with translate_errors(doing):
                    task.close()
            except ConnectionLostError as error:
                if not _is_name_taken(error):
                    raise
                # The server has forgotten the session but not its task: no one can reach it.
                log.warning("%s: it cannot be reached", doing)
                reached = False
        return reached

    def _create_task(
        self, kind: type[T], doing: str, *arguments: object, session: str = "", attach: bool = False
    ) -> T:
        """Create an object of one of NI's task classes and return it; after an error it is cleared.

        Raise InstrumentError if that fails; the message begins with ``doing``.

        Parameters
        ----------
        session
            Name of a watchdog's session; empty: a task, named by the first argument.
        attach
            Use the server's task of this name if there is one.
        """
        # NI's constructors create first and ask for the task's name then; if that fails, the object is
        # lost and its task stays. So the object is kept apart from its construction.
        task = kind.__new__(kind)
        name = session or str(arguments[0])
        options = None if self._channel is None else _build_options(self._channel, name, attach=attach)
        with translate_errors(doing):
            try:
                kind.__init__(task, *arguments, grpc_options=options)  # type: ignore[call-arg]
            except BaseException:
                (clear_watchdog if session else clear_task)(task, doing)
                raise
        return task


def _build_options(channel: Channel, name: str, *, attach: bool) -> GrpcSessionOptions:
    """Build the gRPC options for a new session on a server; ``attach`` takes an existing one if there is."""
    from nidaqmx.grpc_session_options import GrpcSessionOptions, SessionInitializationBehavior

    behaviour = SessionInitializationBehavior
    return GrpcSessionOptions(
        channel.calls,
        name,
        initialization_behavior=behaviour.AUTO if attach else behaviour.INITIALIZE_SERVER_SESSION,
    )


def clear_task(task: Task | WatchdogTask, doing: str) -> bool:
    """Abort and clear a task in any state; return True if it was cleared, False with a debug log entry.

    Aborting first releases the hardware even if clearing then fails. Nothing is raised; ``doing`` is the
    operation in the log entry.
    """
    from nidaqmx.constants import TaskMode

    _run_cleanup_step(lambda: task.control(TaskMode.TASK_ABORT), doing)
    return _run_cleanup_step(task.close, doing)


def clear_watchdog(watchdog: WatchdogTask, doing: str) -> bool:
    """Abort and clear a watchdog in any state, with a second attempt; return True if it was cleared.

    NI's package allows that second attempt, unlike for a task. Nothing is raised.
    """
    return clear_task(watchdog, doing) or _run_cleanup_step(watchdog.close, doing)


def _run_cleanup_step(step: Callable[[], None], doing: str) -> bool:
    """Run one step of a clean-up; return True if it succeeds, False with a debug log entry if it raises.

    The entry names the operation ``doing``. NI's warnings are suppressed meanwhile, in the whole process.
    """
    with warnings.catch_warnings():
        # A task that was never created needs no clearing; NI warns of that.
        warnings.simplefilter("ignore")
        try:
            step()
        except Exception as error:  # noqa: BLE001 # a half-built object fails once its task is cleared
            # As text: a log record that is kept must not keep the vendor's objects alive.
            log.debug("discarding a task after %s: %s", doing, str(error))
            return False
    return True


def _is_name_taken(error: ConnectionLostError) -> bool:
    """Return whether an error was caused by NI's status -200089: a task of this name exists already."""
    return getattr(error.__cause__, "error_code", 0) == NAME_TAKEN


def read_package_versions() -> dict[str, str]:
    """Return the version of NI's Python package by its name in stored settings, ``nidaqmx_version``."""
    return {"nidaqmx_version": version("nidaqmx")}


def _open_grpc_channel(parameters: DaqmxParameters) -> Channel:
    """Open the channel to the gRPC server, which connects at the first call.

    Raise ConfigurationError if the extra `grpc` is not installed, or a TLS file is wrong.
    """
    try:
        import nidaqmx._grpc_interpreter  # noqa: F401 # the parts of the extra that NI's client needs

        from hardware_drivers.daqmx.remote import Channel
    except ImportError as error:
        raise ConfigurationError(
            f"transport is 'grpc' but {error.name or error} is not installed; install the extra: "
            'pip install "solimon[grpc]"'
        ) from error
    return Channel(
        parameters.grpc_address,
        call_timeout_s=parameters.call_timeout_s,
        record_samples=parameters.record_samples,
        tls=parameters.grpc_tls,
    )
