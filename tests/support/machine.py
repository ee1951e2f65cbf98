"""A computer whose clocks advance only during a sleep: set, drifting, restarted."""

from __future__ import annotations

from collections.abc import Callable

from daq_service.clock import Before, MachineClock, WallClock

NS_PER_S = 1_000_000_000
NS_PER_H = 3600 * NS_PER_S


class Machine:
    """Computer with its UTC, the time elapsed since its boot, and scheduled events.

    Parameters
    ----------
    utc_ns
        What its clock says at first.
    drift_ppm
        By how much that runs ahead.
    """

    def __init__(self, utc_ns: int, *, drift_ppm: int = 0) -> None:
        self.utc_ns, self.drift_ppm = utc_ns, drift_ppm
        self.elapsed_ns, self.boot, self.synchronised = 500 * NS_PER_S, "boot 1", False
        self._planned: list[tuple[int, Callable[[], None]]] = []

    def after(self, hours: float, action: Callable[[], None]) -> None:
        """Schedule a function for when this much more time has elapsed."""
        self._planned.append((self.elapsed_ns + round(hours * NS_PER_H), action))

    def set_clock(self, by_h: float) -> None:
        """Step the system's UTC."""
        self.utc_ns += round(by_h * NS_PER_H)

    def start_again(self, utc_ns: int) -> None:
        """Boot with the clock at ``utc_ns``."""
        self.utc_ns, self.elapsed_ns, self.boot = utc_ns, 30 * NS_PER_S, f"{self.boot} again"

    def sleep(self, seconds: float) -> None:
        """Let time pass and run what is scheduled for it."""
        passed_ns = round(seconds * NS_PER_S)
        self.elapsed_ns += passed_ns
        self.utc_ns += passed_ns + passed_ns * self.drift_ppm // 1_000_000
        ripe = [action for when_ns, action in self._planned if when_ns <= self.elapsed_ns]
        self._planned = [item for item in self._planned if item[0] > self.elapsed_ns]
        for action in ripe:
            action()

    def clock(self, before: Before | None = None) -> WallClock:
        """Return the clock of a recorder that starts on this machine."""
        return WallClock(before, machine=self.machine_clock())

    def machine_clock(self) -> MachineClock:
        """Return the clocks of this machine."""
        return MachineClock(
            mono_ns=lambda: self.elapsed_ns,
            elapsed_ns=lambda: self.elapsed_ns,
            utc_ns=lambda: self.utc_ns,
            boot_name=lambda: self.boot,
            is_synchronised=lambda: self.synchronised,
            sleep=self.sleep,
        )


def clock_in_seconds(mono_s: Callable[[], float]) -> MachineClock:
    """Return clocks of a machine whose monotonic time a test sets in s."""
    return MachineClock(mono_ns=lambda: round(mono_s() * NS_PER_S))
