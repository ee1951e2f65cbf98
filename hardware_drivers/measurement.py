"""Measurements: frozen records of raw counts with the calibration that turns them into volts.

Counts are the truth, volts are derived. Arrays are copied once and made read-only, so a record can
travel from the digitizer to the archive and the analysis without anyone changing it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE, Method

Counts = NDArray[np.int16] | NDArray[np.int32]


def _read_only(values: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return a copy of an array that cannot be changed."""
    copy = np.array(values, copy=True)
    copy.flags.writeable = False
    return copy


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """Conversion of an ADC's counts into volts.

    Attributes
    ----------
    coefficients_v
        float64, shape (order + 1,): ``volts = sum(coefficients_v[k] * counts**k)``.
    resolution_bits
        ADC resolution; a code at either end of the range counts as clipped.
    range_v
        Full scale is ``-range_v .. +range_v``.
    date
        ISO date of the calibration, empty if unknown.
    """

    coefficients_v: NDArray[np.float64]
    resolution_bits: int
    range_v: float
    date: str = ""

    def __post_init__(self) -> None:
        coefficients = np.atleast_1d(np.asarray(self.coefficients_v, dtype=np.float64))
        if coefficients.ndim != 1 or coefficients.size < 2:
            raise ValueError(
                f"coefficients_v needs shape (order + 1,) with order >= 1, got {coefficients.shape}"
            )
        if not 2 <= self.resolution_bits <= 32:
            raise ValueError(f"resolution_bits is {self.resolution_bits}; it must lie in 2..32")
        if not self.range_v > 0.0:
            raise ValueError(f"range_v is {self.range_v} V; it must be positive")
        object.__setattr__(self, "coefficients_v", _read_only(coefficients))

    def volts(self, counts: Counts) -> NDArray[np.float64]:
        """Convert counts of any shape into volts of the same shape."""
        code = counts.astype(np.float64)
        # Horner's rule in place, as numpy's polyval computes it: every shot passes here.
        volts: NDArray[np.float64] = self.coefficients_v[-1] * code
        volts += self.coefficients_v[-2]
        for coefficient in self.coefficients_v[-3::-1]:
            volts *= code
            volts += coefficient
        return volts

    @property
    def full_scale_counts(self) -> tuple[int, int]:
        """Return the lowest and highest code of the ADC."""
        half = 1 << (self.resolution_bits - 1)
        return -half, half - 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Waveform:
    """Finite record of one channel.

    Attributes
    ----------
    counts
        int16 or int32, shape (n_samples,).
    sample_rate_hz
        The rate the hardware really used.
    pretrigger_samples
        Samples before the trigger; time zero is the trigger.
    """

    counts: Counts
    sample_rate_hz: float
    pretrigger_samples: int
    calibration: Calibration

    def __post_init__(self) -> None:
        counts = np.asarray(self.counts)
        if counts.dtype not in (np.dtype(np.int16), np.dtype(np.int32)) or counts.ndim != 1:
            raise ValueError(
                f"counts must be int16 or int32 of shape (n_samples,), got {counts.dtype} {counts.shape}"
            )
        if not self.sample_rate_hz > 0.0:
            raise ValueError(f"sample_rate_hz is {self.sample_rate_hz}; it must be positive")
        if not 0 <= self.pretrigger_samples <= counts.size:
            raise ValueError(
                f"pretrigger_samples is {self.pretrigger_samples}; it must lie in 0..{counts.size}"
            )
        object.__setattr__(self, "counts", _read_only(counts))

    def volts(self) -> NDArray[np.float64]:
        """Return the record in volts, shape (n_samples,)."""
        return self.calibration.volts(self.counts)

    def time_s(self) -> NDArray[np.float64]:
        """Return the time of each sample from the trigger in s, shape (n_samples,)."""
        index = np.arange(self.counts.size) - self.pretrigger_samples
        return index / self.sample_rate_hz

    @property
    def clipped(self) -> bool:
        """Return whether any sample is at an end of the ADC's range.

        Some boards clip at the same code on both sides, one short of the lowest: that counts too.
        """
        low, high = self.calibration.full_scale_counts
        return bool(self.counts.size and (self.counts.min() <= low + 1 or self.counts.max() >= high))


_SCHEDULED_SETS = 10_000_000
"""Number of scheduled sets that `SetKey.number` distinguishes."""
MOST_UNSCHEDULED = 200
"""Maximum number of unscheduled sets between two scheduled ones: each `SetKey.number` is below 2**31."""

Purpose = Literal["planned", "confirmation"]


