"""Entry points for every kind of task."""

from __future__ import annotations

from collections.abc import Mapping

from simulator.doubles.daqmx import tasks
from simulator.doubles.daqmx.tasks import Answer, Arguments, Bench, Handler, Task, TaskHandler
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.statuses import Status


def _set_runtime_environment(bench: Bench, client: str, arguments: Arguments) -> None:
    """Do nothing: the caller's language does not matter."""


def _error_string(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """Return the text of a status."""
    code = arguments["error_code"]
    return {"error_string": statuses.TEXTS.get(code, f"Status {code} is not one of the double's own.")}


def _create_task(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """Create a task for a client."""
    return {"task": tasks.create(bench, client, arguments["session_name"]).handle}


def _clear_task(bench: Bench, client: str, arguments: Arguments) -> None:
    """Clear a task; a lost one never fails."""
    task = bench.tasks.get(arguments["task"])
    if task is not None and task.client == client and task.lost:
        # Clearing is how a lost task is got rid of: it never fails for the loss.
        del bench.tasks[task.handle]
    else:
        tasks.clear(bench, tasks.find(bench, client, arguments["task"]))


def _last_created_channel(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """Return the name of the channel that the client created last."""
    return {"value": bench.last_channel.get(client, "")}


def _control(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Change the state of a task as requested."""
    tasks.control(bench, task, arguments["action"])


def _start(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Start a task."""
    tasks.start(bench, task)


def _stop(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Stop a task."""
    tasks.stop(bench, task)


def _wait_until_done(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Wait until a task is done, or raise the status of a timeout."""
    timeout_s = arguments["time_to_wait"]
    late = Status(statuses.NOT_DONE_IN_TIME, f"Time to wait: {timeout_s} s", task=task.name)
    tasks.wait(bench, task, timeout_s, late)


HANDLERS: Mapping[str, Handler] = {
    "DAQmxSetRuntimeEnvironment": _set_runtime_environment,
    "DAQmxGetErrorString": _error_string,
    "DAQmxCreateTask": _create_task,
    "DAQmxClearTask": _clear_task,
    "DAQmxInternalGetLastCreatedChan": _last_created_channel,
}
TASK_HANDLERS: Mapping[str, TaskHandler] = {
    "DAQmxTaskControl": _control,
    "DAQmxStartTask": _start,
    "DAQmxStopTask": _stop,
    "DAQmxWaitUntilTaskDone": _wait_until_done,
}
