"""Record one set: strike, read, and yield the measurements in their order; keep what was taken.

A set is one due time: one pulse-echo record of each ultrasonic position, then ten strikes of each
transducer, one transducer after the other. A strike that the quality gate wants again is repeated at
once; what comes after it moves by one interval.
"""

from __future__ import annotations

import itertools
import logging
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from analysis.waves.features import ShotFeatures
from analysis.waves.quality_gate import SUPERSEDED, Attempt, RestrikeRule, outcomes
from daq_service.acquisition.schedule import DueSet
from daq_service.archive import MissedRecord, OpenSet, SetRecord
from hardware_drivers.errors import AcquisitionTimeoutError, ConnectionLostError, InstrumentError
from hardware_drivers.instruments import Rig
from hardware_drivers.measurement import PulseEchoRecord, Shot, ShotKey, Stamp
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

LOST_IN_A_ROW = 3
"""Records running that a lost connection may cost before the set is given up: as many as a driver's
recovery has rungs (fresh tasks, reset, find the board again). The next set tries again."""


MissReason = Literal["no_trigger", "connection_lost"]


@dataclass(frozen=True, slots=True, kw_only=True)
class MissedShot:
    """A strike or echo that left no record.

    Attributes
    ----------
    reason
        ``no_trigger``: nothing came in time; ``connection_lost``: the instrument did not answer.
    """

    key: ShotKey
    cause: str
    reason: MissReason = "no_trigger"


Measurement = Shot | PulseEchoRecord | MissedShot


@dataclass(frozen=True, slots=True, kw_only=True)
class SetPlan:
    """Measurements of a set that are to be made.

    Attributes
    ----------
    positions
        Active positions and their method, in the order in which they are measured.
    """

    due: DueSet
    positions: Mapping[str, str]
    shots_per_set: int
    shot_interval_s: float
    read_timeout_s: float

    def of_method(self, method: str) -> Sequence[str]:
        """Return the positions of one method."""
        return [name for name, its_method in self.positions.items() if its_method == method]


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgressOfSet:
    """Progress of a set before the recorder ended.

    Attributes
    ----------
    started_ns
        Experiment time of its start.
    tried
        Position and shot index of every attempt, with or without a record.
    n_strikes
        Strikes, repetitions included: the slots that are used.
    """

    started_ns: int
    tried: frozenset[tuple[str, int]]
    n_strikes: int


def take_set(
    rig: Rig,
    plan: SetPlan,
    *,
    progress: ProgressOfSet | None = None,
    first_sequence: int,
    boot_id: str,
    idle: Callable[[], bool],
    wants_restrike: Callable[[Shot | MissedShot], bool] = lambda _: False,
    may_strike: Callable[[str], bool] = lambda _: True,
) -> Iterator[Measurement]:
    """Record a set and yield its measurements; end early when ``idle()`` returns False.

    Parameters
    ----------
    progress
        Progress of an earlier process: only the remaining measurements are made, in their original slots if
        these are not over.
    wants_restrike
        Called after each strike that can be repeated; True repeats it.
    may_strike
        Called before each strike; False skips a position that an operator has disabled.

    Raises
    ------
    InstrumentError
        Any error but a missed record; the measurements yielded before are complete. A lost connection is
        raised only after `LOST_IN_A_ROW` consecutive records, when the driver has tried every recovery.
    """
    sequence = itertools.count(first_sequence)
    progress = progress or ProgressOfSet(
        started_ns=max(rig.clock.utc_ns(), plan.due.due_utc_ns), tried=frozenset(), n_strikes=0
    )
    interval_ns = plan.shot_interval_s * NS_PER_S
    start_ns = max(progress.started_ns, rig.clock.utc_ns() - round(progress.n_strikes * interval_ns))
    n_lost = 0
    for position in plan.of_method(PULSE_ECHO):
        if (position, 0) in progress.tried:
            continue
        if not rig.clock.wait_until(start_ns, idle):
            return
        key = ShotKey.in_set(plan.due.set_key, position, 0)
        yield _echo(rig, plan, key, sequence, boot_id)
    strikes = itertools.product(plan.of_method(SOLITARY_WAVE), range(plan.shots_per_set))
    slot = itertools.count(progress.n_strikes)
    for position, shot_index in strikes:
        if (position, shot_index) in progress.tried:
            continue
        for attempt in itertools.count():
            if not may_strike(position):
                break
            if not rig.clock.wait_until(start_ns + round(next(slot) * interval_ns), idle):
                return
            if not may_strike(position):  # commands are executed while waiting
                break
            key = ShotKey.in_set(plan.due.set_key, position, shot_index, attempt)
            measurement, error, last_attempt = _strike(rig, plan, key, sequence, boot_id)
            yield measurement
            n_lost = 0 if error is None else n_lost + 1
            if error is not None and n_lost >= LOST_IN_A_ROW:
                raise error
            if last_attempt or not wants_restrike(measurement):
                break