class SetKey(NamedTuple):
    """Key of a set; keys sort in the order of the sets, their text is ``12`` or ``12.1``.

    Attributes
    ----------
    set_index
        Index of a scheduled set.
    unscheduled_index
        0: that set itself; n: the n-th unscheduled set after it.
    """

    set_index: int
    unscheduled_index: int = 0

    def __str__(self) -> str:
        return f"{self.set_index}.{self.unscheduled_index}" if self.unscheduled_index else str(self.set_index)

    @classmethod
    def parse(cls, text: str) -> SetKey:
        """Return the key with this text; a ValueError if there is none."""
        return cls(*map(int, text.split(".", 1)))

    @property
    def purpose(self) -> Purpose:
        """Return the purpose of the set."""
        return "confirmation" if self.unscheduled_index else "planned"

    @property
    def number(self) -> int:
        """Return the key as one number: in frames of the journal and in the twin's random numbers."""
        return self.unscheduled_index * _SCHEDULED_SETS + self.set_index

    @classmethod
    def of_number(cls, number: int) -> SetKey:
        """Return the key of a number: data of earlier versions store it as the index of the set."""
        unscheduled_index, set_index = divmod(number, _SCHEDULED_SETS)
        return cls(set_index, unscheduled_index)


class OfSet:
    """Base of everything that belongs to one set.

    Attributes
    ----------
    set_index, unscheduled_index
        Index of the scheduled set, and number of the unscheduled set after it (0: none).
    """

    __slots__ = ()
    if TYPE_CHECKING:  # the fields are those of the dataclasses
        set_index: int
        unscheduled_index: int

    @property
    def set_key(self) -> SetKey:
        """Return the key of the set."""
        return SetKey(self.set_index, self.unscheduled_index)


@dataclass(frozen=True, slots=True, kw_only=True)
class DueSet(OfSet):
    """One scheduled set of every position, or one unscheduled set.

    Attributes
    ----------
    position
        Position of an unscheduled set; None: a scheduled set.
    """

    set_index: int
    due_h: float
    due_utc_ns: int
    position: str | None = None
    unscheduled_index: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotKey(OfSet):
    """Key of a shot in a rig, and of the twin's random numbers."""

    position: str
    set_index: int
    shot_index: int
    attempt: int = 0
    unscheduled_index: int = 0

    def __post_init__(self) -> None:
        for name in ("set_index", "shot_index", "attempt", "unscheduled_index"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is {getattr(self, name)}; it must not be negative")

    @classmethod
    def in_set(cls, set_key: SetKey, position: str, shot_index: int, attempt: int = 0) -> ShotKey:
        """Return the key of a shot of a set."""
        return cls(
            position=position,
            set_index=set_key.set_index,
            unscheduled_index=set_key.unscheduled_index,
            shot_index=shot_index,
            attempt=attempt,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Stamp:
    """Time of a record: test UTC, monotonic time and the boot it belongs to."""

    utc_ns: int
    mono_ns: int
    boot_id: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Record:
    """Record with its position in the sequence and its metadata.

    Attributes
    ----------
    sequence
        Strictly increasing in an archive: the order, whatever the clocks say.
    truth
        What a simulated rig knows about the shot (SI units in the names); empty on a real rig.
    settings
        What the instrument says of its record: board, trigger level, calibration temperature, versions
        (SI units in the names).
    """

    sequence: int
    key: ShotKey
    stamp: Stamp
    waveform: Waveform
    truth: Mapping[str, float] = field(default_factory=dict)
    settings: Mapping[str, float | str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "truth", MappingProxyType(dict(self.truth)))
        object.__setattr__(self, "settings", MappingProxyType(dict(self.settings)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shot(_Record):
    """Strike of one transducer and its record."""

    method: ClassVar[Method] = SOLITARY_WAVE


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PulseEchoRecord(_Record):
    """Averaged ultrasonic record of one position.

    Attributes
    ----------
    waveform
        Time zero is the firing pulse; ``pretrigger_samples`` is 0.
    gain_db, offset_v
        Receiver settings the record was taken with.
    averages
        Number of records averaged.
    """

    method: ClassVar[Method] = PULSE_ECHO
    gain_db: float
    offset_v: float
    averages: int


@dataclass(frozen=True, slots=True, kw_only=True)
class MissedShot:
    """A strike or echo without a record.

    Attributes
    ----------
    reason
        ``no_trigger``: nothing came in time; ``connection_lost``: the instrument did not answer.
    """

    key: ShotKey
    cause: str
    reason: str = "no_trigger"


Measurement = Shot | PulseEchoRecord | MissedShot


@dataclass(frozen=True, slots=True, kw_only=True)
class SupplyReading:
    """Measurement of the electrochemical supply."""

    stamp: Stamp
    voltage_v: float
    current_a: float
    output_on: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ClimateReading:
    """Measurement of the air at the specimen.

    Attributes
    ----------
    relative_humidity
        0 (dry) to 1 (saturated).
    """

    stamp: Stamp
    temperature_c: float
    relative_humidity: float
