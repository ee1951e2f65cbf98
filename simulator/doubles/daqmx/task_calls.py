"""Entry points for every kind of task."""

from __future__ import annotations

from collections.abc import Mapping

from simulator.doubles.daqmx import tasks
from simulator.doubles.daqmx.tasks import Answer, Arguments, Bench, Handler, Task, TaskHandler
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.statuses import Status


def _set_runtime_environment(bench: Bench, client: str, arguments: Arguments) -> None:
    """Accept `DAQmxSetRuntimeEnvironment` without effect: the caller's language does not matter."""


def _get_error_string(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """Answer `DAQmxGetErrorString` with the text of a status code; an unknown code has a text, too."""
    code = arguments["error_code"]
    return {"error_string": statuses.TEXTS.get(code, f"Status {code} is not one of the double's own.")}


def _create_task(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """Answer `DAQmxCreateTask` with the handle of a new task; an empty name is replaced by a generated one.

    Raise Status if the client has a task of that name.
    """
    return {"task": tasks.create_task(bench, client, arguments["session_name"]).handle}


def _clear_task(bench: Bench, client: str, arguments: Arguments) -> None:
    """Answer `DAQmxClearTask`: stop and remove a task; one that lost its board is removed without an error.

    Raise Status if the client has no such task.
    """
    task = bench.tasks.get(arguments["task"])
    if task is not None and task.client == client and task.lost:
        # Clearing is how a lost task is got rid of: it never fails for the loss.
        del bench.tasks[task.handle]
    else:
        tasks.clear_task(bench, tasks.find_task(bench, client, arguments["task"]))


def _get_last_created_channel(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """Answer with the name of the channel that the client created last; empty if there is none."""
    return {"value": bench.last_channel.get(client, "")}


def _control_task(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Answer `DAQmxTaskControl`: execute an action on a task; raise Status if it fails (`control_task`)."""
    tasks.control_task(bench, task, arguments["action"])


def _start_task(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Answer `DAQmxStartTask`; raise Status if the task runs, or to verify or reserve it fails."""
    tasks.start_task(bench, task)


def _stop_task(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Answer `DAQmxStopTask`; raise Status 200010, a warning, if the task was stopped before it was done."""
    tasks.stop_task(bench, task)


def _wait_until_done(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Answer `DAQmxWaitUntilTaskDone`: block until the task is done or stopped.

    Raise Status after the timeout in s (negative: no limit), or if the board is lost meanwhile.
    """
    timeout_s = arguments["time_to_wait"]
    late = Status(statuses.NOT_DONE_IN_TIME, f"Time to wait: {timeout_s} s", task=task.name)
    tasks.wait_until_done(bench, task, timeout_s, late)


HANDLERS: Mapping[str, Handler] = {
    "DAQmxSetRuntimeEnvironment": _set_runtime_environment,
    "DAQmxGetErrorString": _get_error_string,
    "DAQmxCreateTask": _create_task,
    "DAQmxClearTask": _clear_task,
    "DAQmxInternalGetLastCreatedChan": _get_last_created_channel,
}
TASK_HANDLERS: Mapping[str, TaskHandler] = {
    "DAQmxTaskControl": _control_task,
    "DAQmxStartTask": _start_task,
    "DAQmxStopTask": _stop_task,
    "DAQmxWaitUntilTaskDone": _wait_until_done,
}
