"""The twin as instruments: striker, digitizer and pulse-echo unit behind the Protocols of a rig.

A strike reaches the digitizer through the bench they share, as it does in a laboratory through the
chain of spheres: a digitizer that is not armed, or armed at another position, records nothing.
Time passes only on the experiment's clock; no instrument waits. Nobody can strike while `read` runs,
so a read without a strike times out at once.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from concurrent.futures import Executor, Future
from dataclasses import dataclass

from hardware_drivers.errors import AcquisitionTimeoutError, ConfigurationError
from hardware_drivers.instruments import Acquired, Clock, Echo
from hardware_drivers.measurement import ShotKey
from simulator.errors import SimulatorError
from simulator.scenario import TwinParameters
from simulator.specimen import Specimen, Transducer, build_specimen

COIL_EVENTS_KEPT = 1_000
"""The coil's record is a ring: the newest events of the last 500 strikes."""


class RecordsAhead:
    """Records of a set's next shots, computed while the caller stores and judges the present one.

    A record is a pure function of the shot's key and the hour, so one computed ahead is the one that
    would be computed now. At most one set is held; what the next strike does not ask for is dropped.

    Parameters
    ----------
    executor
        Runs the computations. One worker thread is enough: the physics releases the GIL.
    shots_per_set
        Shots with this index or a higher one are not expected.
    """

    def __init__(self, specimen: Specimen, executor: Executor, *, shots_per_set: int) -> None:
        self._specimen = specimen
        self._executor = executor
        self._shots_per_set = shots_per_set
        self._pending: dict[tuple[ShotKey, float], Future[Acquired | None]] = {}

    def expect(self, key: ShotKey, hour_h: float) -> None:
        """Start on the record of this shot and on those after it in its set."""
        wanted = [key]
        wanted += [
            ShotKey(position=key.position, set_index=key.set_index, shot_index=index)
            for index in range(key.shot_index + 1, self._shots_per_set)
        ]
        started = {(shot, hour_h): self._pending.pop((shot, hour_h), None) for shot in wanted}
        self.clear()
        self._pending = {
            expected: future or self._executor.submit(self._specimen.solitary_wave, *expected)
            for expected, future in started.items()
        }

    def take(self, key: ShotKey, hour_h: float) -> Acquired | None:
        """Record of an expected shot, waiting for it if need be."""
        return self._pending.pop((key, hour_h)).result()

    def clear(self) -> None:
        """Drop everything; a computation already running ends unheard."""
        for future in self._pending.values():
            future.cancel()
        self._pending.clear()


class Bench:
    """What striker and digitizer share: the specimen, which position is armed, which strike came.

    Parameters
    ----------
    clock
        The experiment's clock.
    epoch_utc_ns
        Hour 0 of the experiment.
    ahead
        Computes records ahead; None computes each when it is read.
    """

    def __init__(
        self, specimen: Specimen, clock: Clock, *, epoch_utc_ns: int, ahead: RecordsAhead | None = None
    ) -> None:
        self.specimen = specimen
        self.clock = clock
        self._epoch_utc_ns = epoch_utc_ns
        self._ahead = ahead
        self._armed: ShotKey | None = None
        self._strike: tuple[ShotKey, float] | None = None

    def hour_h(self) -> float:
        """Hour of the experiment whose depth and temperature hold now."""
        return self.specimen.hour_h(self.clock.utc_ns() - self._epoch_utc_ns)

    def arm(self, key: ShotKey) -> None:
        """Let the next strike at the key's position be recorded."""
        _require_position(key, self.specimen.transducers, "solitary-wave transducer")
        if self._armed is not None:
            raise ConfigurationError(
                f"already armed at {self._armed.position!r} for shot {self._armed.shot_index} of set "
                f"{self._armed.set_index}; read or disarm first"
            )
        self._armed = key

    def disarm(self) -> None:
        """Record nothing any more and forget what was computed ahead."""
        self._armed = self._strike = None
        if self._ahead is not None:
            self._ahead.clear()

    def strike(self, key: ShotKey) -> None:
        """Send a wave down the chain: only the first one at the armed position is recorded."""
        if self._armed is None or self._armed.position != key.position or self._strike is not None:
            return
        self._strike = (key, self.hour_h())
        if self._ahead is not None:
            self._ahead.expect(*self._strike)

    def read(self) -> Acquired:
        """Hand over the record of the armed shot and disarm."""
        if self._armed is None:
            raise ConfigurationError("not armed; arm before the strike, then read")
        armed, strike = self._armed, self._strike
        self._armed = self._strike = None
        if strike is None:
            raise AcquisitionTimeoutError(
                f"no strike at {armed.position!r} since the digitizer was armed; check the striker"
            )
        try:
            compute = self.specimen.solitary_wave if self._ahead is None else self._ahead.take
            acquired = compute(*strike)
        except (SimulatorError, ValueError) as error:
            raise ConfigurationError(f"the twin cannot compute this shot: {error}") from error
        if acquired is None:
            level_v = self.specimen.twin.adc.trigger_level_v
            raise AcquisitionTimeoutError(
                f"the strike at {armed.position!r} did not reach the trigger level of {level_v} V; check "
                "drop height, sensitivity and level"
            )
        return acquired


