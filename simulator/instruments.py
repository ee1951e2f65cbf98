"""Twin as instruments: striker, digitizer and pulse-echo unit behind the Protocols of a rig.

A strike reaches the digitizer through the bench they share, as it does in a laboratory through the
chain of spheres: a digitizer that is not armed, or armed at another position, records nothing.
Time passes only on the experiment's clock; no instrument waits.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from dataclasses import dataclass
from itertools import groupby, islice

from hardware_drivers.errors import AcquisitionTimeoutError, ConfigurationError
from hardware_drivers.instruments import Acquired, Clock, Echo, require_timeout
from hardware_drivers.measurement import ShotKey
from hardware_drivers.struck_digitizer import StruckDigitizer
from simulator.errors import SimulatorError
from simulator.parameters.experiment import TwinParameters
from simulator.specimen import Specimen, Transducer, build_specimen

log = logging.getLogger(__name__)

COIL_EVENTS_KEPT = 1_000
"""The coil's record is a ring: the newest events of the last 500 strikes."""

RECORDS_AHEAD = 32
"""Records computed before their strike, at most: those of a set of the paper, 1 MB. A set is stored and
committed in the time that so many take."""

LARGEST_GROUP = 10
"""Strikes of one transducer and set computed together, at most: the paper's ten on a wall of one depth."""

TimedStrike = tuple[ShotKey, float]
"""A strike and the hour of the experiment at which it comes."""

Compute = Callable[[Sequence[TimedStrike]], list[Acquired | None]]
"""Records of strikes in their order; None for one that does not trigger."""

StrikesAfter = Callable[[ShotKey, int], Iterator[tuple[ShotKey, int]]]
"""Strikes that are planned after one of this key at this time (UTC in ns), each with its own time."""


@dataclass(frozen=True, slots=True)
class _PendingRecord:
    """Record in computation: its group and its index in the results."""

    group: Future[list[Acquired | None]]
    index: int


class RecordsAhead:
    """Records of the next scheduled strikes, computed while the caller stores and assesses the present one.

    A record is a pure function of the shot's key and the hour, so one computed ahead is the one that
    would be computed now, and a plan that is not kept costs time but changes nothing: a strike that was
    not expected is computed by its reader, and what is expected no more is dropped. The strikes of one
    transducer in a set are computed as a group; where one of them fails, each is computed by its reader, so
    that the error comes at its own strike.

    Parameters
    ----------
    executor
        Runs the computations, in a thread or a process of its own. Its owner cancels what is left when it
        closes. Where it breaks, every record is computed by its reader.
    compute
        What `executor` runs for `Specimen.simulate_waves`: another process cannot be handed a specimen.
    """

    def __init__(
        self, specimen: Specimen, executor: Executor, strikes_after: StrikesAfter, compute: Compute
    ) -> None:
        """Keep the collaborators; nothing is computed before the first call of `record`."""
        self._specimen = specimen
        self._executor = executor
        self._compute = compute
        self._broken = False
        self._strikes_after = strikes_after
        self._planned: Iterator[list[TimedStrike]] = iter(())
        self._pending: dict[TimedStrike, _PendingRecord] = {}
        # Positions that were passed over when they were due: disabled ones, for all we know.
        self._passed_over: set[str] = set()

    def record(self, key: ShotKey, utc_ns: int, hour_h: Callable[[int], float]) -> Acquired | None:
        """Return the record of a strike, waiting if necessary; start computing those after it.

        Return None for a strike that does not trigger. If the executor broke, log that once and compute here.
        An error of the computation is raised at its own strike.

        Parameters
        ----------
        hour_h
            Hour of the experiment that holds at a time (UTC in ns).
        """
        if not self._broken:
            try:
                return self._record(key, utc_ns, hour_h)
            except BrokenExecutor as error:
                log.warning("records are not computed ahead any more: %s", error)
                self._broken = True
        return self._specimen.simulate_wave(key, hour_h(utc_ns))

    def _record(self, key: ShotKey, utc_ns: int, hour_h: Callable[[int], float]) -> Acquired | None:
        """Return the record of a strike and start computing the next ones; None if it does not trigger.

        A failed group is logged, and its records are computed here. Raise BrokenExecutor if the executor
        broke.
        """
        strike = key, hour_h(utc_ns)
        expected = list(self._pending)
        pending = self._pending.pop(strike, None)
        previous: dict[TimedStrike, _PendingRecord] = {}
        if expected[:1] != [strike]:
            previous, self._pending = self._pending, {}
            self._plan_strikes(key, utc_ns, [planned for planned, _ in expected], hour_h)
        while len(self._pending) + LARGEST_GROUP <= RECORDS_AHEAD:
            group = next(self._planned, None)
            if group is None:
                break
            self._pending |= self._submit_strikes(group, previous)
        if previous:
            wanted = {record.group for record in (pending, *self._pending.values()) if record is not None}
            for dropped in {record.group for record in previous.values()} - wanted:
                dropped.cancel()
        if pending is not None:
            error = pending.group.exception()
            if error is None:
                return pending.group.result()[pending.index]
            if isinstance(error, BrokenExecutor):
                raise error
            log.warning("a group of records failed, so each is computed by its reader: %s", error)
        return self._specimen.simulate_wave(*strike)

    def _submit_strikes(
        self, group: Sequence[TimedStrike], previous: dict[TimedStrike, _PendingRecord]
    ) -> dict[TimedStrike, _PendingRecord]:
        """Submit the strikes of a group that are not pending yet; move the others from ``previous``.

        Return the pending records of the group. Raise BrokenExecutor if the executor broke.
        """
        new = [strike for strike in group if strike not in previous]
        if new:
            future = self._executor.submit(self._compute, new)
            previous |= {strike: _PendingRecord(future, index) for index, strike in enumerate(new)}
        return {strike: previous.pop(strike) for strike in group}

    def _plan_strikes(
        self, key: ShotKey, utc_ns: int, expected: Sequence[ShotKey], hour_h: Callable[[int], float]
    ) -> None:
        """Plan the strikes ahead again after one out of the planned order; skip positions passed over.

        ``expected`` are the strikes planned before: positions of those before ``key`` count as passed over
        until they are struck.
        """
        if key in expected:
            self._passed_over |= {shot.position for shot in expected[: expected.index(key)]}
        self._passed_over.discard(key.position)
        strikes = (
            (planned, hour_h(planned_ns))
            for planned, planned_ns in self._strikes_after(key, utc_ns)
            if planned.position not in self._passed_over
        )
        self._planned = _group_strikes(strikes)


