"""A recording of a few shots, held in memory."""

from __future__ import annotations

from collections.abc import Iterable

from hardware_drivers.measurement import PulseEchoRecord
from hardware_drivers.playback.source import Record, ShotsBySet


def shots_in_memory(records: Iterable[Record]) -> ShotsBySet:
    """Return these records as a recording."""
    held = list(records)
    positions = {
        record.key.position: "pulse_echo" if isinstance(record, PulseEchoRecord) else "solitary_wave"
        for record in held
    }
    return ShotsBySet(positions, lambda set_key: [record for record in held if record.key.set_key == set_key])
