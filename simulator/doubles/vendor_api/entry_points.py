"""The table of C entry points that the doubles answer.

From it are made the C source of the libraries (`c_source`), the bytes on the wire (`wire`) and the
brain's dispatch. Parameter names are those that `nidaqmx` and the NI-DAQmx gRPC messages use. Here are
the vocabulary and the entries of NI-DAQmx; `table` puts those of all libraries together.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType


@dataclass(frozen=True, slots=True)
class Scalar:
    """C type: its C spelling and its `struct` format (little-endian, no padding)."""

    c_type: str
    packed: str


INT16 = Scalar("int16_t", "h")
UINT16 = Scalar("uint16_t", "H")
INT32 = Scalar("int32_t", "i")
UINT32 = Scalar("uint32_t", "I")
UINT64 = Scalar("uint64_t", "Q")
FLOAT64 = Scalar("double", "d")
BYTE = Scalar("uint8_t", "B")
HANDLE = Scalar("void *", "Q")
"""A task handle: a pointer to the caller, a number to the brain."""


class Role(Enum):
    """Purpose of a parameter."""

    VALUE = "value"
    """A number by value."""
    TEXT = "text"
    """`const char *`; NULL reads as empty."""
    ARRAY = "array"
    """Numbers to read; `size` names the parameter that holds how many."""
    OUT = "out"
    """Pointer to one number to write; may be NULL."""
    OUT_ARRAY = "out_array"
    """Numbers to write; `size` names the parameter that holds the room, in elements."""
    OUT_TEXT = "out_text"
    """Text to write; with `size` 0 the entry returns the room that is needed."""
    UNUSED = "unused"
    """A reserved pointer."""


class Tail(Enum):
    """Arguments after the fixed parameters of a variadic entry."""

    NONE = "none"
    GET_ATTRIBUTE = "get_attribute"
    """Where to write the attribute's value and, for text and arrays, the room there."""
    SET_ATTRIBUTE = "set_attribute"
    """The attribute's value and, for arrays, how many."""
    SET_STATES = "set_states"
    """Pairs of channel name and state, ended by NULL."""
    GET_STATES = "get_states"
    """Pairs of channel name and where to write its state, ended by NULL."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """Parameter of one entry point."""

    name: str
    role: Role
    scalar: Scalar
    size: str = ""

    @property
    def goes_out(self) -> bool:
        """Return whether the parameter is part of the answer."""
        return self.role in (Role.OUT, Role.OUT_ARRAY, Role.OUT_TEXT)


@dataclass(frozen=True, slots=True)
class EntryPoint:
    """C function.

    Attributes
    ----------
    library
        Which library exports it: ``nidaqmx``, ``niScope``.
    local
        Answered inside the C library, never sent to the brain.
    """

    name: str
    parameters: tuple[Parameter, ...]
    tail: Tail = Tail.NONE
    library: str = "nidaqmx"
    local: bool = False


def value(name: str, scalar: Scalar = INT32) -> Parameter:
    """Declare a number passed by value."""
    return Parameter(name, Role.VALUE, scalar)


def text(name: str) -> Parameter:
    """Declare a text."""
    return Parameter(name, Role.TEXT, BYTE)


def array(name: str, scalar: Scalar, size: str) -> Parameter:
    """Declare an input array of numbers."""
    return Parameter(name, Role.ARRAY, scalar, size)


def out(name: str, scalar: Scalar) -> Parameter:
    """Declare an output number."""
    return Parameter(name, Role.OUT, scalar)


def out_array(name: str, scalar: Scalar, size: str) -> Parameter:
    """Declare an output array of numbers."""
    return Parameter(name, Role.OUT_ARRAY, scalar, size)


def out_text(name: str, size: str) -> Parameter:
    """Declare an output text."""
    return Parameter(name, Role.OUT_TEXT, BYTE, size)


def unused(name: str = "reserved") -> Parameter:
    """Declare a reserved pointer."""
    return Parameter(name, Role.UNUSED, BYTE)


TASK = value("task", HANDLE)
DEVICE = text("device_name")
ATTRIBUTE = value("attribute")


def _read_binary(suffix: str, scalar: Scalar) -> EntryPoint:
    return EntryPoint(
        f"DAQmxReadBinary{suffix}",
        (
            TASK,
            value("num_samps_per_chan"),
            value("timeout", FLOAT64),
            value("fill_mode"),
            out_array("read_array", scalar, "array_size_in_samps"),
            value("array_size_in_samps", UINT32),
            out("samps_per_chan_read", INT32),
            unused(),
        ),
    )


def _attribute_entries() -> Iterable[EntryPoint]:
    owners: Mapping[str, tuple[Parameter, ...]] = {
        "Task": (TASK,),
        "Device": (DEVICE,),
        "SystemInfo": (),
        "CalInfo": (DEVICE,),
        "Chan": (TASK, text("channel")),
        "Timing": (TASK,),
        "Trig": (TASK,),
        "Read": (TASK,),
        "Watchdog": (TASK, text("lines")),
    }
    for family, owner in owners.items():
        yield EntryPoint(f"DAQmxGet{family}Attribute", (*owner, ATTRIBUTE), Tail.GET_ATTRIBUTE)
        if family in ("Chan", "Timing", "Trig"):
            yield EntryPoint(f"DAQmxSet{family}Attribute", (*owner, ATTRIBUTE), Tail.SET_ATTRIBUTE)


_DAQMX = (
    EntryPoint(
        "DAQmxSetRuntimeEnvironment",
        (text("environment"), text("environment_version"), text("reserved_1"), text("reserved_2")),
    ),
    EntryPoint(
        "DAQmxGetErrorString",
        (value("error_code"), out_text("error_string", "buffer_size"), value("buffer_size", UINT32)),
    ),
    EntryPoint(
        "DAQmxGetExtendedErrorInfo",
        (out_text("error_string", "buffer_size"), value("buffer_size", UINT32)),
        local=True,
    ),
    # Tasks
    EntryPoint("DAQmxCreateTask", (text("session_name"), out("task", HANDLE))),
    EntryPoint("DAQmxClearTask", (TASK,)),
    EntryPoint("DAQmxTaskControl", (TASK, value("action"))),
    EntryPoint("DAQmxStartTask", (TASK,)),
    EntryPoint("DAQmxStopTask", (TASK,)),
    EntryPoint("DAQmxWaitUntilTaskDone", (TASK, value("time_to_wait", FLOAT64))),
    # Channels
    EntryPoint(
        "DAQmxCreateAIVoltageChan",
        (
            TASK,
            text("physical_channel"),
            text("name_to_assign_to_channel"),
            value("terminal_config"),
            value("min_val", FLOAT64),
            value("max_val", FLOAT64),
            value("units"),
            text("custom_scale_name"),
        ),
    ),
    EntryPoint(
        "DAQmxCreateCOPulseChanTime",
        (
            TASK,
            text("counter"),
            text("name_to_assign_to_channel"),
            value("units"),
            value("idle_state"),
            value("initial_delay", FLOAT64),
            value("low_time", FLOAT64),
            value("high_time", FLOAT64),
        ),
    ),
    EntryPoint("DAQmxInternalGetLastCreatedChan", (out_text("value", "size"), value("size", UINT32))),
    # Timing and triggers
    EntryPoint(
        "DAQmxCfgSampClkTiming",
        (
            TASK,
            text("source"),
            value("rate", FLOAT64),
            value("active_edge"),
            value("sample_mode"),
            value("samps_per_chan", UINT64),
        ),
    ),
    EntryPoint(
        "DAQmxCfgAnlgEdgeRefTrig",
        (
            TASK,
            text("trigger_source"),
            value("trigger_slope"),
            value("trigger_level", FLOAT64),
            value("pretrigger_samples", UINT32),
        ),
    ),
    EntryPoint("DAQmxCfgDigEdgeStartTrig", (TASK, text("trigger_source"), value("trigger_edge"))),
    EntryPoint("DAQmxDisableRefTrig", (TASK,)),
    EntryPoint("DAQmxDisableStartTrig", (TASK,)),
    EntryPoint("DAQmxExportSignal", (TASK, value("signal_id"), text("output_terminal"))),
    # Reading
    _read_binary("I16", INT16),
    _read_binary("I32", INT32),
    # Devices, terminals, calibration
    EntryPoint("DAQmxResetDevice", (DEVICE,)),
    EntryPoint("DAQmxSelfCal", (DEVICE,)),
    EntryPoint(
        "DAQmxGetSelfCalLastDateAndTime",
        (DEVICE, *(out(part, UINT32) for part in ("year", "month", "day", "hour", "minute"))),
    ),
    EntryPoint(
        "DAQmxConnectTerms",
        (text("source_terminal"), text("destination_terminal"), value("signal_modifiers")),
    ),
    EntryPoint("DAQmxDisconnectTerms", (text("source_terminal"), text("destination_terminal"))),
    EntryPoint("DAQmxTristateOutputTerm", (text("output_terminal"),)),
    EntryPoint("DAQmxSetDigitalPowerUpStates", (DEVICE,), Tail.SET_STATES),
    EntryPoint("DAQmxGetDigitalPowerUpStates", (DEVICE,), Tail.GET_STATES),
    # Watchdog
    EntryPoint(
        "DAQmxCreateWatchdogTimerTaskEx",
        (DEVICE, text("session_name"), out("task", HANDLE), value("timeout", FLOAT64)),
    ),
    EntryPoint(
        "DAQmxCfgWatchdogDOExpirStates",
        (
            TASK,
            text("channel_names"),
            array("expir_state_array", INT32, "array_size"),
            value("array_size", UINT32),
        ),
    ),
    EntryPoint("DAQmxControlWatchdogTask", (TASK, value("action"))),
    *_attribute_entries(),
)

ENTRY_POINTS: Mapping[str, EntryPoint] = MappingProxyType({entry.name: entry for entry in _DAQMX})
"""By C name."""
