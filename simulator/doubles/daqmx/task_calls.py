"""Entry points that every kind of task shares."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from simulator.doubles.daqmx import tasks
from simulator.doubles.daqmx.tasks import Answer, Arguments, Bench
from simulator.doubles.vendor_api.statuses import NOT_DONE_IN_TIME, TASK_NOT_SAVED, TEXTS, Status


def _set_runtime_environment(bench: Bench, client: str, arguments: Arguments) -> Answer:
    return {}


def _error_string(bench: Bench, client: str, arguments: Arguments) -> Answer:
    code = arguments["error_code"]
    return {"error_string": TEXTS.get(code, f"Status {code} is not one of the double's own.")}


def _create_task(bench: Bench, client: str, arguments: Arguments) -> Answer:
    return {"task": tasks.create(bench, client, arguments["session_name"]).handle}


def _load_task(bench: Bench, client: str, arguments: Arguments) -> Answer:
    raise Status(TASK_NOT_SAVED, task=arguments["session_name"])


def _clear_task(bench: Bench, client: str, arguments: Arguments) -> Answer:
    task = bench.tasks.get(arguments["task"])
    if task is not None and task.client == client and task.lost:
        # Clearing is how a lost task is got rid of: it never fails for the loss.
        del bench.tasks[task.handle]
        return {}
    tasks.clear(bench, tasks.find(bench, client, arguments["task"]))
    return {}


def _control_task(bench: Bench, client: str, arguments: Arguments) -> Answer:
    tasks.control(bench, tasks.find(bench, client, arguments["task"]), arguments["action"])
    return {}


def _start_task(bench: Bench, client: str, arguments: Arguments) -> Answer:
    tasks.start(bench, tasks.find(bench, client, arguments["task"]))
    return {}


def _stop_task(bench: Bench, client: str, arguments: Arguments) -> Answer:
    tasks.stop(bench, tasks.find(bench, client, arguments["task"]))
    return {}


def _is_task_done(bench: Bench, client: str, arguments: Arguments) -> Answer:
    task = tasks.find(bench, client, arguments["task"])
    return {"is_task_done": int(tasks.is_done(bench, task))}


def _wait_until_done(bench: Bench, client: str, arguments: Arguments) -> Answer:
    task = tasks.find(bench, client, arguments["task"])
    timeout_s = arguments["time_to_wait"]
    late = Status(NOT_DONE_IN_TIME, f"Time to wait: {timeout_s} s", task=task.name)
    tasks.wait(bench, task, timeout_s, late)
    return {}


def _last_created_channel(bench: Bench, client: str, arguments: Arguments) -> Answer:
    return {"value": bench.last_channel.get(client, "")}


HANDLERS: Mapping[str, Callable[[Bench, str, Arguments], Answer]] = MappingProxyType(
    {
        "DAQmxSetRuntimeEnvironment": _set_runtime_environment,
        "DAQmxGetErrorString": _error_string,
        "DAQmxCreateTask": _create_task,
        "DAQmxLoadTask": _load_task,
        "DAQmxClearTask": _clear_task,
        "DAQmxTaskControl": _control_task,
        "DAQmxStartTask": _start_task,
        "DAQmxStopTask": _stop_task,
        "DAQmxIsTaskDone": _is_task_done,
        "DAQmxWaitUntilTaskDone": _wait_until_done,
        "DAQmxInternalGetLastCreatedChan": _last_created_channel,
    }
)
