"""Series of stored quantities over the hours of the test, one per figure."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import accumulate

from daq_service.cli.maintenance.acceptance.evidence import Evidence
from daq_service.cli.maintenance.acceptance.quantity import Series
from daq_service.cli.maintenance.acceptance.readings import (
    NO_TIME,
    NOT_AVAILABLE,
    NOT_KEPT,
    list_readings,
    list_set_times,
    select_readings,
    sum_stage_times_s,
)
from daq_service.cli.maintenance.acceptance.sets import build_record_count_series


def yield_series(evidence: Evidence) -> Iterator[Series]:
    """Yield the series of the report over the hours of the test, those without data with a reason.

    Records per set, start delay, duration, processing time (s), memory, file handles, free space, size of the
    files (bytes), and deviation of the clock (s).
    """
    yield build_record_count_series(evidence)
    times, real = list_set_times(evidence), evidence.experiment.clock == "wall"
    hours, late, took = ([one[k] for one in times] for k in range(3))
    if not real:
        yield Series("start_delay_s", (), (), NO_TIME)
    else:
        yield Series("start_delay_s", hours, late, "no set has started")
    yield Series("set_duration_s", hours, took, "no set has ended")
    machine_readings = list_readings(evidence)
    hours = [reading.hour for reading in machine_readings]
    stages = [reading.payload["stage_s"] for reading in machine_readings]
    fsync_s = [stage.get("fsync_s", 0.0) + stage.get("directory_fsync_s", 0.0) for stage in stages]
    costs_s = [sum_stage_times_s(reading) for reading in machine_readings]
    yield Series("line_cost_s", hours, costs_s, NOT_KEPT, {"fsync": (hours, fsync_s)})
    missing = NOT_AVAILABLE if machine_readings else NOT_KEPT
    for name in ("resident_bytes", "open_handles", "free_bytes"):
        yield Series(name, *_select_hours_and_values(evidence, name), missing)
    due_h = {due.set_index: due.due_h for due in evidence.planned}
    files = [(due_h[index], size) for index, size in sorted(evidence.file_bytes.items()) if index in due_h]
    hours = [hour for hour, _ in files]
    forecast = [(number + 1) * evidence.forecast_bytes for number in range(len(files))]
    yield Series(
        "files_bytes",
        hours,
        list(accumulate(size for _, size in files)),
        "no set has a file yet",
        {"forecast": (hours, forecast)},
        steps=True,
    )
    yield Series(
        "clock_ahead_s", *_select_hours_and_values(evidence, "clock_ahead_s"), NOT_KEPT if real else NO_TIME
    )


def _select_hours_and_values(evidence: Evidence, name: str) -> tuple[list[float], list[float]]:
    """Return the hours and values of the readings that have a value of this name, in set order."""
    found = select_readings(evidence, name)
    return [reading.hour for reading, _ in found], [value for _, value in found]
