"""The driver as the rest of this package sees it: systems, tasks and watchdogs, by either transport.

Nothing else creates a vendor object, so nothing else can leave one behind.
"""

from __future__ import annotations

import logging
import re
import socket
import warnings
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any, TypeVar

from hardware_drivers.daqmx.parameters import DaqmxParameters
from hardware_drivers.daqmx.translation import vendor_call
from hardware_drivers.errors import ConfigurationError, ConnectionLostError

log = logging.getLogger(__name__)

T = TypeVar("T")

NAMES = 4
"""Names a role goes through on a server: one that cannot be cleared does not stand in the way."""

NAME_TAKEN = -200089


def client_name(parameters: DaqmxParameters) -> str:
    """Name that marks this rig's tasks on a gRPC server."""
    return parameters.grpc_client_name or re.sub(r"[^A-Za-z0-9_.-]", "_", socket.gethostname())[:40]


class Connection:
    """Way to NI's driver, opened afresh by the last rung of the recovery ladder.

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
        self._parameters = parameters
        self._channel: Any = None
        self._client = client_name(parameters)
        self._created = 0
        if parameters.transport == "grpc":
            self._channel = _open_channel(parameters)

    def close(self) -> None:
        """End the connection; tasks must be cleared before."""
        channel, self._channel = self._channel, None
        if channel is not None:
            channel.close()

    def system(self) -> Any:
        """NI's view of all boards (`nidaqmx.system.System`)."""
        from nidaqmx.system import System

        with vendor_call("reaching NI-DAQmx"):
            return System() if self._channel is None else System.remote(self._options("", attach=False))

    def task(self, role: str) -> Any:
        """Create an empty task (`nidaqmx.Task`) named after this client and its role."""
        from nidaqmx import Task

        name = self._next_name(role)
        return self._create(Task, f"creating the task {name}", name, attach=False)

    def watchdog(self, device: str, role: str, timeout_s: float) -> Any:
        """Create the watchdog task of a board (`nidaqmx.system.watchdog.WatchdogTask`)."""
        from nidaqmx.system.watchdog import WatchdogTask

        name = self._next_name(role)
        doing = f"creating the watchdog of {device}"
        return self._create(WatchdogTask, doing, name, attach=False, device=device, timeout=timeout_s)

    def _next_name(self, role: str) -> str:
        """Name of a new task: who owns it and what it is for; on a server one of the few found again."""
        self._created += 1
        number = self._created if self._channel is None else self._created % NAMES
        return self._name(role, number)

    def _name(self, role: str, number: int) -> str:
        return f"solimon-{self._client}-{role}-{number}"

    def clear_leftovers(self, roles: Sequence[str]) -> bool:
        """Clear tasks that an earlier, killed process of this client left on a gRPC server.

        Each name is asked for in the server's own words "the one there is, or a new one", and what comes
        is cleared: so there is nothing to tell apart, and no other client's name is ever touched. In the
        library a process takes its tasks with it.

        Returns
        -------
        bool
            False where tasks cannot be found by name: in the library.
        """
        if self._channel is None:
            return False
        from nidaqmx import Task

        for name in (self._name(role, number) for role in roles for number in range(NAMES)):
            doing = f"clearing what an earlier run may have left as {name}"
            try:
                task = self._create(Task, doing, name, attach=True)
                with vendor_call(doing):
                    task.close()
            except ConnectionLostError as error:
                if getattr(error.__cause__, "error_code", 0) != NAME_TAKEN:
                    raise
                # The server has forgotten the session but not its task: we leave that name alone.
                log.warning("%s: it cannot be reached any more", doing)
        return True

    def _create(
        self,
        kind: type[T],
        doing: str,
        name: str,
        *,
        attach: bool,
        device: str | None = None,
        timeout: float = 0.0,
    ) -> T:
        # NI's constructors create first and ask for the task's name then; if that fails, the object is
        # lost and its task stays. So the object is kept apart from its construction.
        task = kind.__new__(kind)
        options = None if self._channel is None else self._options(name, attach=attach)
        arguments = (name,) if device is None else (device, name, timeout)
        with vendor_call(doing):
            try:
                kind.__init__(task, *arguments, grpc_options=options)  # type: ignore[call-arg]
            except BaseException:
                discard(task, doing)
                raise
        return task

    def _options(self, name: str, *, attach: bool) -> Any:
        from nidaqmx.grpc_session_options import GrpcSessionOptions, SessionInitializationBehavior

        behaviour = SessionInitializationBehavior
        return GrpcSessionOptions(
            self._channel.calls,
            name,
            initialization_behavior=behaviour.AUTO if attach else behaviour.INITIALIZE_SERVER_SESSION,
        )


def discard(task: Any, doing: str) -> bool:
    """Give everything back and clear a task, whatever state it is in; True if all of it went well.

    Each step is tried even if the one before failed, so one refusal leaves at most an empty task, which
    holds nothing. A failure is logged: the error that led here is the news.
    """
    from nidaqmx.constants import TaskMode

    calls = (lambda: task.control(TaskMode.TASK_ABORT), task.close)
    well = True
    with warnings.catch_warnings():
        # A task that was never created needs no clearing; NI warns of that.
        warnings.simplefilter("ignore")
        for call in calls:
            try:
                call()
            except Exception:  # a half-built object fails after its task is cleared
                log.debug("discarding a task after %s", doing, exc_info=True)
                well = False
    return well


def package_versions() -> dict[str, str]:
    """Versions of NI's Python package, for the record."""
    return {"nidaqmx_version": version("nidaqmx")}


def _open_channel(parameters: DaqmxParameters) -> Any:
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
    )
