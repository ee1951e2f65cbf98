"""Test bench of an instrument: its striker, what the coils did, and the faults that it can inject."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field

from hardware_drivers.measurement import ShotKey

Keys = tuple[ShotKey, ...]
Strike = Callable[[ShotKey], None]
CoilLevels = Callable[[], Sequence[tuple[str, bool]]]
"""All switchings so far, oldest first: position, and whether its coil went on (True) or off."""
Order = tuple[float, float]
"""Of a supply: V and A."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bench:
    """Double below the driver, and what it reports and does; rules that need more are skipped.

    Attributes
    ----------
    parameters
        Parameters that only the running double knows (its port), laid over those of the configuration.
    strike
        Makes the key's transducer send a wave; absent: the position's own striker strikes.
    coil_levels
        All switchings so far; a kind that is no striker has none.
    fault
        Lets the instrument fail in a way of `Double.faults` until the context is left.
    caps, order
        Of a supply: what it is configured to refuse, and what to order of it. Absent: it is switched by no
        rule, so without a double only its kind is proved.
    air
        Temperature in degrees Celsius and relative humidity (0..1) at a climate probe.
    """

    parameters: Mapping[str, object] = field(default_factory=dict)
    strike: Strike | None = None
    coil_levels: CoilLevels | None = None
    fault: Callable[[str], AbstractContextManager[object]] | None = None
    caps: Order | None = None
    order: Order | None = None
    air: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Double:
    """Replacement of an instrument below its driver: ``--solimon-double MODULE:NAME`` names one.

    Attributes
    ----------
    bench
        Entered once for each rule, before the kind is opened: from then on the kind meets the double.
    faults
        Ways in which `Bench.fault` can let it fail: one test each.
    """

    bench: Callable[[], AbstractContextManager[Bench]]
    faults: tuple[str, ...] = ()


class MachineClock:
    """Clock with the machine's own time."""

    def utc_ns(self) -> int:
        """Return the machine's UTC in ns since 1970-01-01T00:00Z."""
        return time.time_ns()

    def mono_ns(self) -> int:
        """Return the machine's monotonic time in ns; it never steps back."""
        return time.monotonic_ns()

    def wait_until(self, utc_ns: int, idle: Callable[[], bool]) -> bool:
        """Wait for a UTC in ns; return True once it is reached, False as soon as ``idle()`` returns False.

        ``idle`` is called at least every 0.1 s; for a past time it is not called.
        """
        while (left_ns := utc_ns - self.utc_ns()) > 0:
            if not idle():
                return False
            time.sleep(min(left_ns / 1e9, 0.1))
        return True
