"""Export a table of a test, or waveforms of a position, in the formats of the file names."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from daq_service.archive import FolderSetReader
from daq_service.catalogue import Catalogue, open_catalogue
from daq_service.cli.maintenance.export import refuse_unsafe_target
from daq_service.errors import UsageError
from daq_service.processes.freshness import Freshness
from daq_service.shared_file import write_output
from daq_service.web.tables.choice import Choice
from daq_service.web.tables.export import encode_table
from daq_service.web.tables.formats import FORMATS
from daq_service.web.tables.record_formats import NAME as RECORDS
from daq_service.web.tables.record_formats import encode_records
from daq_service.web.tables.records import RecordChoice, RecordSlice, read_record_slice

Parts = Iterator[bytes]
Make = Callable[[Catalogue, Freshness, str], Parts]
"""Gives the bytes of a file in a format."""
MOST_RECORD_BYTES = 1_000_000_000
"""Of records in volts: they are in memory while a file is made."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportedTable:
    """A file of a table; that of records is called ``waveforms``."""

    file: str
    table: str
    n_bytes: int


def export_table(
    folder: Path, choice: Choice, targets: Sequence[Path], *, overwrite: bool = False
) -> list[ExportedTable]:
    """Write the chosen table to each of the files, also for a running test; return one result per file.

    Raises
    ------
    UsageError
        A name has none of the endings, a file exists, or there is no test or no such position.
    StorageError
        The catalogue cannot be read, or the disk does not take a file; one that was there stays.
    """
    return _write_export_files(
        folder,
        *(choice.position, choice.table, targets),
        lambda catalogue, fresh, form: encode_table(catalogue, fresh, choice, form),
        overwrite=overwrite,
    )


def export_records(
    folder: Path, choice: RecordChoice, targets: Sequence[Path], *, overwrite: bool = False
) -> list[ExportedTable]:
    """Write the chosen records in V to each of the files, also for a running test.

    Records are held in memory. Returns one result per file, of the table ``waveforms``.

    Raises
    ------
    UsageError
        As `export_table`; or there are no such records, or more than `MOST_RECORD_BYTES`.
    StorageError
        As `export_table`.
    """
    read: list[RecordSlice] = []

    def make_file(catalogue: Catalogue, fresh: Freshness, form: str) -> Parts:
        """Encode the records in a format; they are read at the first call only.

        Raises UsageError if there are no such records, or too many.
        """
        if not read:
            archive = FolderSetReader(folder)
            read.append(read_record_slice(catalogue, archive, choice, most_bytes=MOST_RECORD_BYTES))
        return iter([encode_records(catalogue, fresh, choice, read[0], form)])

    return _write_export_files(folder, choice.position, RECORDS, targets, make_file, overwrite=overwrite)


def _write_export_files(
    folder: Path, position: str | None, table: str, targets: Sequence[Path], make: Make, *, overwrite: bool
) -> list[ExportedTable]:
    """Write a table to each target in the format of its suffix, and return the files written.

    Raises UsageError before the first write if a target or the position is refused, StorageError if the
    catalogue cannot be read or a file cannot be written.
    """
    forms = [_parse_export_format(target) for target in targets]
    for target in targets:
        refuse_unsafe_target(folder, target, overwrite=overwrite)
    files = []
    with open_catalogue(folder) as catalogue:
        experiment = catalogue.read_experiment()
        positions = experiment.configuration["positions"]
        if position is not None and position not in positions:
            raise UsageError(f"there is no position {position!r}; choose from {', '.join(positions)}")
        fresh = Freshness(folder, catalogue, experiment.clock)
        for target, form in zip(targets, forms, strict=True):
            write_output(target, make(catalogue, fresh, form))
            files.append(ExportedTable(file=str(target), table=table, n_bytes=target.stat().st_size))
    return files


def _parse_export_format(target: Path) -> str:
    """Return the export format of a target's suffix, in any case; raise UsageError for an unknown one."""
    form = {"hdf5": "h5"}.get(target.suffix[1:].lower(), target.suffix[1:].lower())
    if form not in FORMATS:
        raise UsageError(f"{target} has no known ending; choose from {', '.join(FORMATS)}")
    return form