def _group_strikes(strikes: Iterable[TimedStrike]) -> Iterator[list[TimedStrike]]:
    """Yield consecutive strikes of one position and set in groups of at most 10."""
    for _, neighbours in groupby(strikes, key=lambda strike: (strike[0].position, strike[0].set_key)):
        while group := list(islice(neighbours, LARGEST_GROUP)):
            yield group


class Bench(StruckDigitizer):
    """Digitizer, and the specimen and hour that striker and pulse-echo unit share with it.

    Parameters
    ----------
    clock
        The experiment's clock.
    epoch_utc_ns
        Hour 0 of the experiment.
    ahead
        Computes records ahead; None computes each when it is read.
    """

    no_strike_remedy = "; check the striker"

    def __init__(
        self, specimen: Specimen, clock: Clock, *, epoch_utc_ns: int, ahead: RecordsAhead | None = None
    ) -> None:
        """Keep the collaborators; no strike has been recorded yet."""
        super().__init__()
        self.specimen = specimen
        self.clock = clock
        self._epoch_utc_ns = epoch_utc_ns
        self._ahead = ahead
        self._struck_utc_ns = 0

    def hour_h(self, utc_ns: int) -> float:
        """Return the hour of the test whose depth and temperature apply at a time (UTC in ns)."""
        return self.specimen.hour_h(utc_ns - self._epoch_utc_ns)

    def require_transducer(self, key: ShotKey) -> None:
        """Raise ConfigurationError if a position has no solitary-wave transducer."""
        _require_position(key, self.specimen.transducers, "solitary-wave transducer")

    def strike(self, key: ShotKey) -> bool:
        """Strike the chain of a position; return whether the armed digitizer records the wave.

        Only the first wave at the armed position is recorded.
        """
        recorded = super().strike(key)
        if recorded:
            self._struck_utc_ns = self.clock.utc_ns()
        return recorded

    def record_of(self, key: ShotKey) -> Acquired:
        """Return the record of the last strike as the digitizer samples it; wait for one computed ahead.

        Raise AcquisitionTimeoutError if the strike does not reach the trigger level.
        Raise ConfigurationError if the twin cannot compute the shot.
        """
        try:
            acquired = self._record(key, self._struck_utc_ns)
        except (SimulatorError, ValueError) as error:
            raise ConfigurationError(f"the twin cannot compute this shot: {error}") from error
        if acquired is None:
            level_v = self.specimen.twin.adc.trigger_level_v
            raise AcquisitionTimeoutError(
                f"the strike at {key.position!r} did not reach the trigger level of {level_v} V; check "
                "drop height, sensitivity and level"
            )
        return acquired

    def _record(self, key: ShotKey, utc_ns: int) -> Acquired | None:
        """Return the record of a strike, computed now or ahead of time; None if it does not trigger.

        Raise SimulatorError or ValueError if it cannot be computed.
        """
        if self._ahead is None:
            return self.specimen.simulate_wave(key, self.hour_h(utc_ns))
        return self._ahead.record(key, utc_ns, self.hour_h)


