"""Read waveforms in volts from files of various formats."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq_service.archive import ArchiveError
from daq_service.archive.reader import read_records
from daq_service.cli.offline.csv_lines import COMMENTS, is_comment, mmap_npy, read_csv_lines
from daq_service.errors import UsageError
from daq_service.shared_file import read_shared
from hardware_drivers.errors import ConfigurationError
from hardware_drivers.measurement import Shot
from hardware_drivers.playback.parameters import TdmsMapping

PAPER_RATE_HZ = 10e6
PAPER_PRETRIGGER_S = 100e-6
"""Defaults for `.npy` and `.csv` files: values of the paper."""
FORMATS = ".npy, .csv, .h5 (a set of solimon's) or .tdms"
SEPARATORS = ";\t, "
"""Separators of CSV: the first one in a line counts, since a comma may also be a decimal mark."""
WHOLE_NUMBER = re.compile(r"\s*[+-]?\d+\s*")


@dataclass(frozen=True, slots=True, kw_only=True)
class FileParameters:
    """Given parameters of files; a file's own parameters have priority.

    Attributes
    ----------
    volts_per_count
        Values are counts of an ADC; None: they are volts.
    rails
        Counts at and beyond which the ADC clips; None: the ends of a whole number's type.
    """

    rate_hz: float | None = None
    pretrigger_s: float | None = None
    volts_per_count: float | None = None
    rails: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Record:
    """One waveform; ``position`` of the transducer, empty if unknown."""

    volts_v: NDArray[np.float64]
    rate_hz: float
    pretrigger_samples: int
    clipped: bool
    position: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordFile:
    """Number of records of a file; ``records(k)`` reads every k-th, one by one."""

    n: int
    records: Callable[[int], Iterator[Record]]


def open_records(path: Path, parameters: FileParameters) -> RecordFile:
    """Open a file of waveforms in the format of its suffix.

    Raises
    ------
    UsageError
        The file is missing, unreadable, in no known format, or without a record; also while records are read,
        naming the record.
    """
    reader = {
        ".npy": _open_npy,
        ".csv": _open_csv,
        ".h5": _open_hdf5,
        ".hdf5": _open_hdf5,
        ".nxs": _open_hdf5,
        ".tdms": _open_tdms,
    }.get(path.suffix.lower())
    if reader is None:
        raise UsageError(
            f"{path}: records are read from {FORMATS}, not {path.suffix or 'one without ending'}"
        )
    try:
        found = reader(path, parameters)
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror or error}") from error
    except ArchiveError as error:
        raise UsageError(f"{error}; records of other programs (MATLAB, pandas): save them as .npy") from error
    except ConfigurationError as error:
        raise UsageError(str(error)) from error
    if not found.n:
        raise UsageError(f"{path} holds no record of a solitary wave")
    return found


def _open_npy(path: Path, parameters: FileParameters) -> RecordFile:
    """Open the records of a `.npy` file, shape (records, samples) or (samples,); integers are ADC counts.

    Raises NoTableError for other contents, UsageError for an empty array or as `_make_record_converter`.
    """
    array = mmap_npy(path, "records x samples", one_row=True)
    table = np.atleast_2d(array)
    if not table.shape[1]:
        raise UsageError(f"{path} is empty: shape {array.shape}")
    counts = array.dtype.kind in "iu"
    limits = np.iinfo(array.dtype) if counts else None
    ends = None if limits is None else (float(limits.min), float(limits.max))
    scaled = _make_record_converter(path, parameters, counts=counts, ends=ends)
    return RecordFile(n=len(table), records=lambda every: map(scaled, table[::every]))


def _open_csv(path: Path, parameters: FileParameters) -> RecordFile:
    """Open the records of a CSV file, one per line; a header and an index column are skipped.

    If the first record has only integers, values are ADC counts. Raises NoTableError for an unknown encoding,
    UsageError as `_make_record_converter`.
    """
    _, lines = read_csv_lines(path)
    names = _split_cells(lines[0]) if lines else []
    numbered = [str(k) for k in range(len(names))]
    indexed = names[:1] == [""] and names[1:] == numbered[:-1]  # as pandas writes a table
    if lines and (indexed or names == numbered or not any(map(_is_number, names))):
        del lines[0]
    counts = bool(lines) and all(map(WHOLE_NUMBER.fullmatch, _split_cells(lines[0])))
    scaled = _make_record_converter(path, parameters, counts=counts, ends=None)

    def read_csv_records(every: int) -> Iterator[Record]:
        """Yield every n-th record; raise UsageError for a line without numbers. Other cells become NaN."""
        for number, line in list(enumerate(lines))[::every]:
            if is_comment(line):
                raise UsageError(f"{path}, record {number}: {line[:40]!r} is a comment; {COMMENTS}")
            cells = _split_cells(line)[indexed:]
            if not any(map(_is_number, cells)):
                raise UsageError(f"{path}, record {number}: {line[:40]!r}; a row is a record of numbers")
            yield scaled(np.array([float(cell) if _is_number(cell) else np.nan for cell in cells]))

    return RecordFile(n=len(lines), records=read_csv_records)


def _split_cells(line: str) -> list[str]:
    """Split a line of CSV at its separator, the first of `SEPARATORS` that it contains.

    Separators at its end are dropped. With a semicolon or tab, commas become decimal points.
    """
    separator = next((one for one in SEPARATORS if one in line.strip()), ",")
    cells = line.strip().rstrip(separator).split(None if separator == " " else separator)
    return [cell.replace(",", ".") for cell in cells] if separator in ";\t" else cells


def _is_number(cell: str) -> bool:
    """Return whether Python can convert a cell to a float; NaN and infinity count."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _make_record_converter(
    path: Path, parameters: FileParameters, *, counts: bool, ends: tuple[float, float] | None
) -> Callable[[NDArray[np.generic]], Record]:
    """Create the function that converts values of a file without metadata to a record in V.

    Missing parameters are those of the paper. ``counts`` marks integers; ``ends`` is their range, used as
    rails if none are given. Raises UsageError for counts without ``volts_per_count``, or rails without it.
    """
    if counts and parameters.volts_per_count is None:
        raise UsageError(
            f"{path} holds integers, which are counts of an ADC: give --volts-per-count, and with it "
            "--rail-counts LOW,HIGH where the ADC has fewer bits than the numbers"
        )
    if parameters.rails is not None and parameters.volts_per_count is None:
        raise UsageError(f"--rail-counts are counts, yet {path} holds volts: give --volts-per-count too")
    rails = parameters.rails or ends
    rate_hz = parameters.rate_hz or PAPER_RATE_HZ
    pretrigger_s = PAPER_PRETRIGGER_S if parameters.pretrigger_s is None else parameters.pretrigger_s

    def convert_to_record(values: NDArray[np.generic]) -> Record:
        """Convert values to a record in volts; mark it as clipped if one reaches the rails."""
        volts = values.astype(np.float64)
        clipped = _is_clipped(volts, rails)
        if parameters.volts_per_count is not None:
            volts *= parameters.volts_per_count
        return Record(
            volts_v=volts,
            rate_hz=rate_hz,
            pretrigger_samples=round(pretrigger_s * rate_hz),
            clipped=clipped,
        )

    return convert_to_record


