"""What a data folder knows of the time when a recorder starts, and when a test may begin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from daq_service.catalogue import RecorderCatalogue
from daq_service.clock import Before, format_utc, parse_utc
from daq_service.errors import UsageError
from daq_service.processes.heartbeat import Beat, extract_time_line
from hardware_drivers.nanoseconds import NS_PER_S

CLOCK_STEP, CLOCK_BELIEVED = "clock_step", "clock_believed"
"""Events that hold how far the system's clock is ahead of the test's time."""

EARLIEST_UTC = "2025-01-01T00:00:00Z"
"""Nobody had this software before: a machine without a clock of its own starts in 1970, 2000 or 2010."""


def read_previous_time(
    catalogue: RecorderCatalogue,
    beat: Beat | None,
    *,
    opened_utc_ns: Sequence[int] = (),
    boot: str | None,
    elapsed_ns: int,
    doubt_after_h: float,
) -> Before:
    """Read the last known test time from the newest event and, on the same boot, the last heartbeat.

    A heartbeat of another boot, as after a power cut, gives no time. The offset of the system's clock from
    the test's time is the one that was stored last.

    Parameters
    ----------
    beat
        Last heartbeat of an earlier recorder; None: there is none.
    opened_utc_ns
        Times of the last shots that the journal has and the catalogue lacks yet (ns of UTC).
    boot, elapsed_ns
        Name of this boot, and ns since it started.
    doubt_after_h
        Hours of downtime after which a clock that is not synchronized is doubtful; part of the result.
    """
    line = extract_time_line(beat, boot=boot, elapsed_ns=elapsed_ns)
    last_event = catalogue.read_last_service_event(CLOCK_STEP, CLOCK_BELIEVED)
    if line is not None and last_event is not None and last_event.payload["boot"] == boot:
        line = replace(line, ahead_ns=round(last_event.payload["ahead_s"] * NS_PER_S))
    newest = catalogue.read_events_after(catalogue.last_event_id() - 1, limit=1)
    return Before(
        last_utc_ns=max(
            newest[0].utc_ns if newest else catalogue.read_experiment().epoch_utc_ns, *opened_utc_ns, 0
        ),
        line=line,
        doubt_after_h=doubt_after_h,
    )


def compute_hour_0_ns(system_ns: int) -> int:
    """Check the system's time (ns of UTC) and return it as hour 0 of a test in real time that starts now.

    Raises
    ------
    UsageError
        It is before 2025: the system's clock is not set.
    """
    if system_ns < parse_utc(EARLIEST_UTC):
        raise UsageError(
            f"the computer clock is {format_utc(system_ns, 0)}, which is before {EARLIEST_UTC}; set it, "
            "then begin the test"
        )
    return system_ns
