"""The attributes (NI calls them properties) that the variadic entries read and write.

A number names the attribute and with it the C type of its value; the same table tells the C library
what to take from the variable arguments.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from simulator.doubles.vendor_api.entry_points import FLOAT64, INT32, UINT32, UINT64, Scalar


@dataclass(frozen=True, slots=True)
class Attribute:
    """One attribute.

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
    *_text(
        "SystemInfo",
        {0x193B: "Sys.DevNames", 0x1267: "Sys.Tasks", 0x1265: "Sys.GlobalChans", 0x1266: "Sys.Scales"},
    ),
    *_text("Task", {0x1276: "Task.Name", 0x1273: "Task.Channels", 0x230E: "Task.Devices"}),
    *_number("Task", UINT32, {0x2181: "Task.NumChans", 0x29BA: "Task.NumDevices"}),
    # Devices
    *_text(
        "Device",
        {
            0x631: "Dev.ProductType",
            0x2A40: "Dev.Terminals",
            0x231E: "Dev.AI.PhysicalChans",
            0x231F: "Dev.AO.PhysicalChans",
            0x2324: "Dev.CI.PhysicalChans",
            0x2325: "Dev.CO.PhysicalChans",
            0x2320: "Dev.DI.Lines",
            0x2321: "Dev.DI.Ports",
            0x2322: "Dev.DO.Lines",
            0x2323: "Dev.DO.Ports",
            0x2F6D: "Dev.Accessory.ProductTypes",
        },
    ),
    *_number(
        "Device",
        UINT32,
        {
            0x632: "Dev.SerialNum",
            0x22CA: "Dev.IsSimulated",
            0x231D: "Dev.ProductNum",
            0x2329: "Dev.PXI.ChassisNum",
            0x232A: "Dev.PXI.SlotNum",
            0x2327: "Dev.PCI.BusNum",
            0x2328: "Dev.PCI.DevNum",
            0x298F: "Dev.AI.SimultaneousSamplingSupported",
            0x3163: "Dev.AI.NumSampTimingEngines",
            0x2984: "Dev.AnlgTrigSupported",
            0x2985: "Dev.DigTrigSupported",
            0x29A1: "Dev.CO.MaxSize",
            0x2F5B: "Dev.CO.SampClkSupported",
            0x233C: "Dev.NumDMAChans",
        },
    ),
    *_number(
        "Device",
        INT32,
        {
            0x29A9: "Dev.ProductCategory",
            0x2326: "Dev.BusType",
            0x2986: "Dev.AI.TrigUsage",
            0x298B: "Dev.CO.TrigUsage",
            0x2994: "Dev.AI.Couplings",
        },
    ),
    *_number(
        "Device",
        FLOAT64,
        {
            0x298C: "Dev.AI.MaxSingleChanRate",
            0x298D: "Dev.AI.MaxMultiChanRate",
            0x298E: "Dev.AI.MinRate",
            0x29A2: "Dev.CO.MaxTimebase",
        },
    ),
    *_array("Device", FLOAT64, {0x2990: "Dev.AI.VoltageRngs"}),
    *_array(
        "Device",
        INT32,
        {
            0x2FD2: "Dev.AI.SupportedMeasTypes",
            0x2FDC: "Dev.AI.SampModes",
            0x2FD5: "Dev.CO.SupportedOutputTypes",
            0x2FDF: "Dev.CO.SampModes",
        },
    ),
    *_number("PhysicalChan", INT32, {0x2342: "PhysicalChan.AI.TermCfgs"}),
    *_array(
        "PhysicalChan",
        INT32,
        {0x2FD7: "PhysicalChan.AI.SupportedMeasTypes", 0x2FDB: "PhysicalChan.CO.SupportedOutputTypes"},
    ),
    # Calibration
    *_number("CalInfo", UINT32, {0x1860: "SelfCal.Supported"}),
    *_number(
        "CalInfo", FLOAT64, {0x1864: "SelfCal.LastTemp", 0x1867: "ExtCal.LastTemp", 0x223B: "Cal.DevTemp"}
    ),
    *_text("CalInfo", {0x1861: "Cal.UserDefinedInfo"}),
    # Channels
    *_number(
        "Chan",
        INT32,
        {
            0x187F: "ChanType",
            0x695: "AI.MeasType",
            0x1764: "AI.ResolutionUnits",
            0x50: "AI.RawSampJustification",
            0x1094: "AI.Voltage.Units",
            0x18B5: "CO.OutputType",
            0x294: "CO.OutputState",
            0x18D6: "CO.Pulse.Time.Units",
        },
    ),
    *_number(
        "Chan",
        INT32,
        {0x1097: "AI.TermCfg", 0x64: "AI.Coupling", 0x1170: "CO.Pulse.IdleState", 0x1821: "AI.DataXferMech"},
        settable=True,
    ),
    *_text("Chan", {0x18F5: "PhysicalChanName", 0x1926: "ChanDescr"}),
    *_text("Chan", {0x18E1: "CO.Pulse.Term", 0x339: "CO.CtrTimebaseSrc"}, settable=True),
    *_number("Chan", FLOAT64, {0x17DD: "AI.Max", 0x17DE: "AI.Min"}, settable=True),
    *_number(
        "Chan",
        FLOAT64,
        {
            0x1765: "AI.Resolution",
            0x1815: "AI.Rng.High",
            0x1816: "AI.Rng.Low",
            0x1818: "AI.Gain",
            0x18C2: "CO.CtrTimebaseRate",
        },
    ),
    *_number(
        "Chan",
        FLOAT64,
        {0x18BA: "CO.Pulse.HighTime", 0x18BB: "CO.Pulse.LowTime", 0x18BC: "CO.Pulse.Time.InitialDelay"},
        settable=True,
    ),
    *_number(
        "Chan",
        UINT32,
        {0x22DA: "AI.RawSampSize", 0x190E: "CO.PulseDone", 0x2304: "ChanIsGlobal", 0x293: "CO.Count"},
    ),
    *_array("Chan", FLOAT64, {0x1930: "AI.DevScalingCoeff"}),
    # Timing
    *_number("Timing", FLOAT64, {0x1344: "SampClk.Rate", 0x1315: "RefClk.Rate"}, settable=True),
    *_number("Timing", FLOAT64, {0x22C8: "SampClk.MaxRate", 0x1303: "SampClk.Timebase.Rate"}),
    *_number(
        "Timing",
        INT32,
        {0x1300: "SampQuant.SampMode", 0x1347: "SampTimingType", 0x1301: "SampClk.ActiveEdge"},
        settable=True,
    ),
    *_number("Timing", UINT64, {0x1310: "SampQuant.SampPerChan"}, settable=True),
    *_number("Timing", UINT32, {0x2A26: "SampTimingEngine"}, settable=True),
    *_number("Timing", UINT32, {0x18EB: "SampClk.TimebaseDiv"}),
    *_text("Timing", {0x1316: "RefClk.Src", 0x1852: "SampClk.Src"}, settable=True),
    *_text("Timing", {0x2F1B: "SampClk.Term", 0x1308: "SampClk.Timebase.Src"}),
    # Triggers
    *_number(
        "Trig",
        INT32,
        {
            0x1419: "RefTrig.Type",
            0x1423: "AnlgEdge.RefTrig.Slope",
            0x1393: "StartTrig.Type",
            0x1404: "DigEdge.StartTrig.Edge",
        },
        settable=True,
    ),
    *_text("Trig", {0x1424: "AnlgEdge.RefTrig.Src", 0x1407: "DigEdge.StartTrig.Src"}, settable=True),
    *_text("Trig", {0x2F1F: "RefTrig.Term", 0x2F1E: "StartTrig.Term"}),
    *_number(
        "Trig", FLOAT64, {0x1422: "AnlgEdge.RefTrig.Lvl", 0x1421: "AnlgEdge.RefTrig.Hyst"}, settable=True
    ),
    *_number(
        "Trig", UINT32, {0x1445: "RefTrig.PretrigSamples", 0x190F: "StartTrig.Retriggerable"}, settable=True
    ),
    # Reading and buffers
    *_number(
        "Read",
        UINT32,
        {
            0x1223: "Read.AvailSampPerChan",
            0x217B: "Read.NumChans",
            0x217A: "Read.RawDataWidth",
            0x31E8: "Read.DefaultNumSamps",
            0x2174: "Read.OverloadedChansExist",
        },
    ),
    *_number("Read", UINT32, {0x1826: "Read.AutoStart", 0x1215: "Read.ReadAllAvailSamp"}, settable=True),
    *_number("Read", UINT64, {0x192A: "Read.TotalSampPerChanAcquired", 0x1221: "Read.CurrReadPos"}),
    *_text("Read", {0x2175: "Read.OverloadedChans"}),
    *_number("Buffer", UINT32, {0x186C: "Buf.Input.BufSize"}, settable=True),
    *_number("Buffer", UINT32, {0x230A: "Buf.Input.OnbrdBufSize"}),
    # Watchdog
    *_number("Watchdog", FLOAT64, {0x21A9: "Watchdog.Timeout"}, settable=True),
    *_number("Watchdog", UINT32, {0x21A8: "Watchdog.HasExpired"}),
    *_number("Watchdog", INT32, {0x3060: "Watchdog.CO.ExpirState"}, settable=True),
]

ATTRIBUTES: Mapping[int, Attribute] = MappingProxyType({entry.number: entry for entry in _TABLE})
"""By number; booleans are 32-bit numbers as in C."""
