"""The line of experiment time in a real test, its steps, and when it is doubted: pure.

The line begins at the system's UTC and goes on with the time that elapses, the machine's sleep included.
While UTC only drifts it is followed, so that a test of weeks stays with UTC; what is no drift is a step,
which is told and moves nothing. After a reboot nothing but the system's UTC is left, and that may be doubted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from daq_service.clock.written import format_utc
from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S

LARGEST_DRIFT_PPM = 500
"""A clock that runs further off is set by steps: the limit of NTP's slewing, too."""
STEP_ABOVE_NS = NS_PER_S
"""What the drift does not explain and is no more than this is followed: a leap second, two looks that the
system tore apart."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeLine:
    """Experiment time at a moment of a boot.

    Attributes
    ----------
    utc_ns
        Experiment time then.
    elapsed_ns
        What had elapsed of the boot then.
    ahead_ns
        The system's UTC less experiment time, by steps; 0 where they agree but for drift.
    """

    utc_ns: int
    elapsed_ns: int
    ahead_ns: int = 0

    def at(self, system_ns: int, elapsed_ns: int) -> TimeLine:
        """Return the line at a later moment of the same boot.

        Between two readings experiment time runs at most 500 ppm faster or slower than elapsed time, towards
        the system's UTC; it never runs back. A larger step of UTC changes only ``ahead_ns``.

        Parameters
        ----------
        system_ns, elapsed_ns
            The system's UTC, and the time since the boot, at that moment, ns.
        """
        passed_ns = elapsed_ns - self.elapsed_ns
        drift_ns = passed_ns * LARGEST_DRIFT_PPM // 1_000_000
        off_ns = system_ns - self.ahead_ns - (self.utc_ns + passed_ns)
        if abs(off_ns) > STEP_ABOVE_NS + drift_ns:
            ahead_ns = self.ahead_ns + off_ns
            # Stepped back to where it was: what is left is drift again.
            ahead_ns = 0 if abs(ahead_ns) <= STEP_ABOVE_NS else ahead_ns
            return TimeLine(utc_ns=self.utc_ns + passed_ns, elapsed_ns=elapsed_ns, ahead_ns=ahead_ns)
        slewed_ns = max(-drift_ns, min(drift_ns, off_ns))
        return replace(self, utc_ns=self.utc_ns + passed_ns + slewed_ns, elapsed_ns=elapsed_ns)


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """Step of the system's clock, as payload of an event.

    Attributes
    ----------
    ahead_s
        The system's UTC less experiment time, from now on.
    boot
        Name of the boot in which that is so; None where it has none.
    """

    step_s: float
    ahead_s: float
    system_utc_ns: int
    experiment_utc_ns: int
    boot: str | None
    message: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Before:
    """Time that a data folder has stored before a recorder starts.

    Attributes
    ----------
    last_utc_ns
        Experiment time of what was stored last.
    line
        Experiment time of an earlier recorder on this boot; None: there was none, or nobody knows.
    doubt_after_h
        A clock that nobody has synchronised is doubted so long after ``last_utc_ns``.
    """

    last_utc_ns: int
    line: TimeLine | None = None
    doubt_after_h: float = 72.0

    def find_clock_doubt(self, system_ns: int, *, synchronised: bool) -> str:
        """Return why the system's UTC (ns) is unverified after a reboot; empty if it is verified.

        It is unverified if it is before the last stored time, or more than ``doubt_after_h`` after it while
        the kernel does not report it as synchronised.
        """
        says = f"the computer clock is {format_utc(system_ns, 0)}"
        last = f"what was stored last ({format_utc(self.last_utc_ns, 0)})"
        gap_h = (system_ns - self.last_utc_ns) / NS_PER_H
        if gap_h < 0.0:
            return f"{says}, which is before {last}"
        if gap_h > self.doubt_after_h and not synchronised:
            return (
                f"{says}, {gap_h:.0f} h after {last}: more than clock.doubt_after_h = {self.doubt_after_h:g} "
                "h, and it is not known to be synchronised"
            )
        return ""
