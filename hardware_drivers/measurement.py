"""Measurements: frozen records of raw counts with the calibration that turns them into volts.

Counts are the truth, volts are derived. Arrays are copied once and made read-only, so a record can
travel from the digitizer to the archive and the analysis without anyone changing it.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE, Method

Counts = NDArray[np.int16] | NDArray[np.int32]


def _copy_read_only(values: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return a copy of an array, with the same shape and type, whose elements cannot be assigned."""
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
        """Copy the coefficients, read-only.

        Raise ValueError for another shape, a resolution outside 2 to 32 bits, or a range that is not
        positive.
        """
        coefficients = np.atleast_1d(np.asarray(self.coefficients_v, dtype=np.float64))
        if coefficients.ndim != 1 or coefficients.size < 2:
            raise ValueError(
                f"coefficients_v needs shape (order + 1,) with order >= 1, got {coefficients.shape}"
            )
        if not 2 <= self.resolution_bits <= 32:
            raise ValueError(f"resolution_bits is {self.resolution_bits}; it must lie in 2..32")
        if not self.range_v > 0.0:
            raise ValueError(f"range_v is {self.range_v} V; it must be positive")
        object.__setattr__(self, "coefficients_v", _copy_read_only(coefficients))

    def volts(self, counts: Counts) -> NDArray[np.float64]:
        """Convert counts of any shape to volts (float64, same shape) by the polynomial `coefficients_v`."""
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
        """Return the ADC's lowest and highest code: -2**(bits - 1) and 2**(bits - 1) - 1."""
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
        """Copy the counts, read-only.

        Raise ValueError for another type or shape, a rate that is not positive, or a pre-trigger outside the
        record.
        """
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
        object.__setattr__(self, "counts", _copy_read_only(counts))

    def volts(self) -> NDArray[np.float64]:
        """Return the record in volts: float64, shape (n_samples,), a new array at each call."""
        return self.calibration.volts(self.counts)

    def time_s(self) -> NDArray[np.float64]:
        """Return each sample's time in s, shape (n_samples,): 0 at the trigger, negative before it."""
        index = np.arange(self.counts.size) - self.pretrigger_samples
        return index / self.sample_rate_hz

    @property
    def clipped(self) -> bool:
        """Return whether any sample is at an end of the ADC's range; False without samples.

        The code next to the lowest one counts too: some boards clip there.
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
        """Return the key as text, ``12`` or, for an unscheduled set, ``12.1``."""
        return f"{self.set_index}.{self.unscheduled_index}" if self.unscheduled_index else str(self.set_index)

    @classmethod
    def parse(cls, text: str) -> SetKey:
        """Parse the text of a set key, ``12`` or ``12.1``; ValueError if a part is not an integer."""
        return cls(*map(int, text.split(".", 1)))

    @property
    def purpose(self) -> Purpose:
        """Return ``confirmation`` for an unscheduled set, ``planned`` for a scheduled one."""
        return "confirmation" if self.unscheduled_index else "planned"

    @property
    def number(self) -> int:
        """Return the key as one integer, ``unscheduled_index * 10_000_000 + set_index``.

        Frames of the journal, and random numbers of the simulated rig, use it.
        """
        return self.unscheduled_index * _SCHEDULED_SETS + self.set_index

    @classmethod
    def from_number(cls, number: int) -> SetKey:
        """Return the key of a number that `number` returned; the inverse of that property.

        Data of earlier versions store that number as the index of the set.
        """
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
        """Return the key of the set, built from `set_index` and `unscheduled_index`."""
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

    def __str__(self) -> str:
        """Return the set in words for messages: ``set 12``, or ``a confirmation set at B``."""
        return f"set {self.set_index}" if self.position is None else f"a confirmation set at {self.position}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotKey(OfSet):
    """Key of a shot in a rig, and of the twin's random numbers."""

    position: str
    set_index: int
    shot_index: int
    attempt: int = 0
    unscheduled_index: int = 0

    def __post_init__(self) -> None:
        """Raise ValueError if an index or the attempt is negative."""
        for name in ("set_index", "shot_index", "attempt", "unscheduled_index"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is {getattr(self, name)}; it must not be negative")

    @classmethod
    def from_set(cls, set_key: SetKey, position: str, shot_index: int, attempt: int = 0) -> ShotKey:
        """Build the key of an attempt (0: first) at a shot of a set; ValueError if an index is negative."""
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
        """Copy truth and settings into read-only mappings."""
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


@lru_cache(maxsize=64)
def compute_crc32(waveform: Waveform) -> int:
    """Return the CRC-32 (zlib's, 0 to 2**32 - 1) of a record's counts as little-endian bytes.

    The last 64 results are cached, as file, acknowledgement and catalogue need that of the same waveform.
    """
    counts = waveform.counts
    return zlib.crc32(counts.astype(counts.dtype.newbyteorder("<"), order="C", copy=False).data)


Results = Mapping[str, Mapping[str, Sequence[float | str]]]
"""Results of a set: name of a table, name of a column, values."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionRecord:
    """Planned records of a position in this set, and why some are missing.

    Attributes
    ----------
    method
        ``solitary_wave`` or ``pulse_echo``.
    n_planned
         Number of planned records.
    cause
        Why fewer were taken; empty if the set is complete.
    serial_number
        Serial number of the transducer; empty if unknown.
    """

    position: str
    method: str
    n_planned: int
    cause: str = ""
    label: str = ""
    serial_number: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SetRecord(OfSet):
    """All measurements of one due time.

    Attributes
    ----------
    due_h
        Hours since the experiment's epoch.
    started_utc_ns, ended_utc_ns
        Experiment time of the first and after the last measurement.
    positions
        Every planned position, also those without a record.
    missed
         Strikes and echoes without a record.
    outcomes
        Sequence of a record to ``accepted`` or ``superseded`` (a repetition of the same shot counts
        instead); a record that is not named is accepted.
    trouble
        The instrument's error that ended the set early, ``class: message``; empty: there was none.
    environment
        JSON-ready: values of supply and climate probe around the set; empty if there are none.
    provenance
        JSON-ready: configuration, ``configuration_hash``, host, versions, the rig's identity.
    results
        A copy of the catalogue's results of the set, NaN for a missing value; empty if the
        set was stored before they were computed.

    Raises
    ------
    ValueError
        No record at all (a set without records has no file), a record of another set or of a position that
        is not in `positions`, or a sequence twice.
    """

    set_index: int
    due_utc_ns: int
    due_h: float
    started_utc_ns: int
    ended_utc_ns: int
    rig_kind: str
    positions: Sequence[PositionRecord]
    shots: Sequence[Shot] = ()
    echoes: Sequence[PulseEchoRecord] = ()
    missed: Sequence[MissedShot] = ()
    outcomes: Mapping[int, str] = field(default_factory=dict)
    trouble: str = ""
    environment: Mapping[str, float | str | None] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    results: Results = field(default_factory=dict)
    unscheduled_index: int = 0

    def __post_init__(self) -> None:
        """Copy positions and measurements into tuples; raise ValueError as the class describes."""
        for name in ("positions", "shots", "echoes", "missed"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        records = self.records
        if not records:
            raise ValueError(f"set {self.set_key} has no record; a set without one has rows but no file")
        names = [position.position for position in self.positions]
        if len(set(names)) != len(names):
            raise ValueError(f"set {self.set_key} names a position twice: {names}")
        for record in records:
            if record.key.set_key != self.set_key or record.key.position not in names:
                raise ValueError(
                    f"shot {record.sequence} is of set {record.key.set_key}, {record.key.position!r}; "
                    f"this is set {self.set_key} of positions {names}"
                )
        if len({record.sequence for record in records}) != len(records):
            raise ValueError(f"set {self.set_key} has a sequence twice; each record needs its own")

    @property
    def due(self) -> DueSet:
        """Return index, due time and, for an unscheduled set, position of the set, without its records."""
        return DueSet(
            set_index=self.set_index,
            unscheduled_index=self.unscheduled_index,
            due_h=self.due_h,
            due_utc_ns=self.due_utc_ns,
            position=self.positions[0].position if self.unscheduled_index else None,
        )

    @property
    def records(self) -> list[Shot | PulseEchoRecord]:
        """Return shots and pulse-echo records in the order of acquisition, which is that of `sequence`."""
        return sorted((*self.shots, *self.echoes), key=lambda record: record.sequence)

    def n_missed(self, position: str) -> int:
        """Count the strikes or echoes of a position without a record, repetitions of a shot included."""
        return sum(item.key.position == position for item in self.missed)

    def n_tried(self, position: str) -> int:
        """Count the first attempts at a position's shots, with or without a record; repetitions do not count.

        A missed echo counts, a recorded one does not.
        """
        return self._list_attempts(position).count(0)

    def n_restrikes(self, position: str) -> int:
        """Count the repeated attempts at a position's shots, with or without a record."""
        return sum(attempt > 0 for attempt in self._list_attempts(position))

    def _list_attempts(self, position: str) -> list[int]:
        """Return the attempt numbers (0: first) of a position's shots with a record, then of those without.

        A missed echo is among the latter.
        """
        tried: list[Shot | MissedShot] = [*self.shots, *self.missed]
        return [item.key.attempt for item in tried if item.key.position == position]