def _strike(
    rig: Rig, plan: SetPlan, key: ShotKey, sequence: Iterator[int], boot_id: str
) -> tuple[Shot | MissedShot, ConnectionLostError | None, bool]:
    """Arm, strike and read; after any error the coil is off and the digitizer disarmed.

    Returns
    -------
    tuple
        Shot or missed shot, error of a lost connection, and whether the shot cannot be repeated.
    """
    stamp = _stamp(rig, boot_id)
    try:
        rig.digitizer.arm(key)
        rig.striker.strike(key)
        acquired = rig.digitizer.read(plan.read_timeout_s)
    except AcquisitionTimeoutError as error:
        rig.make_safe()
        return MissedShot(key=key, cause=str(error)), None, error.last_attempt
    except ConnectionLostError as error:
        _make_reachable_instruments_safe(rig, error)
        return MissedShot(key=key, cause=str(error), reason="connection_lost"), error, True
    except BaseException:
        rig.make_safe()
        raise
    shot = Shot(
        sequence=next(sequence),
        key=key,
        stamp=stamp,
        waveform=acquired.waveform,
        truth=acquired.truth,
        settings=acquired.settings,
    )
    return shot, None, acquired.last_attempt


def _make_reachable_instruments_safe(rig: Rig, error: ConnectionLostError) -> None:
    """Switch off the instruments that respond; hardware ends the pulse of an unreachable coil."""
    try:
        rig.make_safe()
    except InstrumentError as unreachable:
        error.add_note(f"and it could not be made safe by command: {unreachable}")


def _echo(
    rig: Rig, plan: SetPlan, key: ShotKey, sequence: Iterator[int], boot_id: str
) -> PulseEchoRecord | MissedShot:
    """Acquire one averaged record; a unit that does not respond misses only its own record."""
    assert rig.pulse_echo is not None, "open_rig gives every pulse-echo position its unit"
    stamp = _stamp(rig, boot_id)
    try:
        echo = rig.pulse_echo.acquire(key, plan.read_timeout_s)
    except AcquisitionTimeoutError as error:
        return MissedShot(key=key, cause=str(error))
    except ConnectionLostError as error:
        return MissedShot(key=key, cause=str(error), reason="connection_lost")
    return PulseEchoRecord(
        sequence=next(sequence),
        key=key,
        stamp=stamp,
        waveform=echo.waveform,
        gain_db=echo.gain_db,
        offset_v=echo.offset_v,
        averages=echo.averages,
        truth=echo.truth,
        settings=echo.settings,
    )


def _stamp(rig: Rig, boot_id: str) -> Stamp:
    return Stamp(utc_ns=rig.clock.utc_ns(), mono_ns=rig.clock.mono_ns(), boot_id=boot_id)


# What was taken -------------------------------------------------------------------------------------