def _require_position(key: ShotKey, known: Mapping[str, object], role: str) -> None:
    """Raise ConfigurationError, with the known positions, if the position of ``key`` is none of them.

    ``role`` names the missing device in the message.
    """
    if key.position not in known:
        names = ", ".join(sorted(known)) or "none"
        raise ConfigurationError(f"no {role} at position {key.position!r}; there are: {names}")


@dataclass(frozen=True, slots=True, kw_only=True)
class CoilEvent:
    """Switching of a coil."""

    utc_ns: int
    position: str
    energised: bool


class SimulatedStriker:
    """Electromagnets that lift and drop the strikers."""

    def __init__(self, bench: Bench) -> None:
        """Keep the bench; all coils are off."""
        self._bench = bench
        self._energised: str | None = None
        self._events: deque[CoilEvent] = deque(maxlen=COIL_EVENTS_KEPT)

    @property
    def energised(self) -> str | None:
        """Return the position whose coil is on, None if all are off."""
        return self._energised

    @property
    def coil_events(self) -> tuple[CoilEvent, ...]:
        """Return the newest 1,000 switchings of coils, oldest first."""
        return tuple(self._events)

    def strike(self, key: ShotKey) -> None:
        """Strike once: energising the coil lifts the striker, releasing drops it on the chain.

        Raise ConfigurationError for a position without a transducer.
        """
        _require_position(key, self._bench.specimen.transducers, "striker")
        self._switch_coil(key.position, energised=True)
        self.make_safe()
        self._bench.strike(key)

    def make_safe(self) -> None:
        """De-energise the coil that is on, if any, which drops its striker."""
        if self._energised is not None:
            self._switch_coil(self._energised, energised=False)

    def _switch_coil(self, position: str, *, energised: bool) -> None:
        """Switch a coil on or off and record the event with the experiment's time."""
        self._energised = position if energised else None
        now_ns = self._bench.clock.utc_ns()
        self._events.append(CoilEvent(utc_ns=now_ns, position=position, energised=energised))


class SimulatedPulseEchoUnit:
    """Pulse-echo unit that fires the ultrasonic probe and averages."""

    def __init__(self, bench: Bench) -> None:
        """Keep the bench, whose specimen is probed."""
        self._bench = bench

    def acquire(self, key: ShotKey, timeout_s: float) -> Echo:
        """Return the averaged pulse-echo record of the wall at this hour, at once.

        Raise ConfigurationError for a position without a probe, and for a timeout that is not valid.
        """
        require_timeout(timeout_s)
        _require_position(key, self._bench.specimen.probed_thickness_m, "ultrasonic probe")
        return self._bench.specimen.echo(key, self._bench.hour_h(self._bench.clock.utc_ns()))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedInstruments:
    """Instruments of one bench, from which a rig is composed together with the clock."""

    striker: SimulatedStriker
    digitizer: Bench
    pulse_echo: SimulatedPulseEchoUnit


def build_bench(
    twin: TwinParameters,
    *,
    clock: Clock,
    epoch_utc_ns: int,
    transducers: Mapping[str, Transducer],
    probed_thickness_m: Mapping[str, float],
    strikes_after: StrikesAfter | None = None,
    executor: Executor | None = None,
    compute: Compute | None = None,
) -> SimulatedInstruments:
    """Build the simulated instruments around one specimen.

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
    strikes_after, executor
        With an executor, the records of the next planned strikes are computed ahead in it; without, each
        when it is read. The records are the same to the last bit. The caller owns the executor and
        cancels what is pending when it closes.
    compute
        What an executor of other processes runs for this specimen's `simulate_waves`.

    Raises
    ------
    SpecimenError
        The specimen cannot be built (`build_specimen`).
    """
    specimen = build_specimen(twin, transducers=transducers, probed_thickness_m=probed_thickness_m)
    ahead = None
    if executor is not None and strikes_after is not None:
        ahead = RecordsAhead(specimen, executor, strikes_after, compute or specimen.simulate_waves)
    bench = Bench(specimen, clock, epoch_utc_ns=epoch_utc_ns, ahead=ahead)
    return SimulatedInstruments(
        striker=SimulatedStriker(bench),
        digitizer=bench,
        pulse_echo=SimulatedPulseEchoUnit(bench),
    )
