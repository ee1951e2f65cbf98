"""Stored waveforms of a position over some sets, as one array in volts with facts of each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from analysis.waves.quality_gate import ACCEPTED
from daq_service.archive import ArchiveError, FolderSetReader, SetReference
from daq_service.assessment.methods import METHODS
from daq_service.catalogue import Catalogue
from daq_service.catalogue.published_columns import Form, PublishedColumn
from daq_service.catalogue.reader import Filters
from daq_service.catalogue.rows import SetRow, ShotRow
from daq_service.errors import UsageError
from daq_service.web.answers.json_answer import format_hours_as_rfc3339, format_rfc3339
from daq_service.web.tables.choice import Columns, find_last_hour_inside
from hardware_drivers.measurement import Waveform

MOST_SETS = 100_000
"""Limit of sets before the length of a record is known."""
BYTES_A_SAMPLE = 8
COPIED = ("set_index", "shot_index", "sequence", "valid")
"""Columns that are those of the shots."""


def _build_column(name: str, form: Form, unit: str = "") -> PublishedColumn:
    """Build the description of a column of facts about records; only ``quality`` may be missing."""
    return PublishedColumn(name=name, form=form, unit=unit, nullable=name in ("quality",))


OF_RECORD = (
    *(_build_column(name, "integer") for name in ("set_index", "shot_index", "sequence")),
    *(_build_column("due_h", "number", "h"), _build_column("due_utc", "time"), _build_column("utc", "time")),
    *(_build_column("valid", "truth"), _build_column("flags", "text"), _build_column("quality", "text")),
    *(_build_column("readable", "truth"), _build_column("sample_rate_hz", "number", "Hz")),
    _build_column("pretrigger_samples", "integer"),
)
"""Columns of each record; an unreadable one has no volts."""


class NoRecordError(UsageError):
    """No record is stored in the selected sets."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordChoice:
    """Selected records; ``from_h`` is included, ``to_h`` is not, both set indices are; None is open."""

    position: str
    from_h: float | None = None
    to_h: float | None = None
    first_set: int | None = None
    last_set: int | None = None

    def __post_init__(self) -> None:
        """Raise UsageError for a range of hours or sets that ends before it starts."""
        for first, last in ((self.from_h, self.to_h), (self.first_set, self.last_set)):
            if first is not None and last is not None and last < first:
                raise UsageError(f"the range ends at {last:g}, before {first:g}; let it end later")

    @property
    def name(self) -> str:
        """Return the name of the exported file, without suffix: position and set indices."""
        sets = [f"{index:06d}" for index in (self.first_set, self.last_set) if index is not None]
        return "_".join(["waveforms", self.position, *dict.fromkeys(sets)])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordSlice:
    """Records in the order of sets and shots.

    Attributes
    ----------
    columns
        One value per record for each of `OF_RECORD`.
    time_s : ndarray of float64, shape (samples,)
        From the trigger.
    voltage_v : ndarray of float64, shape (records, samples)
        NaN throughout where a record is unreadable.
    """

    columns: Columns
    time_s: NDArray[np.float64]
    voltage_v: NDArray[np.float64]


