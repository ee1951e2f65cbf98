"""Quantities of the recorder: starts, delays, durations, memory, handles, disk and clock."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial

from daq_service.catalogue.rows import EventRow
from daq_service.cli.maintenance.acceptance.evidence import Evidence
from daq_service.cli.maintenance.acceptance.faults import faults
from daq_service.cli.maintenance.acceptance.quantity import (
    CONFIDENCE,
    FEWEST_READINGS,
    WARM_UP,
    WARM_UP_SETS,
    Quantity,
    Table,
    growth,
    quantile,
)
from daq_service.cli.maintenance.acceptance.readings import (
    NO_TIME,
    NOT_AVAILABLE,
    NOT_KEPT,
    cost_s,
    kept,
    readings,
    times_of_sets,
)
from daq_service.processes.recorder_state import FAREWELLS, PROCESS_EVENTS
from daq_service.recording.resumed_time import CLOCK_STEP

QUANTILES: Mapping[str, Callable[[Sequence[float]], float]] = {
    "p50": lambda values: quantile(values, 0.50),
    "p99": lambda values: quantile(values, 0.99),
    "max": max,
}


def starts(evidence: Evidence) -> list[tuple[EventRow, EventRow | None]]:
    """List the recorder's starts, each with the previous event: an orderly end, or an earlier start."""
    events = [row for row in evidence.service if row.kind in PROCESS_EVENTS]
    following = zip([None, *events], events, strict=False)
    return [(row, before) for before, row in following if row.kind == "recorder_started"]


def restart_table(evidence: Evidence) -> Table:
    """Return the table of all starts but the first."""
    rows = [
        (
            evidence.hour(row.utc_ns),
            "no word" if before is None or before.kind not in FAREWELLS else before.kind,
            row.payload.get("before", ""),
        )
        for row, before in starts(evidence)[1:]
    ]
    return Table(
        name="restarts",
        title="Restarts of the recorder",
        columns=("at (h)", "the recorder before left with", "what the new one found"),
        rows=rows,
    )


def recorder_quantities(evidence: Evidence) -> Iterator[Quantity]:
    """Yield time span, restarts and unplanned ends."""
    quantity, recorder_starts = partial(Quantity, "Recorder"), starts(evidence)
    n_crashes = sum(before is not None and before.kind not in FAREWELLS for _, before in recorder_starts)
    is_gone = (
        evidence.recorder.status in ("not_responding", "not_started")
        and not evidence.is_copy
        and bool(recorder_starts)
    )
    yield quantity(
        "span_h",
        "time that this report covers",
        "h",
        "from hour 0 to now, or to the last that is stored of a test that has ended or is simulated",
        evidence.hour(evidence.now_ns),
    )
    n_restarts = max(0, len(recorder_starts) - 1)
    yield quantity("restarts", "restarts", "1", "events recorder_started but the first", n_restarts)
    yield quantity(
        "unplanned_ends",
        "ends without a word: crash, kill, power",
        "1",
        "starts that no farewell of the recorder before precedes, and a last one that is silent now",
        n_crashes + is_gone,
    )


def quantiles(
    name: str,
    text: str,
    how: str,
    values: Sequence[float],
    missing: str,
    *,
    applies: bool = True,
) -> Iterator[Quantity]:
    """Yield median, 99th percentile and maximum of values in s."""
    for part, function in QUANTILES.items():
        definition = "largest" if part == "max" else f"smallest value that {part[1:]} % do not exceed"
        value = function(values) if values else None
        fields = (f"{name}_{part}_s", f"{text}, {part}", "s", f"{how}; {definition}")
        yield Quantity("Times", *fields, value, missing, applies=applies)


def time_quantities(evidence: Evidence) -> Iterator[Quantity]:
    """Yield start delays and durations of sets, and processing time."""
    real, times = evidence.experiment.clock == "wall", times_of_sets(evidence)
    yield from quantiles(
        "start_delay",
        "start of a set after it was due",
        "started_utc_ns - due_utc_ns",
        [late for _, late, _ in times] if real else [],
        "no set has begun" if real else NO_TIME,
        applies=real,
    )
    yield from quantiles(
        "set_duration",
        "duration of a set, in the test's time",
        "ended_utc_ns - started_utc_ns",
        [took for _, _, took in times],
        "no set has ended",
    )
    yield from quantiles(
        "line_cost",
        "wall time of the line a set, without strike and read",
        "sum of the reading's stage_s but strike_and_read_s",
        [cost_s(reading) for reading in readings(evidence)],
        NOT_KEPT,
    )


