"""Every number that was kept over the hours of the test, for a picture each."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import accumulate

from daq_service.cli.keeping.certify.evidence import Evidence
from daq_service.cli.keeping.certify.quantity import Series
from daq_service.cli.keeping.certify.readings import (
    NO_TIME,
    NOT_KEPT,
    NOT_TOLD,
    cost_s,
    kept,
    readings,
    times_of_sets,
)
from daq_service.cli.keeping.certify.sets import record_series


def series_of(evidence: Evidence) -> Iterator[Series]:
    """Give one for each thing that was kept."""
    yield record_series(evidence)
    times, real = times_of_sets(evidence), evidence.experiment.clock == "wall"
    hours = [hour for hour, _, _ in times]
    yield Series(
        name="start_delay_s",
        title="Start of each set after it was due",
        unit="s",
        how="started_utc_ns - due_utc_ns",
        hours=hours if real else (),
        values=[late for _, late, _ in times] if real else (),
        missing="" if real and times else "no set has begun" if real else NO_TIME,
    )
    yield Series(
        name="set_duration_s",
        title="Duration of each set",
        unit="s",
        how="ended_utc_ns - started_utc_ns, in the test's time",
        hours=hours,
        values=[took for _, _, took in times],
        missing="" if times else "no set has ended",
    )
    told = readings(evidence)
    missing = "" if told else NOT_KEPT
    yield Series(
        name="line_cost_s",
        title="Wall time of the line a set",
        unit="s",
        how="extracting, storing, judging and committing; of it fsync beside",
        hours=[reading.hour for reading in told],
        values=[cost_s(reading) for reading in told],
        others={
            "fsync": (
                [reading.hour for reading in told],
                [
                    reading.told["stage_s"].get("fsync_s", 0.0)
                    + reading.told["stage_s"].get("directory_fsync_s", 0.0)
                    for reading in told
                ],
            )
        },
        missing=missing,
    )
    for name, title, unit in (
        ("resident_bytes", "Memory of the recorder", "B"),
        ("open_handles", "Open handles of the recorder", "1"),
        ("free_bytes", "Free on the volume", "B"),
    ):
        found = kept(evidence, name)
        yield Series(
            name=name,
            title=title,
            unit=unit,
            how=f"{name} at the end of each set",
            hours=[reading.hour for reading, _ in found],
            values=[value for _, value in found],
            missing="" if found else missing or NOT_TOLD,
        )
    due_h = {due.set_index: due.due_h for due in evidence.planned}
    files = [(due_h[index], size) for index, size in sorted(evidence.file_bytes.items()) if index in due_h]
    yield Series(
        name="files_bytes",
        title="Files of the sets, together",
        unit="B",
        how="running sum of their sizes; beside it the forecast of check-config for whole sets",
        hours=[hour for hour, _ in files],
        values=list(accumulate(size for _, size in files)),
        others={
            "forecast": (
                [hour for hour, _ in files],
                [(number + 1) * evidence.forecast_bytes for number in range(len(files))],
            )
        },
        steps=True,
        missing="" if files else "no set has a file yet",
    )
    ahead = kept(evidence, "clock_ahead_s")
    yield Series(
        name="clock_ahead_s",
        title="Computer's UTC less the test's time",
        unit="s",
        how="clock_ahead_s at the end of each set",
        hours=[reading.hour for reading, _ in ahead],
        values=[value for _, value in ahead],
        missing="" if ahead else NO_TIME if not real else NOT_KEPT,
    )
