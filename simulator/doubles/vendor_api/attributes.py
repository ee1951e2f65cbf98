"""The attributes (NI calls them properties) that the variadic entries read and write.

A number names the attribute and with it the C type of its value; the same table shows the C library
what to take from the variable arguments.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from simulator.doubles.vendor_api.entry_points import FLOAT64, INT32, UINT32, Scalar


@dataclass(frozen=True, slots=True)
class Attribute:
    """Attribute of a vendor API.

    Attributes
    ----------
    family
        Which pair of entries it belongs to: ``DAQmxGet<family>Attribute``.
    scalar
        Type of its value or of an array's elements; None for text.
    is_array
        The value is an array of `scalar`.
    settable
        False: reading only.
    """

    number: int
    name: str
    family: str
    scalar: Scalar | None
    is_array: bool = False
    settable: bool = False


def _number(
    family: str, scalar: Scalar, names: Mapping[int, str], *, settable: bool = False
) -> list[Attribute]:
    return [Attribute(number, name, family, scalar, settable=settable) for number, name in names.items()]


def _text(family: str, names: Mapping[int, str], *, settable: bool = False) -> list[Attribute]:
    return [Attribute(number, name, family, None, settable=settable) for number, name in names.items()]


def _array(family: str, scalar: Scalar, names: Mapping[int, str]) -> list[Attribute]:
    return [Attribute(number, name, family, scalar, is_array=True) for number, name in names.items()]


_TABLE = [
    *_number(
        "SystemInfo",
        UINT32,
        {0x1272: "Sys.NIDAQMajorVersion", 0x1923: "Sys.NIDAQMinorVersion", 0x2F22: "Sys.NIDAQUpdateVersion"},
    ),
    *_text("SystemInfo", {0x193B: "Sys.DevNames"}),
    *_text("Task", {0x1276: "Task.Name", 0x1273: "Task.Channels"}),
    # Devices
    *_text(
        "Device",
        {
            0x631: "Dev.ProductType",
            0x2A40: "Dev.Terminals",
            0x231E: "Dev.AI.PhysicalChans",
            0x2325: "Dev.CO.PhysicalChans",
            0x2322: "Dev.DO.Lines",
        },
    ),
    *_number(
        "Device", UINT32, {0x632: "Dev.SerialNum", 0x22CA: "Dev.IsSimulated", 0x2984: "Dev.AnlgTrigSupported"}
    ),
    *_number("Device", FLOAT64, {0x298C: "Dev.AI.MaxSingleChanRate"}),
    *_array("Device", FLOAT64, {0x2990: "Dev.AI.VoltageRngs"}),
    # Calibration
    *_number("CalInfo", UINT32, {0x1860: "SelfCal.Supported"}),
    *_number("CalInfo", FLOAT64, {0x1864: "SelfCal.LastTemp", 0x223B: "Cal.DevTemp"}),
    # Channels
    *_number("Chan", INT32, {0x64: "AI.Coupling"}, settable=True),
    *_number("Chan", INT32, {0x187F: "ChanType", 0x1170: "CO.Pulse.IdleState"}),
    *_text("Chan", {0x18E1: "CO.Pulse.Term"}, settable=True),
    *_number(
        "Chan",
        FLOAT64,
        {
            0x1765: "AI.Resolution",
            0x1815: "AI.Rng.High",
            0x1816: "AI.Rng.Low",
            0x18BA: "CO.Pulse.HighTime",
        },
    ),
    *_number("Chan", UINT32, {0x22DA: "AI.RawSampSize"}),
    *_array("Chan", FLOAT64, {0x1930: "AI.DevScalingCoeff"}),
    # Timing
    *_number("Timing", FLOAT64, {0x1344: "SampClk.Rate", 0x1315: "RefClk.Rate"}, settable=True),
    *_text("Timing", {0x1316: "RefClk.Src"}, settable=True),
    # Triggers
    *_number(
        "Trig",
        INT32,
        {
            0x1419: "RefTrig.Type",
            0x1423: "AnlgEdge.RefTrig.Slope",
            0x1393: "StartTrig.Type",
            0x1404: "DigEdge.StartTrig.Edge",
            0x18C8: "StartTrig.DelayUnits",
        },
        settable=True,
    ),
    *_text("Trig", {0x1424: "AnlgEdge.RefTrig.Src", 0x1407: "DigEdge.StartTrig.Src"}, settable=True),
    *_text("Trig", {0x2F1F: "RefTrig.Term", 0x2F1E: "StartTrig.Term"}),
    *_number("Trig", FLOAT64, {0x1422: "AnlgEdge.RefTrig.Lvl", 0x1856: "StartTrig.Delay"}, settable=True),
    *_number("Trig", UINT32, {0x1445: "RefTrig.PretrigSamples"}, settable=True),
    # Of reading: what NI's stream readers ask before a read
    *_number("Read", UINT32, {0x217B: "Read.NumChans"}),
    *_number("Watchdog", UINT32, {0x21A8: "Watchdog.HasExpired"}),
]

ATTRIBUTES: Mapping[int, Attribute] = MappingProxyType({entry.number: entry for entry in _TABLE})
"""By number; booleans are 32-bit numbers as in C."""
