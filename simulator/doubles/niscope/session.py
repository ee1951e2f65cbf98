"""Session of the NI-SCOPE double: its settings, and the calls that only read or set them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.doubles.chassis.scopes import SAMPLE_BITS, ScopeParameters
from simulator.doubles.niscope.records import RecordShape
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.statuses import ScopeStatus

FETCH_RELATIVE_TO, FETCH_OFFSET, FETCH_RECORD, FETCH_RECORDS = 1150077, 1150078, 1150079, 1150080
PRETRIGGER = 477
_FETCH_DEFAULTS = {FETCH_RELATIVE_TO: PRETRIGGER, FETCH_OFFSET: 0, FETCH_RECORD: 0, FETCH_RECORDS: -1}

Arguments = Mapping[str, Any]
Answer = Mapping[str, Any]


@dataclass(slots=True)
class Channel:
    """Settings of one input."""

    enabled: bool = True
    range_pp_v: float = 10.0
    offset_v: float = 0.0
    input_impedance_ohm: float = 1e6


@dataclass(slots=True, eq=False)
class Acquisition:
    """Acquisition between initiate and abort."""

    done_s: float
    """When the last record is complete; infinite if nothing triggers."""
    position: str
    shape: RecordShape
    first_firing_s: float
    codes: NDArray[np.int32] | None = None


@dataclass(slots=True, eq=False)
class Session:
    """Open session and the state of its board."""

    handle: int
    client: str
    board: ScopeParameters
    channels: dict[str, Channel]
    rate_hz: float = 100e6
    samples: int = 1000
    records: int = 1
    trigger_source: str = "VAL_IMMEDIATE"
    trigger_level_v: float = 0.0
    trigger_delay_s: float = 0.0
    fetch: dict[int, int] = field(default_factory=lambda: dict(_FETCH_DEFAULTS))
    acquisition: Acquisition | None = None
    last_error: tuple[int, str] = (0, "")


_SESSION_VALUES: Mapping[int, Callable[[Session], float | int | str]] = {
    1050203: lambda s: len(s.channels),
    1050512: lambda s: s.board.product,
    1050551: lambda s: "Driver: niScope 25.0.0 (solimon double)",
    1150001: lambda s: s.records,
    1150005: lambda s: SAMPLE_BITS,
    1150102: lambda s: s.board.resolution_bits,
    1150104: lambda s: s.board.serial_text,
    1250008: lambda s: s.samples,
    1250010: lambda s: s.rate_hz,
    1250013: lambda s: s.trigger_source,
}
_CHANNEL_VALUES: Mapping[int, str] = {
    1250001: "range_pp_v",
    1250002: "offset_v",
    1250005: "enabled",
    1250103: "input_impedance_ohm",
}


def require_idle(session: Session) -> None:
    """Raise ScopeStatus if the session has an acquisition that is not aborted, complete or not."""
    if session.acquisition is not None:
        raise ScopeStatus(statuses.SCOPE_ACQUISITION_IN_PROGRESS)


def get_attribute(session: Session, arguments: Arguments) -> Answer:
    """Answer with the value of an attribute of the session or of the channels named.

    Raise ScopeStatus if the channels differ in it or are unknown, or the double does not have it.
    """
    number = arguments["attribute_id"]
    if number in _SESSION_VALUES:
        return {"value": _SESSION_VALUES[number](session)}
    if number in session.fetch:
        return {"value": session.fetch[number]}
    if number in _CHANNEL_VALUES:
        values = {getattr(channel, _CHANNEL_VALUES[number]) for _, channel in channels_of(session, arguments)}
        if len(values) != 1:
            raise ScopeStatus(statuses.SCOPE_INVALID_VALUE, "the channels differ; ask for one of them")
        return {"value": values.pop()}
    raise ScopeStatus(statuses.SCOPE_ATTRIBUTE_NOT_SUPPORTED, f"attribute {number}")


def set_attribute(session: Session, arguments: Arguments) -> None:
    """Set an attribute of the session or of the channels named.

    Fetch attributes can be set while an acquisition runs; others raise ScopeStatus then, as does one that the
    double does not have or that is read-only, and an unknown channel.
    """
    number, value = arguments["attribute_id"], arguments["value"]
    if number in session.fetch:
        session.fetch[number] = value
        return
    require_idle(session)
    if number in _CHANNEL_VALUES:
        for _, channel in channels_of(session, arguments):
            name = _CHANNEL_VALUES[number]
            setattr(channel, name, type(getattr(channel, name))(value))
        return
    raise ScopeStatus(statuses.SCOPE_ATTRIBUTE_NOT_SUPPORTED, f"attribute {number}")


def channels_of(session: Session, arguments: Arguments) -> list[tuple[str, Channel]]:
    """Return the channels, with their names, of the comma-separated ``channel_list``; all for an empty list.

    Raise ScopeStatus if one is unknown.
    """
    wanted = [name.strip() for name in arguments["channel_list"].split(",") if name.strip()]
    for name in wanted:
        if name not in session.channels:
            raise ScopeStatus(statuses.SCOPE_UNKNOWN_CHANNEL, repr(name))
    return [(name, session.channels[name]) for name in wanted or session.channels]


def list_channel_names(session: Session, arguments: Arguments) -> Answer:
    """Answer with the comma-separated names of the channels of comma-separated indices.

    Raise ScopeStatus for a wrong index.
    """
    names = list(session.channels)
    try:
        return {"names": ",".join(names[int(index)] for index in arguments["indices"].split(","))}
    except (ValueError, IndexError):
        raise ScopeStatus(statuses.SCOPE_INVALID_VALUE, f"indices {arguments['indices']!r}") from None


def configure_vertical(session: Session, arguments: Arguments) -> None:
    """Set range in V (peak to peak, coerced up), offset in V and enabling of channels.

    Raise ScopeStatus for too large a range, an unknown channel, or while an acquisition runs.
    """
    require_idle(session)
    range_v = session.board.coerced_range_v(0.5 * arguments["range"])
    if range_v is None:
        raise ScopeStatus(statuses.SCOPE_INVALID_VALUE, f"vertical range {arguments['range']} V")
    for _, channel in channels_of(session, arguments):
        channel.range_pp_v = 2.0 * range_v
        channel.offset_v = arguments["offset"]
        channel.enabled = bool(arguments["enabled"])


def configure_input(session: Session, arguments: Arguments) -> None:
    """Set the input impedance of channels, 50 ohm or 1 Mohm; the maximum frequency is ignored.

    Raise ScopeStatus for other impedances, an unknown channel, or while an acquisition runs.
    """
    require_idle(session)
    if arguments["input_impedance"] not in (50.0, 1e6):
        raise ScopeStatus(statuses.SCOPE_INVALID_VALUE, f"input impedance {arguments['input_impedance']} ohm")
    for _, channel in channels_of(session, arguments):
        channel.input_impedance_ohm = arguments["input_impedance"]


def configure_horizontal_timing(session: Session, arguments: Arguments) -> None:
    """Set sample rate in Hz (coerced up), samples per record, and number of records.

    Raise ScopeStatus for invalid ones or reference positions, too many samples for the memory, or while an
    acquisition runs.
    """
    require_idle(session)
    rate_hz = session.board.coerced_rate_hz(arguments["min_sample_rate"])
    samples, records = arguments["min_num_pts"], arguments["num_records"]
    if rate_hz is None or samples < 1 or records < 1 or not 0.0 <= arguments["ref_position"] <= 100.0:
        raise ScopeStatus(statuses.SCOPE_INVALID_VALUE, "horizontal timing")
    if samples * records > session.board.memory_samples:
        raise ScopeStatus(statuses.SCOPE_INSUFFICIENT_MEMORY, f"{records} records of {samples} samples")
    session.rate_hz, session.samples, session.records = rate_hz, samples, records


def configure_trigger(session: Session, arguments: Arguments) -> None:
    """Set an analog or digital edge as the reference trigger: source, delay in s and, if given, level in V.

    The source is not checked. Raise ScopeStatus while an acquisition runs.
    """
    require_idle(session)
    session.trigger_source = arguments["trigger_source"]
    session.trigger_delay_s = arguments["delay"]
    session.trigger_level_v = arguments.get("level", session.trigger_level_v)


CONFIGURATION: Mapping[str, Callable[[Session, Arguments], Answer | None]] = {
    "GetAttributeViInt32": get_attribute,
    "GetAttributeViReal64": get_attribute,
    "GetAttributeViString": get_attribute,
    "SetAttributeViBoolean": set_attribute,
    "SetAttributeViInt32": set_attribute,
    "GetChannelNameFromString": list_channel_names,
    "ConfigureVertical": configure_vertical,
    "ConfigureChanCharacteristics": configure_input,
    "ConfigureHorizontalTiming": configure_horizontal_timing,
    "ConfigureTriggerEdge": configure_trigger,
    "ConfigureTriggerDigital": configure_trigger,
}
"""Entries that concern a session alone, by name without prefix."""
