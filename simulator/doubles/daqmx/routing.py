"""Terminals, routes between them, and start triggers that travel along them."""

from __future__ import annotations

from collections.abc import Mapping

from simulator.doubles.chassis.boards import list_terminals
from simulator.doubles.daqmx import tasks
from simulator.doubles.daqmx.tasks import Arguments, Bench, Handler, Task, TaskHandler, TaskState
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.statuses import Status

DIGITAL_EDGE = 10150
RISING, FALLING = 10280, 10171
NO_TRIGGER = 10230
START_TRIGGER_SIGNAL = 12491
REFERENCE_TRIGGER_SIGNAL = 12490
BACKPLANE = "pxi_trig"
INTERNAL_OUTPUT = "internaloutput"


def short_name(terminal: str) -> str:
    """Normalize a terminal's name for comparison: lower case, without outer spaces and leading slashes."""
    return terminal.strip().lstrip("/").casefold()


def get_start_trigger(task: Task) -> str:
    """Return the normalized terminal whose edge starts the task; empty if it has no digital start trigger."""
    if task.settings.get("StartTrig.Type", NO_TRIGGER) != DIGITAL_EDGE:
        return ""
    return short_name(str(task.settings["DigEdge.StartTrig.Src"]))


def fire_edge(bench: Bench, terminal: str, at_ns: int, edge: int = RISING) -> None:
    """Start all running tasks that wait for this edge at a terminal, also across routes and the backplane.

    Parameters
    ----------
    at_ns
        Monotonic time of the edge, ns.
    edge
        `RISING` or `FALLING`.
    """
    reached = {short_name(terminal)}
    while True:
        onward = {destination for destination, source in bench.routes.items() if _is_reached(source, reached)}
        if onward <= reached:
            break
        reached |= onward
    for task in tuple(bench.tasks.values()):
        waiting = task.state is TaskState.RUNNING and task.run.begin_ns is None
        if (
            waiting
            and _is_reached(get_start_trigger(task), reached)
            and task.settings["DigEdge.StartTrig.Edge"] == edge
        ):
            bench.kinds[task.kind].triggered(bench, task, at_ns)


def _is_reached(terminal: str, reached: set[str]) -> bool:
    """Return whether a terminal is among those reached; a backplane line is the same at all boards."""
    if terminal in reached:
        return True
    # The lines of the backplane are common to all boards of a chassis.
    line = terminal.rpartition("/")[2]
    return line.startswith(BACKPLANE) and any(name.rpartition("/")[2] == line for name in reached)


def _has_terminal(bench: Bench, terminal: str) -> bool:
    """Return whether any board that is plugged in has the terminal."""
    name = short_name(terminal)
    return any(
        name == short_name(known)
        for device in bench.devices.present()
        for known in list_terminals(device.kind, device.name)
    )


