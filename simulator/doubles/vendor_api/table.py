"""Table of the entry points of every library by C name, for the wire and the device model."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from simulator.doubles.vendor_api.entry_points import ENTRY_POINTS as DAQMX_ENTRY_POINTS
from simulator.doubles.vendor_api.entry_points import EntryPoint
from simulator.doubles.vendor_api.niscope_entry_points import NISCOPE_ENTRY_POINTS

TABLE: Mapping[str, EntryPoint] = MappingProxyType(
    {**DAQMX_ENTRY_POINTS, **{entry.name: entry for entry in NISCOPE_ENTRY_POINTS}}
)


def of_library(library: str) -> tuple[EntryPoint, ...]:
    """Return the entries that one library exports."""
    return tuple(entry for entry in TABLE.values() if entry.library == library)
