"""Attributes of the system, its boards and their calibration."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from simulator.doubles.chassis.boards import list_terminals
from simulator.doubles.daqmx.attribute_lookup import answer_attribute
from simulator.doubles.daqmx.devices import Device
from simulator.doubles.daqmx.tasks import Answer, Arguments, Bench, Handler

_SYSTEM: Mapping[str, Callable[[Bench], object]] = {
    "Sys.NIDAQMajorVersion": lambda bench: bench.description.driver_version[0],
    "Sys.NIDAQMinorVersion": lambda bench: bench.description.driver_version[1],
    "Sys.NIDAQUpdateVersion": lambda bench: bench.description.driver_version[2],
    "Sys.DevNames": lambda bench: ", ".join(device.name for device in bench.devices.present()),
}

_DEVICE: Mapping[str, Callable[[Device], object]] = {
    "Dev.ProductType": lambda device: device.kind.product,
    "Dev.SerialNum": lambda device: device.serial_number,
    # A double passes for hardware, if it is not told otherwise: drivers shall take the real path.
    "Dev.IsSimulated": lambda device: int(device.parameters.simulated),
    "Dev.Terminals": lambda device: ", ".join(list_terminals(device.kind, device.name)),
    "Dev.AI.PhysicalChans": lambda device: ", ".join(
        f"{device.name}/ai{n}" for n in range(device.kind.analog_inputs)
    ),
    "Dev.CO.PhysicalChans": lambda device: ", ".join(
        f"{device.name}/{counter}"
        for counter in (*(f"ctr{n}" for n in range(len(device.kind.counter_terminals))), "freqout")
    ),
    "Dev.DO.Lines": lambda device: ", ".join(f"{device.name}/{line}" for line in device.kind.digital_lines),
    "Dev.AI.MaxSingleChanRate": lambda device: device.kind.max_rate_hz,
    "Dev.AI.VoltageRngs": lambda device: [end for limit in device.kind.ranges_v for end in (-limit, limit)],
    "Dev.AnlgTrigSupported": lambda device: int(device.kind.simultaneous),
}

_CALIBRATION: Mapping[str, Callable[[Device], object]] = {
    "SelfCal.Supported": lambda device: 1,
    "SelfCal.LastTemp": lambda device: device.calibration_temperature_c,
    "Cal.DevTemp": lambda device: device.temperature_c,
}


def get_system_attribute(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """Answer `DAQmxGetSystemInfoAttribute` with the driver's version or the names of the boards plugged in.

    Raise Status for another attribute.
    """
    return answer_attribute(_SYSTEM, arguments, "SystemInfo", bench)


def get_device_attribute(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """Answer `DAQmxGetDeviceAttribute` with an attribute of a board.

    Raise Status if the board is unknown or not plugged in, or the attribute is unknown.
    """
    return answer_attribute(_DEVICE, arguments, "Device", bench.devices.find(arguments["device_name"]))


def get_calibration_attribute(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """Answer `DAQmxGetCalInfoAttribute`: self-calibration support and temperature, present temperature, °C.

    Raise Status if the board is unknown or not plugged in, or the attribute is unknown.
    """
    return answer_attribute(_CALIBRATION, arguments, "CalInfo", bench.devices.find(arguments["device_name"]))


HANDLERS: Mapping[str, Handler] = {
    "DAQmxGetSystemInfoAttribute": get_system_attribute,
    "DAQmxGetDeviceAttribute": get_device_attribute,
    "DAQmxGetCalInfoAttribute": get_calibration_attribute,
}
