"""Entry points that name a board: reset, self-test, calibration, power-up states."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from types import MappingProxyType

from simulator.doubles.chassis.boards import terminal_of_line
from simulator.doubles.daqmx import tasks
from simulator.doubles.daqmx.devices import Device
from simulator.doubles.daqmx.tasks import Answer, Arguments, Bench
from simulator.doubles.vendor_api.statuses import (
    DEVICE_ABORTED,
    DEVICE_ABSENT,
    DEVICE_NOT_ACCESSIBLE,
    DEVICE_REMOVED,
    INVALID_VALUE,
    NO_SUCH_PHYSICAL_CHANNEL,
    RESERVED_BY_OTHER_PROCESS,
    Status,
)
from simulator.doubles.vendor_api.wire import names_of

POWER_UP_HIGH = 10192
POWER_UP_LOW = 10214
POWER_UP_TRISTATE = 10310


def _present(bench: Bench, name: str) -> Device:
    """Board for an operation on the hardware itself: one that is gone is absent (-200324)."""
    try:
        return bench.devices.find(name)
    except Status as status:
        if status.code != DEVICE_NOT_ACCESSIBLE:
            raise
        raise Status(DEVICE_ABSENT, f"Device Specified: {name}") from status


def _require_free(bench: Bench, device: Device) -> None:
    for holder in bench.reservations.holders_of_board(device.serial_number):
        raise Status(
            RESERVED_BY_OTHER_PROCESS,
            f"Device: {device.name} is reserved by task {holder.task} of {holder.client}.",
        )


def _lines_low(bench: Bench, device: Device, cause: str) -> None:
    now_ns = bench.settle()
    pins = (*device.kind.counter_terminals, *map(terminal_of_line, device.kind.digital_lines))
    for terminal in dict.fromkeys(pins):
        bench.lines.cut(f"{device.serial_number}/{terminal}", 0, now_ns, cause)


def reset(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxResetDevice`: whoever used the board loses it, its lines go low, its routes are gone."""
    device = _present(bench, arguments["device_name"])
    for task in tuple(bench.tasks.values()):
        if device.serial_number in tasks.serials(task) and not task.lost:
            tasks.lose(bench, task, DEVICE_ABORTED, "reset")
    bench.reservations.release_board(device.serial_number)
    _lines_low(bench, device, "reset")
    own = f"{device.name.casefold()}/"
    bench.routes = {end: start for end, start in bench.routes.items() if not end.startswith(own)}
    return {}


def self_test(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxSelfTestDevice`."""
    _require_free(bench, _present(bench, arguments["device_name"]))
    return {}


def self_calibrate(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxSelfCal`: only while no task holds the board."""
    device = _present(bench, arguments["device_name"])
    _require_free(bench, device)
    device.self_calibrate(datetime.now(UTC))
    return {}


def supports_calibration(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxDeviceSupportsCal`."""
    bench.devices.find(arguments["device_name"])
    return {"cal_supported": 1}


def last_self_calibration(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetSelfCalLastDateAndTime`."""
    return _date(bench.devices.find(arguments["device_name"]).calibrated)


def last_external_calibration(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetExtCalLastDateAndTime`: by the maker, before the double started."""
    device = bench.devices.find(arguments["device_name"])
    return _date(datetime.fromisoformat(device.parameters.calibrated))


def _date(when: datetime) -> Answer:
    return {
        "year": when.year,
        "month": when.month,
        "day": when.day,
        "hour": when.hour,
        "minute": when.minute,
    }


def _power_up_lines(bench: Bench, device: Device, names: str) -> list[str]:
    known = {f"{device.name}/{line}".casefold(): line for line in device.kind.digital_lines}
    found = []
    for name in names_of(names):
        if name.strip().lstrip("/").casefold() not in known:
            raise Status(NO_SUCH_PHYSICAL_CHANNEL, f"Physical Channel: {name}")
        found.append(known[name.strip().lstrip("/").casefold()])
    return found


def set_power_up_states(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxSetDigitalPowerUpStates`."""
    device = bench.devices.find(arguments["device_name"])
    lines = _power_up_lines(bench, device, arguments["channel_names"])
    states = [int(state) for state in arguments["state"]]
    for state in states:
        if state not in (POWER_UP_HIGH, POWER_UP_LOW, POWER_UP_TRISTATE):
            raise Status(INVALID_VALUE, f"Power-up state {state}.")
    device.power_up_states |= dict(zip(lines, states, strict=True))
    return {}


def get_power_up_states(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetDigitalPowerUpStates`."""
    device = bench.devices.find(arguments["device_name"])
    lines = _power_up_lines(bench, device, arguments["channel_names"])
    return {"state": [device.power_up_states.get(line, POWER_UP_TRISTATE) for line in lines]}


def unplug(bench: Bench, serial_number: int) -> None:
    """Take a board out: its tasks are lost, its lines go low."""
    device = bench.devices.by_serial(serial_number)
    for task in tuple(bench.tasks.values()):
        if serial_number in tasks.serials(task) and not task.lost:
            tasks.lose(bench, task, DEVICE_REMOVED, "unplug")
    bench.reservations.release_board(serial_number)
    _lines_low(bench, device, "unplug")
    bench.devices.unplug(serial_number)
    bench.changed.notify_all()


HANDLERS: Mapping[str, Callable[[Bench, str, Arguments], Answer]] = MappingProxyType(
    {
        "DAQmxResetDevice": reset,
        "DAQmxSelfTestDevice": self_test,
        "DAQmxSelfCal": self_calibrate,
        "DAQmxDeviceSupportsCal": supports_calibration,
        "DAQmxGetSelfCalLastDateAndTime": last_self_calibration,
        "DAQmxGetExtCalLastDateAndTime": last_external_calibration,
        "DAQmxSetDigitalPowerUpStates": set_power_up_states,
        "DAQmxGetDigitalPowerUpStates": get_power_up_states,
    }
)
