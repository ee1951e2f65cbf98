"""Take one set: strike, read, and yield what came, in the order in which it was taken.

A set is one due time: one pulse-echo record of each ultrasonic position, then ten strikes of each
transducer, one transducer after the other.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from daq_service.schedule import DueSet
from hardware_drivers.errors import AcquisitionTimeoutError
from hardware_drivers.instruments import Rig
from hardware_drivers.measurement import PulseEchoRecord, Shot, ShotKey, Stamp

NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class MissedShot:
    """A strike that left no record."""

    key: ShotKey
    cause: str


Measurement = Shot | PulseEchoRecord | MissedShot


@dataclass(frozen=True, slots=True, kw_only=True)
class SetPlan:
    """What is wanted of a set.

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
        """Positions of one method."""
        return [name for name, its_method in self.positions.items() if its_method == method]


def take_set(
    rig: Rig, plan: SetPlan, *, first_sequence: int, boot_id: str, idle: Callable[[], bool]
) -> Iterator[Measurement]:
    """Yield the measurements of a set; ends early once ``idle()`` is False.

    Raises
    ------
    InstrumentError
        Anything but a missed record; what was yielded before is whole.
    """
    sequence = itertools.count(first_sequence)
    start_ns = max(rig.clock.utc_ns(), plan.due.due_utc_ns)
    for position in plan.of_method("pulse_echo"):
        if not rig.clock.wait_until(start_ns, idle):
            return
        yield _echo(
            rig,
            plan,
            ShotKey(position=position, set_index=plan.due.set_index, shot_index=0),
            sequence,
            boot_id,
        )
    strikes = itertools.product(plan.of_method("solitary_wave"), range(plan.shots_per_set))
    for number, (position, shot_index) in enumerate(strikes):
        if not rig.clock.wait_until(start_ns + round(number * plan.shot_interval_s * NS_PER_S), idle):
            return
        key = ShotKey(position=position, set_index=plan.due.set_index, shot_index=shot_index)
        yield _strike(rig, plan, key, sequence, boot_id)


def _strike(
    rig: Rig, plan: SetPlan, key: ShotKey, sequence: Iterator[int], boot_id: str
) -> Shot | MissedShot:
    """Arm, strike, read; whatever happens the coil is off and the digitizer disarmed afterwards."""
    stamp = _stamp(rig, boot_id)
    try:
        rig.digitizer.arm(key)
        rig.striker.strike(key)
        acquired = rig.digitizer.read(plan.read_timeout_s)
    except AcquisitionTimeoutError as error:
        rig.make_safe()
        return MissedShot(key=key, cause=str(error))
    except BaseException:
        rig.make_safe()
        raise
    return Shot(
        sequence=next(sequence), key=key, stamp=stamp, waveform=acquired.waveform, truth=acquired.truth
    )


def _echo(
    rig: Rig, plan: SetPlan, key: ShotKey, sequence: Iterator[int], boot_id: str
) -> PulseEchoRecord | MissedShot:
    assert rig.pulse_echo is not None, "open_rig gives every pulse-echo position its unit"
    stamp = _stamp(rig, boot_id)
    try:
        echo = rig.pulse_echo.acquire(key, plan.read_timeout_s)
    except AcquisitionTimeoutError as error:
        return MissedShot(key=key, cause=str(error))
    return PulseEchoRecord(
        sequence=next(sequence),
        key=key,
        stamp=stamp,
        waveform=echo.waveform,
        gain_db=echo.gain_db,
        offset_v=echo.offset_v,
        averages=echo.averages,
        truth=echo.truth,
    )


def _stamp(rig: Rig, boot_id: str) -> Stamp:
    return Stamp(utc_ns=rig.clock.utc_ns(), mono_ns=rig.clock.mono_ns(), boot_id=boot_id)