def _open_hdf5(path: Path, _: FileParameters) -> RecordFile:
    """Open the solitary-wave records of a set's HDF5 file, which is read completely.

    Raises CorruptArchiveError for a corrupt file, OSError for an unreadable one.
    """
    shots = [one for one in read_records(path, read_shared(path)) if isinstance(one, Shot)]

    def read_hdf5_records(every: int) -> Iterator[Record]:
        """Yield every n-th record of the file with its position."""
        for shot in shots[::every]:
            waveform = shot.waveform
            yield Record(
                volts_v=waveform.volts(),
                rate_hz=waveform.sample_rate_hz,
                pretrigger_samples=waveform.pretrigger_samples,
                clipped=waveform.clipped,
                position=shot.key.position,
            )

    return RecordFile(n=len(shots), records=read_hdf5_records)


def _open_tdms(path: Path, parameters: FileParameters) -> RecordFile:
    """Open the records of a TDMS file, channel by channel; the group is the position.

    Raises UsageError if npTDMS or a parameter is missing.
    """
    from hardware_drivers.playback.tdms_records import list_channel_records

    mapping = TdmsMapping(
        sample_rate_hz=parameters.rate_hz,
        coefficients_v=() if parameters.volts_per_count is None else (0.0, parameters.volts_per_count),
    )
    try:
        channels = list_channel_records(
            path,
            mapping,
            pretrigger_s=parameters.pretrigger_s,
            rails_marked=parameters.rails is not None,
            unitless_are_volts=True,
        )
    except ConfigurationError as error:
        raise UsageError(f"{error} (--rate-hz, --pretrigger-s, --volts-per-count, --rail-counts)") from error

    def read_tdms_records() -> Iterator[Record]:
        """Yield each record of the channels in V, in file order."""
        for one in channels:
            ends = parameters.rails
            if ends is None and one.conversion.polynomial is None:
                ends = one.conversion.calibration.full_scale_counts
            for values in one.values():
                yield Record(
                    volts_v=one.volts(values),
                    rate_hz=one.sample_rate_hz,
                    pretrigger_samples=one.pretrigger_samples,
                    clipped=_is_clipped(values, ends),
                    position=one.channel.group,
                )

    return RecordFile(
        n=sum(one.n for one in channels), records=lambda every: islice(read_tdms_records(), 0, None, every)
    )


def _is_clipped(values: NDArray[np.generic], ends: tuple[float, float] | None) -> bool:
    """Return whether a value reaches an end of the input range; False if the range is unknown."""
    return ends is not None and bool(values.min() <= ends[0] or values.max() >= ends[1])
