"""Attributes of the system, its boards, their calibration and their physical channels."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from simulator.doubles.chassis.boards import terminals
from simulator.doubles.daqmx import analog_input
from simulator.doubles.daqmx.attribute_lookup import Values, attribute_of, listed, look_up
from simulator.doubles.daqmx.counter_output import COUNTER_BITS, TIMEBASE_HZ
from simulator.doubles.daqmx.devices import Device
from simulator.doubles.daqmx.tasks import Answer, Arguments, Bench

PULSE_TIME = 10269
DC_COUPLING = 1
REFERENCE_AND_START = 8 + 4


def _counters(device: Device) -> str:
    return listed(f"{device.name}/ctr{n}" for n in range(len(device.kind.counter_terminals)))


def _ports(device: Device) -> str:
    ports = dict.fromkeys(line.partition("/")[0] for line in device.kind.digital_lines)
    return listed(f"{device.name}/{port}" for port in ports)


_SYSTEM: Values = {
    "Sys.NIDAQMajorVersion": lambda bench: bench.description.driver_version[0],
    "Sys.NIDAQMinorVersion": lambda bench: bench.description.driver_version[1],
    "Sys.NIDAQUpdateVersion": lambda bench: bench.description.driver_version[2],
    "Sys.DevNames": lambda bench: listed(device.name for device in bench.devices.present()),
    "Sys.Tasks": lambda bench: "",
    "Sys.GlobalChans": lambda bench: "",
    "Sys.Scales": lambda bench: "",
}

_DEVICE: Values = {
    "Dev.ProductType": lambda d: d.kind.product,
    "Dev.ProductNum": lambda d: d.kind.number,
    "Dev.ProductCategory": lambda d: d.kind.category,
    "Dev.BusType": lambda d: d.kind.bus,
    "Dev.SerialNum": lambda d: d.serial_number,
    # A double passes for hardware: `doctor` and drivers shall take the real path.
    "Dev.IsSimulated": lambda d: 0,
    "Dev.PXI.ChassisNum": lambda d: d.parameters.chassis,
    "Dev.PXI.SlotNum": lambda d: d.parameters.slot,
    "Dev.PCI.BusNum": lambda d: d.parameters.slot,
    "Dev.PCI.DevNum": lambda d: 0,
    "Dev.NumDMAChans": lambda d: 8,
    "Dev.Terminals": lambda d: listed(terminals(d.kind, d.name)),
    "Dev.Accessory.ProductTypes": lambda d: "",
    "Dev.AI.PhysicalChans": lambda d: listed(f"{d.name}/ai{n}" for n in range(d.kind.analog_inputs)),
    "Dev.AO.PhysicalChans": lambda d: "",
    "Dev.CI.PhysicalChans": _counters,
    "Dev.CO.PhysicalChans": lambda d: listed([_counters(d), f"{d.name}/freqout"]),
    "Dev.DI.Lines": lambda d: listed(f"{d.name}/{line}" for line in d.kind.digital_lines),
    "Dev.DO.Lines": lambda d: listed(f"{d.name}/{line}" for line in d.kind.digital_lines),
    "Dev.DI.Ports": _ports,
    "Dev.DO.Ports": _ports,
    "Dev.AI.SimultaneousSamplingSupported": lambda d: int(d.kind.simultaneous),
    "Dev.AI.MaxSingleChanRate": lambda d: d.kind.max_rate_hz,
    "Dev.AI.MaxMultiChanRate": lambda d: d.kind.max_rate_hz,
    "Dev.AI.MinRate": lambda d: d.kind.timebase_hz / 2**COUNTER_BITS,
    "Dev.AI.NumSampTimingEngines": lambda d: 1,
    "Dev.AI.VoltageRngs": lambda d: [end for r in d.kind.ranges_v for end in (-r, r)],
    "Dev.AI.SupportedMeasTypes": lambda d: [analog_input.VOLTAGE],
    "Dev.AI.SampModes": lambda d: [analog_input.FINITE],
    "Dev.AI.TrigUsage": lambda d: REFERENCE_AND_START,
    "Dev.AI.Couplings": lambda d: DC_COUPLING,
    "Dev.AnlgTrigSupported": lambda d: int(d.kind.simultaneous),
    "Dev.DigTrigSupported": lambda d: 1,
    "Dev.CO.MaxSize": lambda d: COUNTER_BITS,
    "Dev.CO.MaxTimebase": lambda d: TIMEBASE_HZ,
    "Dev.CO.SampClkSupported": lambda d: 0,
    "Dev.CO.SupportedOutputTypes": lambda d: [PULSE_TIME],
    "Dev.CO.SampModes": lambda d: [10178, 10123],
    "Dev.CO.TrigUsage": lambda d: 8,
}

_CALIBRATION: Values = {
    "SelfCal.Supported": lambda d: 1,
    "SelfCal.LastTemp": lambda d: d.calibration_temperature_c,
    "ExtCal.LastTemp": lambda d: d.parameters.temperature_c,
    "Cal.DevTemp": lambda d: d.parameters.temperature_c,
    "Cal.UserDefinedInfo": lambda d: "",
}


def get_system(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetSystemInfoAttribute`."""
    return look_up(_SYSTEM, attribute_of(arguments, "SystemInfo"), bench)


def get_device(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetDeviceAttribute`."""
    device = bench.devices.find(arguments["device_name"])
    return look_up(_DEVICE, attribute_of(arguments, "Device"), device)


def get_calibration(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetCalInfoAttribute`."""
    device = bench.devices.find(arguments["device_name"])
    return look_up(_CALIBRATION, attribute_of(arguments, "CalInfo"), device)


def get_physical_channel(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetPhysicalChanAttribute`."""
    attribute, name = attribute_of(arguments, "PhysicalChan"), arguments["physical_channel"]
    if attribute.name == "PhysicalChan.CO.SupportedOutputTypes":
        bench.devices.channels(name, "ctr")
        return {"value": [PULSE_TIME]}
    ((device, _),) = bench.devices.channels(name, "ai")[:1]
    if attribute.name == "PhysicalChan.AI.SupportedMeasTypes":
        return {"value": [analog_input.VOLTAGE]}
    pseudo = device.kind.terminal_configuration != 10106
    # Bits: 1 RSE, 2 NRSE, 4 differential, 8 pseudodifferential.
    return {"value": 8 if pseudo else 4}


HANDLERS: Mapping[str, Callable[[Bench, str, Arguments], Answer]] = MappingProxyType(
    {
        "DAQmxGetSystemInfoAttribute": get_system,
        "DAQmxGetDeviceAttribute": get_device,
        "DAQmxGetCalInfoAttribute": get_calibration,
        "DAQmxGetPhysicalChanAttribute": get_physical_channel,
    }
)
