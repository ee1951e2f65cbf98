"""The clock of a test in real time: elapsed time, which no step of UTC moves."""

from __future__ import annotations

from collections.abc import Callable

from daq_service.clock.machine import MACHINE, MachineClock
from daq_service.clock.time_line import Before, Step, TimeLine
from daq_service.clock.written import format_utc
from hardware_drivers.nanoseconds import NS_PER_S

IDLE_INTERVAL_S = 0.05
"""How often a waiting clock lets its caller look around; the Protocol allows 0.2 s."""
LOOKS = 3
TORN_NS = 100_000_000
"""Between the looks at the two clocks; a machine that slept or stalled there is looked at again."""


class WallClock:
    """Experiment time of a test in real time (`hardware_drivers.instruments.Clock`).

    Each reading looks at the system's UTC, too; `steps` hands over what was found. While that UTC is doubted
    time stands still at what was stored last.

    Parameters
    ----------
    before
        What is known of an earlier recorder's time; None: time begins now.
    """

    def __init__(self, before: Before | None = None, *, machine: MachineClock = MACHINE) -> None:
        self._machine, self._boot = machine, machine.boot_name()
        self._steps: list[Step] = []
        system, elapsed = self._read_both()
        self._line = TimeLine(utc_ns=system, elapsed_ns=elapsed)
        self._doubted: Before | None = None
        if before is not None and before.line is not None:
            self._line = before.line
        elif before is not None and before.find_clock_doubt(system, synchronised=machine.is_synchronised()):
            self._doubted = before

    def utc_ns(self) -> int:
        """Return the experiment time, ns of UTC; keep a detected step of the system's clock for `steps`.

        While the system's UTC is unverified, return the last stored time.
        """
        if self._doubted is not None:
            return self._doubted.last_utc_ns
        system, elapsed = self._read_both()
        before, self._line = self._line, self._line.at(system, elapsed)
        if self._line.ahead_ns != before.ahead_ns:
            self._steps.append(
                self._build_step(self._line.ahead_ns - before.ahead_ns, "the system's clock was set")
            )
        return self._line.utc_ns

    def mono_ns(self) -> int:
        """Return the time elapsed since the boot in ns, sleep included."""
        return self._machine.elapsed_ns()

    def wait_until(self, utc_ns: int, idle: Callable[[], bool]) -> bool:
        """Wait until an experiment time, ns of UTC, in steps of at most `IDLE_INTERVAL_S`.

        ``idle`` is called before each step and at the end. Return False as soon as it returns False, else
        True. While the system's UTC is unverified, experiment time does not advance.
        """
        while (left_ns := utc_ns - self.utc_ns()) > 0:
            if not idle():
                return False
            self._machine.sleep(min(left_ns / NS_PER_S, IDLE_INTERVAL_S))
        return idle()

    def line(self) -> TimeLine | None:
        """Return experiment and elapsed time of the same moment, for a later recorder of this boot.

        None while the system's UTC is unverified.
        """
        self.utc_ns()
        return None if self._doubted is not None else self._line

    def steps(self) -> list[Step]:
        """Return and remove the detected steps of the system's clock, in order: each is returned once."""
        found, self._steps = self._steps, []
        return found

    # While the system's UTC is doubted ---------------------------------------------------------------

    def wait_while_doubted(self, idle: Callable[[str], bool]) -> Step | None:
        """Block until the system's UTC is verified, or a person accepts it (`accept_system_clock`).

        Parameters
        ----------
        idle
            Called with the reason about every `IDLE_INTERVAL_S`; False ends the wait.

        Returns
        -------
        Step or None
            Step of 0 s with the time at which the test continues; None if UTC was verified from the start, or
            ``idle`` ended the wait.
        """
        waited = self._doubted is not None
        while self._doubted is not None:
            system, elapsed = self._read_both()
            reason = self._doubted.find_clock_doubt(system, synchronised=self._machine.is_synchronised())
            if not reason:
                self._resume_test_time(system, elapsed)
            elif not idle(reason):
                return None
            elif self._doubted is not None:
                self._machine.sleep(IDLE_INTERVAL_S)
        return self._build_step(0, "the system's clock is believed") if waited else None

    def accept_system_clock(self) -> str:
        """Accept the system's UTC at a person's request and return a message for the log.

        Experiment time continues at the system's UTC, but not before the last stored time.

        Raises
        ------
        ValueError
            The system's UTC is verified already.
        """
        if self._doubted is None:
            raise ValueError("the system's clock is believed already")
        self._resume_test_time(*self._read_both())
        return self._build_step(0, "the system's clock is trusted").message

    def _resume_test_time(self, system_ns: int, elapsed_ns: int) -> None:
        """Continue experiment time at the system's UTC, but not before the last stored time; arguments in ns.

        Raise AssertionError if the system's UTC is verified.
        """
        assert self._doubted is not None, "the computer clock is verified already"
        utc_ns = max(system_ns, self._doubted.last_utc_ns)
        self._line = TimeLine(utc_ns=utc_ns, elapsed_ns=elapsed_ns, ahead_ns=system_ns - utc_ns)
        self._doubted = None

    # -------------------------------------------------------------------------------------------------

    def _read_both(self) -> tuple[int, int]:
        """Read the system's UTC and the time since the boot of one moment, in this order, ns.

        If they are read more than 0.1 s apart (the machine slept or stalled), they are read again, `LOOKS`
        times in all; then the last pair is returned.
        """
        for _ in range(LOOKS):
            elapsed, system = self._machine.elapsed_ns(), self._machine.utc_ns()
            if self._machine.elapsed_ns() - elapsed < TORN_NS:
                break
        return system, elapsed

    def _build_step(self, step_ns: int, what: str) -> Step:
        """Build a step of the system's clock of ``step_ns`` (0: none); its message starts with ``what``."""
        step_s, ahead_s = step_ns / NS_PER_S, self._line.ahead_ns / NS_PER_S
        utc_ns, system_ns = self._line.utc_ns, self._line.utc_ns + self._line.ahead_ns
        by = f" by {step_s:+.3f} s" if step_ns else ""
        side = "ahead of it" if ahead_s > 0.0 else "behind it"
        difference = f"; the system's clock is {abs(ahead_s):.3f} s {side}" if ahead_s else ""
        return Step(
            step_s=step_s,
            ahead_s=ahead_s,
            system_utc_ns=system_ns,
            experiment_utc_ns=utc_ns,
            boot=self._boot,
            message=f"{what}{by} to {format_utc(system_ns, 3)}; the test goes on at {format_utc(utc_ns, 3)} "
            f"by elapsed time{difference}",
        )
