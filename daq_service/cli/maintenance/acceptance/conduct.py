"""Quantities of the recorder: starts, delays, durations, memory, handles, disk and clock."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence

from daq_service.catalogue.rows import EventRow
from daq_service.cli.maintenance.acceptance.evidence import Evidence
from daq_service.cli.maintenance.acceptance.faults import list_faults
from daq_service.cli.maintenance.acceptance.quantity import (
    CONFIDENCE,
    FEWEST_READINGS,
    WARM_UP,
    WARM_UP_SETS,
    Quantity,
    Table,
    compute_quantile,
    estimate_growth,
    make_quantity,
)
from daq_service.cli.maintenance.acceptance.readings import (
    NO_TIME,
    NOT_AVAILABLE,
    NOT_KEPT,
    list_readings,
    list_set_times,
    select_readings,
    sum_stage_times_s,
)
from daq_service.processes.recorder_state import FAREWELLS, PROCESS_EVENTS
from daq_service.recording.resumed_time import CLOCK_STEP

QUANTILES: Mapping[str, Callable[[Sequence[float]], float]] = {
    "p50": lambda values: compute_quantile(values, 0.50),
    "p99": lambda values: compute_quantile(values, 0.99),
    "max": max,
}


def list_recorder_starts(evidence: Evidence) -> list[tuple[EventRow, EventRow | None]]:
    """List the starts of the recorder in order, each with the process event before it.

    That is an orderly end or, after a crash, an earlier start; None for the first start.
    """
    events = [row for row in evidence.service if row.kind in PROCESS_EVENTS]
    following = zip([None, *events], events, strict=False)
    return [(row, before) for before, row in following if row.kind == "recorder_started"]


def build_restart_table(evidence: Evidence) -> Table:
    """Build the table of the recorder's starts except the first: hour, previous end, state before.

    The previous end is the kind of its event, "no word" after a crash.
    """
    rows = [
        (
            evidence.hour(row.utc_ns),
            "no word" if before is None or before.kind not in FAREWELLS else before.kind,
            row.payload.get("before", ""),
        )
        for row, before in list_recorder_starts(evidence)[1:]
    ]
    return Table("restarts", rows)


def compute_recorder_quantities(evidence: Evidence) -> Iterator[Quantity]:
    """Yield the quantities of the recorder: time span in h, restarts and unplanned ends.

    A recorder that does not respond now counts as an unplanned end, unless the folder is a copy.
    """
    recorder_starts = list_recorder_starts(evidence)
    n_crashes = sum(before is not None and before.kind not in FAREWELLS for _, before in recorder_starts)
    is_gone = (
        evidence.recorder.status in ("not_responding", "not_started")
        and not evidence.is_copy
        and bool(recorder_starts)
    )
    yield make_quantity("span_h", evidence.hour(evidence.now_ns))
    yield make_quantity("restarts", max(0, len(recorder_starts) - 1))
    yield make_quantity("unplanned_ends", n_crashes + is_gone)


def _compute_quantiles(
    name: str, values: Sequence[float], missing: str, *, applies: bool = True
) -> Iterator[Quantity]:
    """Yield the quantities ``NAME_p50_s``, ``NAME_p99_s`` and ``NAME_max_s`` of values in s.

    Without values they have only the reason ``missing``; ``applies`` as in `Quantity`.
    """
    for part, function in QUANTILES.items():
        yield make_quantity(
            f"{name}_{part}_s", function(values) if values else None, missing, applies=applies
        )


def compute_time_quantities(evidence: Evidence) -> Iterator[Quantity]:
    """Yield the quantiles of start delays and durations of sets, and of processing times, all in s.

    Start delays do not apply to a test in simulated time.
    """
    real, times = evidence.experiment.clock == "wall", list_set_times(evidence)
    if real:
        yield from _compute_quantiles("start_delay", [late for _, late, _ in times], "no set has started")
    else:
        yield from _compute_quantiles("start_delay", [], NO_TIME, applies=False)
    yield from _compute_quantiles("set_duration", [took for _, _, took in times], "no set has ended")
    yield from _compute_quantiles(
        "line_cost", [sum_stage_times_s(reading) for reading in list_readings(evidence)], NOT_KEPT
    )


def compute_growth_quantities(evidence: Evidence, name: str) -> Iterator[Quantity]:
    """Yield the maximum of a machine reading and its slope per 1,000 sets with a 95 % interval.

    The slope is that of the recorder process with most readings, without its warm-up; it has no value with
    fewer than `FEWEST_READINGS`. ``name`` is a key of the readings; raises KeyError if one lacks it.
    """
    readings_of_name = select_readings(evidence, name)
    missing = NOT_AVAILABLE if list_readings(evidence) else NOT_KEPT
    yield make_quantity(f"{name}_max", max((value for _, value in readings_of_name), default=None), missing)
    runs: defaultdict[tuple[int, int], list[tuple[int, float]]] = defaultdict(list)
    for reading, value in readings_of_name:
        runs[reading.recorder].append((reading.set_index, value))
    longest = max(runs.values(), key=len, default=[])
    longest = longest[max(WARM_UP_SETS, round(WARM_UP * len(longest))) :]
    grown = estimate_growth([index for index, _ in longest], [value for _, value in longest])
    few = f"undecided: {len(longest)} readings; {FEWEST_READINGS} are needed"
    yield make_quantity(
        f"{name}_growth",
        None if grown is None else grown.slope,
        few if readings_of_name else missing,
        (None, None) if grown is None else (grown.low, grown.high),
        confidence=CONFIDENCE,
        warm_up_sets=WARM_UP_SETS,
        readings=len(longest),
    )


def compute_disk_quantities(evidence: Evidence) -> Iterator[Quantity]:
    """Yield size and growth (per 1,000 sets) of the files, ratio to the forecast, least free space; bytes."""
    sizes, forecast_bytes = list(evidence.file_bytes.values()), evidence.forecast_bytes
    mean, missing = (sum(sizes) / len(sizes) if sizes else None), "no set has a file yet"
    over_forecast = None if mean is None else mean / forecast_bytes
    free = min((value for _, value in select_readings(evidence, "free_bytes")), default=None)
    yield make_quantity("files_bytes", sum(sizes), files=len(sizes))
    yield make_quantity("growth_bytes", None if mean is None else 1e3 * mean, missing)
    yield make_quantity("growth_of_forecast", over_forecast, missing, forecast_bytes=forecast_bytes)
    yield make_quantity("free_bytes_min", free, NOT_KEPT)


def compute_clock_quantities(evidence: Evidence) -> Iterator[Quantity]:
    """Yield clock steps (number, largest in s), doubts, largest deviation (s) and synchronized fraction.

    Steps are those of the computer's UTC, doubts the alarms ``clock_unverified``, deviations those of UTC
    from the test time. None of them applies to a test in simulated time.
    """
    real = evidence.experiment.clock == "wall"
    steps = [abs(row.payload["step_s"]) for row in evidence.service if row.kind == CLOCK_STEP]
    doubts = sum(fault.kind == "clock_unverified" for fault in list_faults(evidence))
    for name, value in (
        ("clock_steps", len(steps)),
        ("clock_step_max_s", max(steps, default=0.0)),
        ("clock_doubts", doubts),
    ):
        yield make_quantity(name, value if real else None, NO_TIME, applies=real)
    ahead = [abs(value) for _, value in select_readings(evidence, "clock_ahead_s")]
    known = [value for _, value in select_readings(evidence, "clock_synchronised")]
    for name, value_if_known in (
        ("clock_ahead_max_s", max(ahead, default=None)),
        ("clock_synchronised_fraction", sum(known) / len(known) if known else None),
    ):
        yield make_quantity(name, value_if_known, NOT_KEPT if real else NO_TIME, applies=real)