def read_record_slice(
    catalogue: Catalogue, archive: FolderSetReader, choice: RecordChoice, *, most_bytes: int
) -> RecordSlice:
    """Read the accepted records of the chosen scheduled sets, in the order of sets and shots.

    Nothing but the first record is read if all would exceed ``most_bytes``.

    Raises
    ------
    NoRecordError
        No record is stored there, or none can be read.
    UsageError
        They need more than ``most_bytes`` as volts, differ in length or rate, or are more than 100,000 sets.
    """
    filters: Filters = {
        "position": choice.position,
        "first_set": choice.first_set,
        "last_set": choice.last_set,
        "first_h": choice.from_h,
        "last_h": find_last_hour_inside(choice.to_h),
    }
    rows = catalogue.rows(SetRow, limit=MOST_SETS + 1, **filters)
    sets = {row.set_index: row for row in rows if row.file is not None}
    if not sets:
        raise NoRecordError(
            f"no record of position {choice.position} is stored in these sets; see the table sets"
        )
    if len(rows) > MOST_SETS:
        raise UsageError(f"these are more than {MOST_SETS} sets; choose a shorter range")
    n_records = sum(row.n_taken for row in sets.values())
    # The first record shows whether all of them are too large: nothing else is read before.
    waveforms = _read_waveforms(archive, choice.position, sets)
    read_first = next(waveforms, None)
    if read_first is None:
        raise NoRecordError(
            f"no record of position {choice.position} in these sets can be read; solimon verify shows why"
        )
    _, first = read_first
    if (n_bytes := n_records * first.counts.size * BYTES_A_SAMPLE) > most_bytes:
        raise UsageError(
            f"these are up to {n_records} records of {first.counts.size} samples, {n_bytes / 1e6:.0f} MB in "
            f"volts, of at most {most_bytes / 1e6:.0f} MB at once. Choose a shorter range, or take the whole "
            "test with solimon export --hdf5"
        )
    filters |= {"first_set": min(sets), "last_set": max(sets), "first_h": None, "last_h": None}
    shots = [
        row for row in catalogue.rows(ShotRow, **filters) if row.outcome == ACCEPTED and row.set_index in sets
    ]
    shots.sort(key=lambda row: (row.set_index, row.shot_index))
    row_of = {row.sequence: number for number, row in enumerate(shots)}
    voltage_v = np.full((len(shots), first.counts.size), np.nan)
    readable = [False] * len(shots)
    for sequence, waveform in chain([read_first], waveforms):
        if sequence in row_of:
            _require_same_sampling(choice.position, first, waveform)
            voltage_v[row_of[sequence]] = waveform.volts()
            readable[row_of[sequence]] = True
    method = METHODS[next(iter(sets.values())).method]
    results = catalogue.columns(method.row, ("sequence", "quality"), **filters)
    quality = dict(zip(results["sequence"], results["quality"], strict=True))
    hours = [sets[row.set_index].due_h for row in shots]
    epoch_utc_ns = catalogue.read_experiment().epoch_utc_ns
    return RecordSlice(
        time_s=first.time_s(),
        voltage_v=voltage_v,
        columns={
            **{name: [getattr(row, name) for row in shots] for name in COPIED},
            "due_h": hours,
            "due_utc": format_hours_as_rfc3339(epoch_utc_ns, hours),
            "utc": [format_rfc3339(row.utc_ns) for row in shots],
            "flags": [" ".join(row.flags) for row in shots],
            "quality": [quality.get(row.sequence) for row in shots],
            "readable": readable,
            "sample_rate_hz": [first.sample_rate_hz] * len(shots),
            "pretrigger_samples": [first.pretrigger_samples] * len(shots),
        },
    )


def _read_waveforms(
    archive: FolderSetReader, position: str, sets: Mapping[int, SetRow]
) -> Iterator[tuple[int, Waveform]]:
    """Yield sequence and waveform of each readable record, one set file at a time, in the order of sets.

    Unreadable files and records are left out. ``sets`` are rows with a file, by index.
    """
    for row in sets.values():
        assert row.file is not None, "only such sets are asked for"
        try:
            records = archive.read_position_records(SetReference(row.file), position)
        except ArchiveError:
            continue  # its records stay in the slice as not readable
        yield from ((record.sequence, record.waveform) for record in records)


def _require_same_sampling(position: str, first: Waveform, other: Waveform) -> None:
    """Raise UsageError if two waveforms differ in length, rate or pretrigger: one file has one time axis."""
    if (first.counts.size, first.sample_rate_hz, first.pretrigger_samples) != (
        *(other.counts.size, other.sample_rate_hz, other.pretrigger_samples),
    ):
        raise UsageError(
            f"the records of position {position} in these sets differ in length or rate; choose fewer sets"
        )
