"""Record one set with the instruments of a rig: strike, read, and yield the measurements in their order.

A set is one due time: one pulse-echo record of each ultrasonic position, then ten strikes of each
transducer, one transducer after the other. A strike that the quality gate wants again is repeated at
once; what comes after it moves by one interval.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from hardware_drivers.errors import AcquisitionTimeoutError, ConnectionLostError, InstrumentError
from hardware_drivers.instruments import Rig
from hardware_drivers.measurement import (
    DueSet,
    Measurement,
    MissedShot,
    PulseEchoRecord,
    Shot,
    ShotKey,
    Stamp,
)
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE
from hardware_drivers.nanoseconds import NS_PER_S

LOST_IN_A_ROW = 3
"""Records running that a lost connection may cost before the set is given up: as many as a driver's
recovery has rungs (fresh tasks, reset, find the board again). The next set tries again."""


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

    def list_positions(self, method: str) -> Sequence[str]:
        """Return the active positions of one measuring method, in the order in which they are measured."""
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
    """Record a set and yield its measurements as they are made; end early when ``idle()`` returns False.

    Pulse-echo positions come first, then the strikes of one position after the other. Blocks while waiting
    for their slots.

    Parameters
    ----------
    progress
        Progress of an earlier process: only the remaining measurements are made, in their original slots if
        these are not over.
    first_sequence
        Number of the first record; the following ones are counted from it.
    wants_restrike
        Called after each strike that can be repeated; True repeats it.
    may_strike
        Called before each strike; False skips a position that an operator has disabled.

    Raises
    ------
    InstrumentError
        Any error but a missed record; the measurements yielded before are complete. A lost connection is
        raised only after `LOST_IN_A_ROW` consecutive strikes, when the driver has tried every recovery.
    """
    sequence = itertools.count(first_sequence)
    progress = progress or ProgressOfSet(
        started_ns=max(rig.clock.utc_ns(), plan.due.due_utc_ns), tried=frozenset(), n_strikes=0
    )
    interval_ns = plan.shot_interval_s * NS_PER_S
    start_ns = max(progress.started_ns, rig.clock.utc_ns() - round(progress.n_strikes * interval_ns))
    n_lost = 0
    for position in plan.list_positions(PULSE_ECHO):
        if (position, 0) in progress.tried:
            continue
        if not rig.clock.wait_until(start_ns, idle):
            return
        key = ShotKey.from_set(plan.due.set_key, position, 0)
        yield _acquire_echo(rig, plan, key, sequence, boot_id)
    strikes = itertools.product(plan.list_positions(SOLITARY_WAVE), range(plan.shots_per_set))
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
            key = ShotKey.from_set(plan.due.set_key, position, shot_index, attempt)
            measurement, error, last_attempt = _acquire_shot(rig, plan, key, sequence, boot_id)
            yield measurement
            n_lost = 0 if error is None else n_lost + 1
            if error is not None and n_lost >= LOST_IN_A_ROW:
                raise error
            if last_attempt or not wants_restrike(measurement):
                break


def _acquire_shot(
    rig: Rig, plan: SetPlan, key: ShotKey, sequence: Iterator[int], boot_id: str
) -> tuple[Shot | MissedShot, ConnectionLostError | None, bool]:
    """Arm, strike and read one shot, stamped at its start; after any error the rig is made safe.

    A record takes the next number of ``sequence``; a missed shot takes none.

    Returns
    -------
    tuple
        Shot or missed shot, error of a lost connection (None without one), and whether the shot cannot be
        repeated.

    Raises
    ------
    BaseException
        Any error but a timeout or a lost connection, raised again after the rig was made safe.
    """
    stamp = _read_time_stamp(rig, boot_id)
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
    """Make the rig safe after a lost connection; an instrument error of that is added to ``error`` as a note.

    It is not raised: hardware ends the pulse of an unreachable coil.
    """
    try:
        rig.make_safe()
    except InstrumentError as unreachable:
        error.add_note(f"and it could not be made safe by command: {unreachable}")


def _acquire_echo(
    rig: Rig, plan: SetPlan, key: ShotKey, sequence: Iterator[int], boot_id: str
) -> PulseEchoRecord | MissedShot:
    """Acquire one averaged pulse-echo record; return a `MissedShot` after a timeout or a lost connection.

    A record takes the next number of ``sequence``; a missed one takes none. Any other instrument error is
    raised.
    """
    assert rig.pulse_echo is not None, "open_rig gives every pulse-echo position its unit"
    stamp = _read_time_stamp(rig, boot_id)
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


def _read_time_stamp(rig: Rig, boot_id: str) -> Stamp:
    """Return test UTC and monotonic time (ns) of the rig's clock as a stamp of boot ``boot_id``."""
    return Stamp(utc_ns=rig.clock.utc_ns(), mono_ns=rig.clock.mono_ns(), boot_id=boot_id)