@dataclass(slots=True, kw_only=True, eq=False)
class TakenSet:
    """Records, misses and features of the current set, and the results of the quality check.

    Attributes
    ----------
    disabled
        Positions that were left out from the start, with the reason.
    features
        Features of each shot by its sequence.
    trouble
        Instrument error that ended the set; None: it was completed or stopped.
    """

    rule: RestrikeRule
    disabled: Mapping[str, str] = field(default_factory=dict)
    shots: list[Shot] = field(default_factory=list)
    echoes: list[PulseEchoRecord] = field(default_factory=list)
    missed: list[MissedShot] = field(default_factory=list)
    features: dict[int, ShotFeatures] = field(default_factory=dict)
    restrikes: Counter[str] = field(default_factory=Counter)
    trouble: InstrumentError | None = None
    started_ns: int = 0
    ended_ns: int = 0

    def restore(self, opened: OpenSet) -> None:
        """Add the records that an earlier process stored of this set; features are added separately."""
        for record in opened.records:
            self.keep(record)
        for missed in opened.missed:
            reason: MissReason = "connection_lost" if missed.reason == "connection_lost" else "no_trigger"
            self.missed.append(MissedShot(key=missed.key, cause=missed.cause, reason=reason))
        taken: list[Shot | PulseEchoRecord | MissedRecord] = [*opened.records, *opened.missed]
        keys = [item.key for item in taken]
        self.restrikes.update(key.position for key in keys if key.attempt > 0)

    def progress(self, struck: Collection[str]) -> ProgressOfSet:
        """Return the progress of the set; ``struck`` are the positions that have strikers."""
        taken: list[Shot | PulseEchoRecord | MissedShot] = [*self.shots, *self.echoes, *self.missed]
        keys = [item.key for item in taken]
        return ProgressOfSet(
            started_ns=self.started_ns,
            tried=frozenset((key.position, key.shot_index) for key in keys),
            n_strikes=sum(key.position in struck for key in keys),
        )

    def is_complete(self, planned: Mapping[str, int]) -> bool:
        """Return whether every planned shot was tried; positions that were left out are ignored."""
        tried = Counter(position for position, _ in self.progress(()).tried)
        return all(tried[position] >= n for position, n in planned.items() if position not in self.disabled)

    def keep(self, measurement: Measurement) -> None:
        """Add a measurement; a shot's features are added separately (`features`)."""
        if isinstance(measurement, MissedShot):
            log.warning("%s: %s", measurement.key, measurement.cause)
            self.missed.append(measurement)
        elif isinstance(measurement, Shot):
            self.shots.append(measurement)
        else:
            self.echoes.append(measurement)

    def wants_restrike(self, taken: Shot | MissedShot) -> bool:
        """Return whether the quality check repeats a strike, and count the repetition."""
        position = taken.key.position
        flags = ("missed",) if isinstance(taken, MissedShot) else self.features[taken.sequence].flags
        granted = self.rule.wants(flags, attempt=taken.key.attempt, restrikes_so_far=self.restrikes[position])
        if granted:
            self.restrikes[position] += 1
            log.info("%s is %s: struck once more", taken.key, ", ".join(flags))
        return granted

    @property
    def is_empty(self) -> bool:
        """Return whether the set has no record."""
        return not self.shots and not self.echoes

    def n_records(self, position: str) -> int:
        """Count the shots of a position that have a record (each once), or its pulse-echo records."""
        records: list[Shot | PulseEchoRecord] = [*self.shots, *self.echoes]
        return len({item.key.shot_index for item in records if _at(item, position)})

    def shortfall(self, position: str, n_planned: int, stop_reason: str) -> str:
        """Return why a position has fewer records than planned; empty if it has all.

        Parameters
        ----------
        stop_reason
            Why the set was ended without an instrument error.
        """
        if self.n_records(position) >= n_planned:
            return ""
        ended_by = stop_reason if self.trouble is None else str(self.trouble)
        missed = [item for item in self.missed if _at(item, position)]
        attempts: list[Shot | PulseEchoRecord | MissedShot] = [*self.shots, *self.echoes, *missed]
        tried = {item.key.shot_index for item in attempts if _at(item, position)}
        causes = [ended_by] if len(tried) < n_planned else []
        if missed and missed[0].cause not in causes:
            causes.append(f"{len(missed)} missed: {missed[0].cause}")
        return "; ".join(causes)

    def missed_records(self) -> list[MissedRecord]:
        """Return the attempts without a record, in the archive's form."""
        return [MissedRecord(key=item.key, cause=item.cause, reason=item.reason) for item in self.missed]

    def instrument_error(self) -> str:
        """Return the instrument error in the archive's form, ``class: message``; empty if there was none."""
        if self.trouble is None:
            return ""
        # A driver may raise a subclass; the archive stores the class that all drivers share.
        kinds = (kind for kind in type(self.trouble).__mro__ if kind.__module__ == InstrumentError.__module__)
        return f"{next(kinds).__name__}: {self.trouble}"

    def superseded(self) -> dict[int, str]:
        """Return the outcome of the shots that do not count, by sequence."""
        return superseded(self.shots, self.features)


def _at(item: Shot | PulseEchoRecord | MissedShot | MissedRecord, position: str) -> bool:
    return item.key.position == position


def superseded(shots: list[Shot], features: dict[int, ShotFeatures]) -> dict[int, str]:
    """Return the outcome of the shots that are superseded by their repetition, by sequence."""
    superseded_shots: dict[int, str] = {}
    for position in {shot.key.position for shot in shots}:
        shots_here = [shot for shot in shots if shot.key.position == position]
        attempts = [
            Attempt(
                shot_index=shot.key.shot_index,
                attempt=shot.key.attempt,
                quality=features[shot.sequence].quality,
            )
            for shot in shots_here
        ]
        for shot, outcome in zip(shots_here, outcomes(attempts), strict=True):
            if outcome == SUPERSEDED:
                superseded_shots[shot.sequence] = outcome
    return superseded_shots


def n_missed(record: SetRecord, position: str) -> int:
    """Count the strikes or echoes of a position without a record."""
    return sum(_at(item, position) for item in record.missed)


def n_tried(record: SetRecord, position: str) -> int:
    """Count the shots of a position that were struck, with or without a record, without repetitions."""
    tried: list[Shot | MissedRecord] = [*record.shots, *record.missed]
    return sum(_at(item, position) and item.key.attempt == 0 for item in tried)


def n_restrikes(record: SetRecord, position: str) -> int:
    """Count the repetitions of a position's shots, with or without a record."""
    tried: list[Shot | MissedRecord] = [*record.shots, *record.missed]
    return sum(_at(item, position) and item.key.attempt > 0 for item in tried)
