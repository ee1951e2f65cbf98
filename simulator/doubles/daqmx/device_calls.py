"""Entry points that name a board: reset, calibration, power-up states."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime

from simulator.doubles.chassis.boards import find_line_terminal
from simulator.doubles.daqmx import tasks
from simulator.doubles.daqmx.devices import Device
from simulator.doubles.daqmx.tasks import Answer, Arguments, Bench, Handler
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.statuses import Status

POWER_UP_HIGH, POWER_UP_LOW, POWER_UP_TRISTATE = 10192, 10214, 10310


def _require_present(bench: Bench, name: str) -> Device:
    """Return a board by name; raise Status -200324 if it has been removed, -200220 if it is unknown."""
    try:
        return bench.devices.find(name)
    except Status as status:
        if status.code != statuses.DEVICE_NOT_ACCESSIBLE:
            raise
        raise Status(statuses.DEVICE_ABSENT, f"Device Specified: {name}") from status


def _remove_from_tasks(bench: Bench, device: Device, status: int, cause: str) -> None:
    """Remove a board from all its tasks, which are stopped; their next calls answer ``status``.

    All its reservations are released, and its lines go low; ``cause`` is recorded with these level changes.
    """
    for task in tuple(bench.tasks.values()):
        if task.is_on(device.serial_number) and not task.lost:
            tasks.lose_board(bench, task, status, cause)
    bench.reservations.release_board(device.serial_number)
    now_ns = bench.settle()
    pins = (*device.kind.counter_terminals, *map(find_line_terminal, device.kind.digital_lines))
    for terminal in dict.fromkeys(pins):
        bench.lines.cut(f"{device.serial_number}/{terminal}", 0, now_ns, cause)


def reset_board(bench: Bench, client: str, arguments: Arguments) -> None:
    """Answer `DAQmxResetDevice`: its tasks are lost, its lines go low, the routes to it are removed.

    Raise Status if the board is unknown or has been removed.
    """
    device = _require_present(bench, arguments["device_name"])
    _remove_from_tasks(bench, device, statuses.DEVICE_ABORTED, "reset")
    own = f"{device.name.casefold()}/"
    bench.routes = {end: start for end, start in bench.routes.items() if not end.startswith(own)}


def self_calibrate_board(bench: Bench, client: str, arguments: Arguments) -> None:
    """Answer `DAQmxSelfCal`: shift the board's offset and set time (UTC) and temperature of its calibration.

    Raise Status while a task holds part of the board, or if it is unknown or has been removed.
    """
    device = _require_present(bench, arguments["device_name"])
    for holder in bench.reservations.holders_of_board(device.serial_number):
        raise Status(
            statuses.RESERVED_BY_OTHER_PROCESS,
            f"Device: {device.name} is reserved by task {holder.task} of {holder.client}.",
        )
    device.self_calibrate(datetime.now(UTC))


def get_last_self_calibration(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """Answer `DAQmxGetSelfCalLastDateAndTime` with year, month, day, hour and minute.

    Raise Status for an unknown board, and for a simulated device, as NI does.
    """
    device = bench.devices.find(arguments["device_name"])
    if device.parameters.simulated:
        raise Status(statuses.INVALID_VALUE, f"Device: {device.name} is simulated and has no calibration.")
    when = device.calibrated
    return {part: getattr(when, part) for part in ("year", "month", "day", "hour", "minute")}


def _find_power_up_lines(bench: Bench, device: Device, names: str) -> list[str]:
    """Return a board's digital lines by names, one per text line; raise Status for an unknown one."""
    known = {f"{device.name}/{line}".casefold(): line for line in device.kind.digital_lines}
    found = []
    for name in names.splitlines():
        if name.strip().lstrip("/").casefold() not in known:
            raise Status(statuses.NO_SUCH_PHYSICAL_CHANNEL, f"Physical Channel: {name}")
        found.append(known[name.strip().lstrip("/").casefold()])
    return found


def set_power_up_states(bench: Bench, client: str, arguments: Arguments) -> None:
    """Answer `DAQmxSetDigitalPowerUpStates`: store the power-up state of each named digital line.

    Raise Status, and set none, for an unknown board, line or state; ValueError if there are not as many
    states as lines.
    """
    device = bench.devices.find(arguments["device_name"])
    lines = _find_power_up_lines(bench, device, arguments["channel_names"])
    states = [int(state) for state in arguments["state"]]
    for state in states:
        if state not in (POWER_UP_HIGH, POWER_UP_LOW, POWER_UP_TRISTATE):
            raise Status(statuses.INVALID_VALUE, f"Power-up state {state}.")
    device.power_up_states |= dict(zip(lines, states, strict=True))


def get_power_up_states(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """Answer `DAQmxGetDigitalPowerUpStates` with the state of each named line; tristate if none is stored.

    Raise Status for an unknown board or line.
    """
    device = bench.devices.find(arguments["device_name"])
    lines = _find_power_up_lines(bench, device, arguments["channel_names"])
    return {"state": [device.power_up_states.get(line, POWER_UP_TRISTATE) for line in lines]}


def unplug_board(bench: Bench, serial_number: int) -> None:
    """Remove a board from the chassis: its tasks are lost, its lines go low, waiting calls wake up.

    Raise KeyError if no board has this serial number.
    """
    _remove_from_tasks(bench, bench.devices.get_by_serial(serial_number), statuses.DEVICE_REMOVED, "unplug")
    bench.devices.unplug(serial_number)
    bench.changed.notify_all()


HANDLERS: Mapping[str, Handler] = {
    "DAQmxResetDevice": reset_board,
    "DAQmxSelfCal": self_calibrate_board,
    "DAQmxGetSelfCalLastDateAndTime": get_last_self_calibration,
    "DAQmxSetDigitalPowerUpStates": set_power_up_states,
    "DAQmxGetDigitalPowerUpStates": get_power_up_states,
}