def _require_position(key: ShotKey, known: Mapping[str, object], what: str) -> None:
    if key.position not in known:
        names = ", ".join(sorted(known)) or "none"
        raise ConfigurationError(f"no {what} at position {key.position!r}; there are: {names}")


@dataclass(frozen=True, slots=True, kw_only=True)
class CoilEvent:
    """A coil was switched on or off."""

    utc_ns: int
    position: str
    energised: bool


class SimulatedStriker:
    """Electromagnets that lift and drop the strikers."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._energised: str | None = None
        self._events: deque[CoilEvent] = deque(maxlen=COIL_EVENTS_KEPT)

    @property
    def energised(self) -> str | None:
        """Position whose coil is on, None if all are off."""
        return self._energised

    @property
    def coil_events(self) -> tuple[CoilEvent, ...]:
        """The newest switchings, oldest first."""
        return tuple(self._events)

    def strike(self, key: ShotKey) -> None:
        """Pulse the coil once: energising lifts the striker, releasing drops it on the chain."""
        _require_position(key, self._bench.specimen.transducers, "striker")
        self._switch(key.position, energised=True)
        self.make_safe()
        self._bench.strike(key)

    def make_safe(self) -> None:
        """De-energise every coil."""
        if self._energised is not None:
            self._switch(self._energised, energised=False)

    def _switch(self, position: str, *, energised: bool) -> None:
        self._energised = position if energised else None
        now_ns = self._bench.clock.utc_ns()
        self._events.append(CoilEvent(utc_ns=now_ns, position=position, energised=energised))


class SimulatedDigitizer:
    """Samples the PZT disk of the armed position around the trigger."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def arm(self, key: ShotKey) -> None:
        """Wait for the trigger at the key's position."""
        self._bench.arm(key)

    def read(self, timeout_s: float) -> Acquired:
        """Hand over the record; how fast this machine computes it never makes a strike a missed one."""
        _require_timeout(timeout_s)
        return self._bench.read()

    def disarm(self) -> None:
        """Stop waiting."""
        self._bench.disarm()


class SimulatedPulseEchoUnit:
    """Fires the ultrasonic probe and averages."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def acquire(self, key: ShotKey, timeout_s: float) -> Echo:
        """Averaged record of the wall at this hour."""
        _require_timeout(timeout_s)
        _require_position(key, self._bench.specimen.probed_thickness_m, "ultrasonic probe")
        return self._bench.specimen.echo(key, self._bench.hour_h())


def _require_timeout(timeout_s: float) -> None:
    if not timeout_s > 0.0:
        raise ConfigurationError(f"timeout_s is {timeout_s}; it must be positive")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedInstruments:
    """The instruments of one bench; a rig is composed of them and the clock."""

    striker: SimulatedStriker
    digitizer: SimulatedDigitizer
    pulse_echo: SimulatedPulseEchoUnit


def build_bench(
    twin: TwinParameters,
    *,
    clock: Clock,
    epoch_utc_ns: int,
    transducers: Mapping[str, Transducer],
    probed_thickness_m: Mapping[str, float],
    shots_per_set: int = 10,
    executor: Executor | None = None,
) -> SimulatedInstruments:
    """Instruments around one specimen.

    Parameters
    ----------
    twin
        Scenario of the experiment.
    clock, epoch_utc_ns
        The experiment's clock and its hour 0: they date the wall and the weather.
    transducers
        By position: chain and physics of each solitary-wave transducer.
    probed_thickness_m
        By position: pristine thickness under each ultrasonic probe.
    shots_per_set, executor
        With an executor, the records of a set's next shots are computed ahead in it; without, each
        when it is read. The records are the same to the last bit. The caller owns the executor.
    """
    specimen = build_specimen(twin, transducers=transducers, probed_thickness_m=probed_thickness_m)
    ahead = None if executor is None else RecordsAhead(specimen, executor, shots_per_set=shots_per_set)
    bench = Bench(specimen, clock, epoch_utc_ns=epoch_utc_ns, ahead=ahead)
    return SimulatedInstruments(
        striker=SimulatedStriker(bench),
        digitizer=SimulatedDigitizer(bench),
        pulse_echo=SimulatedPulseEchoUnit(bench),
    )