def configure_start_trigger(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Answer `DAQmxCfgDigEdgeStartTrig`: start the task at a digital edge of a terminal.

    Raise Status for an unknown board or terminal, or while the task runs.
    """
    tasks.mark_changed(task)
    source = arguments["trigger_source"]
    device = source.strip().lstrip("/").partition("/")[0]
    if "/" in source.strip("/"):
        bench.devices.find(device)
    if not _has_terminal(bench, source):
        raise Status(
            statuses.INVALID_VALUE,
            f"Property: DigEdge.StartTrig.Src\nRequested Value: {source}",
            task=task.name,
        )
    task.settings |= {
        "StartTrig.Type": DIGITAL_EDGE,
        "DigEdge.StartTrig.Src": source,
        "DigEdge.StartTrig.Edge": arguments["trigger_edge"],
    }


def require_start_route(bench: Bench, task: Task) -> None:
    """Check that the counter whose internal output starts an input task can reach its board.

    Other start triggers are not checked.

    Raises
    ------
    Status
        The board cannot be started by that counter (-89136), is in another chassis (-89125), or the counter's
        board is unknown.
    """
    name, _, end = get_start_trigger(task).partition("/")
    if not end.endswith(INTERNAL_OUTPUT):
        return
    source, device = bench.devices.find(name), task.device
    if source is device:
        if int(end.removeprefix("ctr").removesuffix(INTERNAL_OUTPUT)) not in device.kind.starting_counters:
            raise Status(
                statuses.ROUTE_NOT_SUPPORTED, f"Source Terminal: {get_start_trigger(task)}", task=task.name
            )
    elif "slot" not in name or _parse_chassis_name(name) != _parse_chassis_name(device.name):
        between = f"Source Device: {source.name}\nDestination Device: {device.name}"
        raise Status(statuses.NO_TRIGGER_LINE, between, task=task.name)


def _parse_chassis_name(name: str) -> str:
    """Return the chassis in a board's name, `pxi1` for `PXI1Slot3`; a name without slot in lower case."""
    return name.casefold().partition("slot")[0]


def disable_start_trigger(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Answer `DAQmxDisableStartTrig`: let the task start without a trigger; raise Status while it runs."""
    tasks.mark_changed(task)
    task.settings["StartTrig.Type"] = NO_TRIGGER


def connect_terminals(bench: Bench, client: str, arguments: Arguments) -> None:
    """Answer `DAQmxConnectTerms`: add a route from a source to a destination terminal.

    Raise Status if one is unknown, or a route from another source ends at the destination.
    """
    source, destination = arguments["source_terminal"], arguments["destination_terminal"]
    if not _has_terminal(bench, source):
        raise Status(statuses.INVALID_SOURCE_TERMINAL, f"Source Terminal: {source}")
    if not _has_terminal(bench, destination):
        raise Status(statuses.INVALID_DESTINATION_TERMINAL, f"Destination Terminal: {destination}")
    other = bench.routes.get(short_name(destination))
    if other not in (None, short_name(source)):
        raise Status(
            statuses.ROUTE_IN_USE, f"Destination Terminal: {destination}\nSource Terminal in use: {other}"
        )
    bench.routes[short_name(destination)] = short_name(source)


def disconnect_terminals(bench: Bench, client: str, arguments: Arguments) -> None:
    """Answer `DAQmxDisconnectTerms`: remove the route between two terminals; do nothing if there is none."""
    destination = short_name(arguments["destination_terminal"])
    if bench.routes.get(destination) == short_name(arguments["source_terminal"]):
        del bench.routes[destination]


def tristate_terminal(bench: Bench, client: str, arguments: Arguments) -> None:
    """Answer `DAQmxTristateOutputTerm`: stop driving a terminal; the output of a counter goes low.

    Raise Status if it is unknown, or a route ends at it.
    """
    terminal = short_name(arguments["output_terminal"])
    if not _has_terminal(bench, terminal):
        raise Status(statuses.INVALID_DESTINATION_TERMINAL, f"Terminal: {arguments['output_terminal']}")
    if terminal in bench.routes:
        raise Status(statuses.TERMINAL_IN_USE, f"Terminal: {arguments['output_terminal']}")
    name, _, pin = terminal.partition("/")
    device = bench.devices.find(name)
    for output in device.kind.counter_terminals:
        if output.casefold() == pin:
            bench.lines.drive(f"{device.serial_number}/{output}", 0, bench.settle(), "tristate")


def export_signal(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Answer `DAQmxExportSignal`: connect an input task's start or reference trigger to a terminal.

    An earlier route to the terminal is replaced. Raise Status for another signal, task or terminal, or while
    the task runs.
    """
    tasks.mark_changed(task)
    ends = {START_TRIGGER_SIGNAL: "StartTrigger", REFERENCE_TRIGGER_SIGNAL: "ReferenceTrigger"}
    signal = arguments["signal_id"]
    if signal not in ends or task.kind != "ai":
        raise Status(
            statuses.INVALID_VALUE, f"Signal: {signal}\nYou Can Select: {sorted(ends)}", task=task.name
        )
    if not _has_terminal(bench, arguments["output_terminal"]):
        raise Status(
            statuses.INVALID_DESTINATION_TERMINAL, f"Terminal: {arguments['output_terminal']}", task=task.name
        )
    source = f"{task.device.name}/ai/{ends[signal]}"
    bench.routes[short_name(arguments["output_terminal"])] = short_name(source)


HANDLERS: Mapping[str, Handler] = {
    "DAQmxConnectTerms": connect_terminals,
    "DAQmxDisconnectTerms": disconnect_terminals,
    "DAQmxTristateOutputTerm": tristate_terminal,
}
TASK_HANDLERS: Mapping[str, TaskHandler] = {
    "DAQmxCfgDigEdgeStartTrig": configure_start_trigger,
    "DAQmxDisableStartTrig": disable_start_trigger,
    "DAQmxExportSignal": export_signal,
}