def growth_quantities(evidence: Evidence, name: str, text: str, unit: str) -> Iterator[Quantity]:
    """Yield the maximum of readings and their slope per 1,000 sets, of the longest run of a recorder."""
    quantity, readings_of_name = partial(Quantity, "Recorder"), kept(evidence, name)
    missing = NOT_AVAILABLE if readings(evidence) else NOT_KEPT
    maximum = max((value for _, value in readings_of_name), default=None)
    yield quantity(
        f"{name}_max", f"{text}, largest", unit, "largest reading at the end of a set", maximum, missing
    )
    runs: defaultdict[tuple[int, int], list[tuple[int, float]]] = defaultdict(list)
    for reading, value in readings_of_name:
        runs[reading.recorder].append((reading.set_index, value))
    longest = max(runs.values(), key=len, default=[])
    longest = longest[max(WARM_UP_SETS, round(WARM_UP * len(longest))) :]
    grown = growth([index for index, _ in longest], [value for _, value in longest])
    slope, low, high = (grown.slope, grown.low, grown.high) if grown else (None, None, None)
    few = f"undecided: {len(longest)} readings; {FEWEST_READINGS} are the fewest that tell"
    yield quantity(
        f"{name}_growth",
        f"{text}, growth a 1,000 sets",
        f"{unit} a 1,000 sets",
        f"median of all slopes (Theil, Sen) with its {CONFIDENCE:.0%} interval, of the recorder that "
        f"took the most sets, without its first fifth and first {WARM_UP_SETS}: {len(longest)} readings",
        slope,
        few if readings_of_name else missing,
        low,
        high,
    )


def disk_quantities(evidence: Evidence) -> Iterator[Quantity]:
    """Yield the size of the files, their growth against the forecast, and the free space."""
    quantity, sizes = partial(Quantity, "Disk"), list(evidence.file_bytes.values())
    mean, missing = (sum(sizes) / len(sizes) if sizes else None), "no set has a file yet"
    free = min((value for _, value in kept(evidence, "free_bytes")), default=None)
    yield quantity("files_bytes", "files of the sets", "B", f"sizes of {len(sizes)} files", sum(sizes))
    yield quantity(
        "growth_bytes",
        "growth a 1,000 sets",
        "B a 1,000 sets",
        "1,000 times the mean size of a set's file",
        None if mean is None else 1e3 * mean,
        missing,
    )
    yield quantity(
        "growth_of_forecast",
        "growth over the forecast of check-config",
        "1",
        f"mean size of a file / {evidence.forecast_bytes:.0f} B of one built in memory for a whole set",
        None if mean is None else mean / evidence.forecast_bytes,
        missing,
    )
    how = "smallest reading at the end of a set"
    yield quantity("free_bytes_min", "free on the volume, smallest", "B", how, free, NOT_KEPT)


def clock_quantities(evidence: Evidence) -> Iterator[Quantity]:
    """Yield steps, doubts, and the deviation of the computer's UTC from the test's time."""
    real = evidence.experiment.clock == "wall"
    quantity = partial(Quantity, "Clock", applies=real)
    steps = [abs(row.payload["step_s"]) for row in evidence.service if row.kind == CLOCK_STEP]
    doubts = sum(fault.kind == "clock_unverified" for fault in faults(evidence))
    ahead = [abs(value) for _, value in kept(evidence, "clock_ahead_s")]
    known = [value for _, value in kept(evidence, "clock_synchronised")]
    no = NOT_KEPT if real else NO_TIME
    yield quantity(
        "clock_steps",
        "steps of the computer's UTC",
        "1",
        "events clock_step; the test's time goes on by elapsed time",
        len(steps) if real else None,
        NO_TIME,
    )
    most_s, how = max(steps, default=0.0), "largest |step_s| of these events"
    yield quantity("clock_step_max_s", "largest step", "s", how, most_s if real else None, NO_TIME)
    yield quantity(
        "clock_doubts",
        "times that the clock was doubted",
        "1",
        "alarms clock_unverified",
        doubts if real else None,
        NO_TIME,
    )
    yield quantity(
        "clock_ahead_max_s",
        "computer's UTC off the test's time, largest",
        "s",
        "largest |clock_ahead_s| at the end of a set",
        max(ahead, default=None),
        no,
    )
    yield quantity(
        "clock_synchronised_fraction",
        "part of the sets at whose end the system knew its UTC to be synchronised",
        "1",
        "mean of clock_synchronised; systems that do not tell count as not",
        sum(known) / len(known) if known else None,
        no,
    )
