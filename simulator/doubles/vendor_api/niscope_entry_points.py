"""Entry points of the NI-SCOPE library, in the same table as those of NI-DAQmx.

Names and order of the parameters are those of NI's header ``niScope.h``, which the `niscope` package
calls; a test compares the two. What the package can call but no driver of ours needs is left out.
"""

from __future__ import annotations

from simulator.doubles.vendor_api.entry_points import (
    BYTE,
    FLOAT64,
    INT16,
    INT32,
    UINT16,
    UINT32,
    EntryPoint,
    Parameter,
    out,
    out_array,
    out_text,
    text,
    unused,
    value,
)

LIBRARY = "niScope"

VI = value("vi", UINT32)
CHANNELS = text("channel_list")
BOOLEAN = UINT16

UNBOUNDED = "UINT32_MAX"
"""Room of an array whose length the caller has asked for before (``niScope_ActualNumWfms``)."""
MESSAGE_ROOM = "256"
"""Room of a message as the header fixes it."""

WAVEFORM_INFO = "<dddi4xdddd"
"""`struct` layout of one ``niScope_wfmInfo``: absolute and relative initial x, x increment, actual samples,
offset, gain, two reserved."""

ATTRIBUTE = (VI, CHANNELS, value("attribute_id", UINT32))


def _entry(name: str, *parameters: Parameter) -> EntryPoint:
    return EntryPoint(f"niScope_{name}", parameters, library=LIBRARY)


NISCOPE_ENTRY_POINTS: tuple[EntryPoint, ...] = (
    _entry(
        "SetRuntimeEnvironment",
        text("environment"),
        text("environment_version"),
        text("reserved1"),
        text("reserved2"),
    ),
    _entry(
        "InitWithOptions",
        text("resource_name"),
        value("id_query", BOOLEAN),
        value("reset_device", BOOLEAN),
        text("option_string"),
        out("vi", UINT32),
    ),
    _entry("close", VI),
    _entry("LockSession", VI, unused("caller_has_lock")),
    _entry("UnlockSession", VI, unused("caller_has_lock")),
    _entry(
        "GetError", VI, out("error_code", INT32), value("buffer_size"), out_text("description", "buffer_size")
    ),
    _entry("error_message", VI, value("error_code"), out_text("error_message", MESSAGE_ROOM)),
    _entry(
        "GetChannelNameFromString",
        VI,
        text("indices"),
        value("buffer_size"),
        out_text("names", "buffer_size"),
    ),
    _entry("GetAttributeViInt32", *ATTRIBUTE, out("value", INT32)),
    _entry("GetAttributeViReal64", *ATTRIBUTE, out("value", FLOAT64)),
    _entry("GetAttributeViString", *ATTRIBUTE, value("buf_size"), out_text("value", "buf_size")),
    _entry("SetAttributeViBoolean", *ATTRIBUTE, value("value", BOOLEAN)),
    _entry("SetAttributeViInt32", *ATTRIBUTE, value("value", INT32)),
    _entry(
        "ConfigureVertical",
        VI,
        CHANNELS,
        value("range", FLOAT64),
        value("offset", FLOAT64),
        value("coupling"),
        value("probe_attenuation", FLOAT64),
        value("enabled", BOOLEAN),
    ),
    _entry(
        "ConfigureChanCharacteristics",
        VI,
        CHANNELS,
        value("input_impedance", FLOAT64),
        value("max_input_frequency", FLOAT64),
    ),
    _entry(
        "ConfigureHorizontalTiming",
        VI,
        value("min_sample_rate", FLOAT64),
        value("min_num_pts"),
        value("ref_position", FLOAT64),
        value("num_records"),
        value("enforce_realtime", BOOLEAN),
    ),
    _entry(
        "ConfigureTriggerEdge",
        VI,
        text("trigger_source"),
        value("level", FLOAT64),
        value("slope"),
        value("trigger_coupling"),
        value("holdoff", FLOAT64),
        value("delay", FLOAT64),
    ),
    _entry(
        "ConfigureTriggerDigital",
        VI,
        text("trigger_source"),
        value("slope"),
        value("holdoff", FLOAT64),
        value("delay", FLOAT64),
    ),
    _entry("Commit", VI),
    _entry("InitiateAcquisition", VI),
    _entry("Abort", VI),
    _entry("ActualNumWfms", VI, CHANNELS, out("num_wfms", INT32)),
    # Samples of all records one after the other, and one ``niScope_wfmInfo`` a record.
    _entry(
        "FetchBinary16",
        VI,
        CHANNELS,
        value("timeout", FLOAT64),
        value("num_samples"),
        out_array("waveform", INT16, UNBOUNDED),
        out_array("wfm_info", BYTE, UNBOUNDED),
    ),
    _entry("ResetDevice", VI),
    _entry(
        "CalFetchDate",
        VI,
        value("which_one"),
        out("year", INT32),
        out("month", INT32),
        out("day", INT32),
    ),
    _entry("CalFetchTemperature", VI, value("which_one"), out("temperature", FLOAT64)),
    _entry("CalSelfCalibrate", VI, CHANNELS, value("option")),
)
"""In the order in which a session uses them."""
