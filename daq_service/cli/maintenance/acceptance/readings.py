"""Machine readings that the recorder stores with each set, and the times of sets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from daq_service.cli.maintenance.acceptance.evidence import Evidence
from daq_service.recording.computer_load import MACHINE_READ
from hardware_drivers.nanoseconds import NS_PER_S

NOT_KEPT = "not kept by the solimon that recorded this test; recorders keep it since 0.1.0"
NO_TIME = "not measured in simulated time"
NOT_AVAILABLE = "unknown: this system does not report it"


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """A machine reading at its set."""

    set_index: int
    hour: float
    payload: Mapping[str, Any]

    @property
    def recorder(self) -> tuple[int, int]:
        """Return process id and start time (ns of UTC), which identify the recorder process."""
        return self.payload["process"], self.payload["recorder_wall_utc_ns"]


def list_readings(evidence: Evidence) -> list[Reading]:
    """Return the machine readings that belong to a set, in the order of their sets."""
    found = [
        Reading(set_index=row.set_index, hour=evidence.hour(row.utc_ns), payload=row.payload)
        for row in evidence.machine
        if row.kind == MACHINE_READ and row.set_index is not None
    ]
    return sorted(found, key=lambda reading: reading.set_index)


def select_readings(evidence: Evidence, name: str) -> list[tuple[Reading, float]]:
    """List the readings that have a value of this name, each with the value, in the order of their sets.

    Raises KeyError if a reading has no such key.
    """
    return [
        (reading, reading.payload[name])
        for reading in list_readings(evidence)
        if reading.payload[name] is not None
    ]


def sum_stage_times_s(reading: Reading) -> float:
    """Return the wall time in s that a set took after striking: extraction, storage, assessment, commit."""
    return float(sum(s for stage, s in reading.payload["stage_s"].items() if stage != "strike_and_read_s"))


def list_set_times(evidence: Evidence) -> list[tuple[float, float, float]]:
    """Return the due hour, the start delay in s and the duration in s of each set that has ended.

    In the order of the set indices, one entry per set.
    """
    found = {}
    for row in evidence.sets:
        if row.started_utc_ns is not None and row.ended_utc_ns is not None:
            found[row.set_index] = (
                row.due_h,
                (row.started_utc_ns - row.due_utc_ns) / NS_PER_S,
                (row.ended_utc_ns - row.started_utc_ns) / NS_PER_S,
            )
    return [found[index] for index in sorted(found)]
