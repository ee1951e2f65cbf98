"""Write a table of a test, or a part of one, to files in the formats of their names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from daq_service.catalogue import open_catalogue
from daq_service.cli.keeping.export import refuse_target
from daq_service.errors import StorageUnavailableError, UsageError
from daq_service.processes.freshness import Freshness
from daq_service.shared_file import write_durably
from daq_service.web.tables.choice import Choice
from daq_service.web.tables.export import exported
from daq_service.web.tables.formats import FORMATS


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportedTable:
    """A file of a table."""

    file: str
    table: str
    n_bytes: int


def export_table(
    folder: Path, choice: Choice, targets: Sequence[Path], *, overwrite: bool = False
) -> list[ExportedTable]:
    """Write what was chosen to each of the files, also of a test that runs.

    Raises
    ------
    UsageError
        A name has none of the endings, a file exists, or there is no test or no such position.
    StorageError
        The catalogue cannot be read, or the disk does not take a file; one that was there stays.
    """
    forms = [_form(target) for target in targets]
    for target in targets:
        refuse_target(folder, target, overwrite=overwrite)
    made = []
    with open_catalogue(folder) as catalogue:
        experiment = catalogue.experiment_row()
        positions = experiment.configuration["positions"]
        if choice.position is not None and choice.position not in positions:
            raise UsageError(f"there is no position {choice.position!r}; choose from {', '.join(positions)}")
        fresh = Freshness(folder, catalogue, experiment.clock)
        for target, form in zip(targets, forms, strict=True):
            parts = exported(catalogue, fresh, choice, form)
            try:
                write_durably(target, parts, temporary=target.with_name(f"{target.name}.part"))
            except OSError as error:
                raise StorageUnavailableError(
                    f"{target} cannot be written: {error}; free or mend the disk"
                ) from error
            made.append(ExportedTable(file=str(target), table=choice.table, n_bytes=target.stat().st_size))
    return made


def _form(target: Path) -> str:
    form = {"hdf5": "h5"}.get(target.suffix[1:].lower(), target.suffix[1:].lower())
    if form not in FORMATS:
        raise UsageError(f"{target} has no known ending; choose from {', '.join(FORMATS)}")
    return form
