"""How the recorder did: starts, delays, costs, memory, handles, disk and clock."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from daq_service.catalogue.rows import EventRow
from daq_service.cli.keeping.certify.evidence import Evidence
from daq_service.cli.keeping.certify.faults import faults
from daq_service.cli.keeping.certify.quantity import (
    CONFIDENCE,
    FEWEST_READINGS,
    WARM_UP,
    WARM_UP_SETS,
    Quantity,
    Table,
    growth,
    quantile,
)
from daq_service.cli.keeping.certify.readings import (
    NO_TIME,
    NOT_KEPT,
    NOT_TOLD,
    cost_s,
    kept,
    readings,
    times_of_sets,
)
from daq_service.processes.recorder_state import FAREWELLS, TELLING
from daq_service.recording.resumed_time import CLOCK_STEP

QUANTILES: Mapping[str, Callable[[Sequence[float]], float]] = {
    "p50": lambda values: quantile(values, 0.50),
    "p99": lambda values: quantile(values, 0.99),
    "max": max,
}


def starts(evidence: Evidence) -> list[tuple[EventRow, EventRow | None]]:
    """List starts of a recorder, each with the word before it: a farewell, or a start that had none."""
    words = [row for row in evidence.service if row.kind in TELLING]
    following = zip([None, *words], words, strict=False)
    return [(row, before) for before, row in following if row.kind == "recorder_started"]


def restart_table(evidence: Evidence) -> Table:
    """Every start but the first one."""
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
        empty="none",
    )


def recorder_quantities(evidence: Evidence) -> Iterator[Quantity]:
    """Span, restarts and ends without a word."""
    section = "Recorder"
    begun = starts(evidence)
    died = sum(before is not None and before.kind not in FAREWELLS for _, before in begun)
    gone = evidence.recorder.word in ("silent", "absent") and not evidence.is_copy and bool(begun)
    last_h = evidence.hour(evidence.now_ns)
    yield Quantity(
        name="span_h",
        section=section,
        text="time that this certificate covers",
        unit="h",
        how="from hour 0 to now, or to the last that is stored of a test that has ended or is simulated",
        value=last_h,
    )
    yield Quantity(
        name="restarts",
        section=section,
        text="restarts",
        unit="1",
        how="events recorder_started but the first",
        value=max(0, len(begun) - 1),
    )
    yield Quantity(
        name="unplanned_ends",
        section=section,
        text="ends without a word: crash, kill, power",
        unit="1",
        how="starts that no farewell of the recorder before precedes, and a last one that is silent now",
        value=died + gone,
    )


def quantiles(
    name: str,
    section: str,
    text: str,
    how: str,
    values: Sequence[float],
    missing: str,
    *,
    applies: bool = True,
) -> Iterator[Quantity]:
    """Median, 99th percentile and largest of values in s."""
    for part, found in QUANTILES.items():
        yield Quantity(
            name=f"{name}_{part}_s",
            section=section,
            text=f"{text}, {part}",
            unit="s",
            how=f"{how}; {'largest' if part == 'max' else f'smallest value that {part[1:]} % do not exceed'}",
            value=found(values) if values else None,
            missing="" if values else missing,
            applies=applies,
        )


def time_quantities(evidence: Evidence) -> Iterator[Quantity]:
    """How late sets began, how long they took, what the line costs besides."""
    section, real = "Times", evidence.experiment.clock == "wall"
    times = times_of_sets(evidence)
    yield from quantiles(
        "start_delay",
        section,
        "start of a set after it was due",
        "started_utc_ns - due_utc_ns",
        [late for _, late, _ in times] if real else [],
        "no set has begun" if real else NO_TIME,
        applies=real,
    )
    yield from quantiles(
        "set_duration",
        section,
        "duration of a set, in the test's time",
        "ended_utc_ns - started_utc_ns",
        [took for _, _, took in times],
        "no set has ended",
    )
    yield from quantiles(
        "line_cost",
        section,
        "wall time of the line a set, without strike and read",
        "sum of the reading's stage_s but strike_and_read_s",
        [cost_s(reading) for reading in readings(evidence)],
        NOT_KEPT,
    )


def growth_quantities(evidence: Evidence, name: str, text: str, unit: str) -> Iterator[Quantity]:
    """Most of it, and its slope a 1,000 sets in the recorder that took the most sets."""
    section, found = "Recorder", kept(evidence, name)
    told = bool(readings(evidence))
    missing = NOT_KEPT if not told else NOT_TOLD
    yield Quantity(
        name=f"{name}_max",
        section=section,
        text=f"{text}, largest",
        unit=unit,
        how="largest reading at the end of a set",
        value=max((value for _, value in found), default=None),
        missing="" if found else missing,
    )
    runs: defaultdict[tuple[int, int], list[tuple[int, float]]] = defaultdict(list)
    for reading, value in found:
        runs[reading.recorder].append((reading.set_index, value))
    longest = max(runs.values(), key=len, default=[])
    longest = longest[max(WARM_UP_SETS, round(WARM_UP * len(longest))) :]
    grown = growth([index for index, _ in longest], [value for _, value in longest])
    yield Quantity(
        name=f"{name}_growth",
        section=section,
        text=f"{text}, growth a 1,000 sets",
        unit=f"{unit} a 1,000 sets",
        how=f"median of all slopes (Theil, Sen) with its {CONFIDENCE:.0%} interval, of the recorder that "
        f"took the most sets, without its first fifth and first {WARM_UP_SETS}: {len(longest)} readings",
        value=None if grown is None else grown.slope,
        low=None if grown is None else grown.low,
        high=None if grown is None else grown.high,
        missing=""
        if grown
        else missing
        if not found
        else f"undecided: {len(longest)} readings; {FEWEST_READINGS} are the fewest that tell",
    )


def disk_quantities(evidence: Evidence) -> Iterator[Quantity]:
    """Files against the forecast, and the volume."""
    section, sizes = "Disk", list(evidence.file_bytes.values())
    mean = sum(sizes) / len(sizes) if sizes else None
    missing = "" if sizes else "no set has a file yet"
    free = kept(evidence, "free_bytes")
    yield Quantity(
        name="files_bytes",
        section=section,
        text="files of the sets",
        unit="B",
        how=f"sizes of {len(sizes)} files",
        value=sum(sizes),
    )
    yield Quantity(
        name="growth_bytes",
        section=section,
        text="growth a 1,000 sets",
        unit="B a 1,000 sets",
        how="1,000 times the mean size of a set's file",
        value=None if mean is None else 1e3 * mean,
        missing=missing,
    )
    yield Quantity(
        name="growth_of_forecast",
        section=section,
        text="growth over the forecast of check-config",
        unit="1",
        how=f"mean size of a file / {evidence.forecast_bytes:.0f} B of one built in memory for a whole set",
        value=None if mean is None else mean / evidence.forecast_bytes,
        missing=missing,
    )
    yield Quantity(
        name="free_bytes_min",
        section=section,
        text="free on the volume, smallest",
        unit="B",
        how="smallest reading at the end of a set",
        value=min((value for _, value in free), default=None),
        missing="" if free else NOT_KEPT,
    )


def clock_quantities(evidence: Evidence) -> Iterator[Quantity]:
    """Tell steps, doubt, and how far the computer's UTC was off the test's time."""
    section, real = "Clock", evidence.experiment.clock == "wall"
    steps = [abs(row.payload["step_s"]) for row in evidence.service if row.kind == CLOCK_STEP]
    doubts = sum(fault.kind == "clock_doubted" for fault in faults(evidence))
    ahead = [abs(value) for _, value in kept(evidence, "clock_ahead_s")]
    known = [value for _, value in kept(evidence, "clock_synchronised")]
    common: dict[str, Any] = {"section": section, "applies": real}
    no = NO_TIME if not real else NOT_KEPT
    yield Quantity(
        name="clock_steps",
        text="steps of the computer's UTC",
        unit="1",
        how="events clock_step; the test's time goes on by elapsed time",
        value=len(steps) if real else None,
        missing="" if real else NO_TIME,
        **common,
    )
    yield Quantity(
        name="clock_step_max_s",
        text="largest step",
        unit="s",
        how="largest |step_s| of these events",
        value=max(steps, default=0.0) if real else None,
        missing="" if real else NO_TIME,
        **common,
    )
    yield Quantity(
        name="clock_doubts",
        text="times that the clock was doubted",
        unit="1",
        how="alarms clock_doubted",
        value=doubts if real else None,
        missing="" if real else NO_TIME,
        **common,
    )
    yield Quantity(
        name="clock_ahead_max_s",
        text="computer's UTC off the test's time, largest",
        unit="s",
        how="largest |clock_ahead_s| at the end of a set",
        value=max(ahead, default=None),
        missing="" if ahead else no,
        **common,
    )
    yield Quantity(
        name="clock_synchronised_fraction",
        text="part of the sets at whose end the system knew its UTC to be synchronised",
        unit="1",
        how="mean of clock_synchronised; systems that do not tell count as not",
        value=sum(known) / len(known) if known else None,
        missing="" if known else no,
        **common,
    )
