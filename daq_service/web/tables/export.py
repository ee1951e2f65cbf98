"""Complete export: the bytes of a selection in a format, with facts about its origin."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import version

from daq_service.catalogue import Catalogue
from daq_service.catalogue.rows import ExperimentRow
from daq_service.clock import format_utc
from daq_service.errors import UsageError
from daq_service.processes.freshness import Freshness
from daq_service.web.tables.choice import Choice, Columns, read_pages
from daq_service.web.tables.formats import FORMATS, Facts


def encode_table(
    catalogue: Catalogue, fresh: Freshness, choice: Choice, form: str, *, most_rows: int | None = None
) -> Iterator[bytes]:
    """Encode a table as a file and yield its parts; streamed formats read a page for each part.

    Parameters
    ----------
    form
        One of `formats.FORMATS`.
    most_rows
        Limit for formats that hold all rows; None: no limit.

    Raises
    ------
    UsageError
        There are more rows, or a package for the format is missing; before the first part.
    """
    kind = FORMATS[form]
    read = read_pages(catalogue, fresh, choice)
    if kind.whole and most_rows is not None:
        read = _limit_rows(read, form, most_rows)
    about = {
        **{name: getattr(choice, name) for name in ("table", "position", "from_h", "to_h", "purpose")},
        "units": {column.name: column.unit for column in choice.columns if column.unit},
    }
    return kind.write(choice, build_facts(catalogue.read_experiment(), fresh, about), read)


def _limit_rows(read: Iterator[Columns], form: str, most_rows: int) -> Iterator[Columns]:
    """Yield the pages of a table; raise UsageError at the page that exceeds ``most_rows`` in total."""
    n_rows = 0
    for page in read:
        n_rows += len(next(iter(page.values())))
        if n_rows > most_rows:
            raise UsageError(
                f"these are more than {most_rows} rows, which the service does not hold at once for {form}. "
                "Take csv, parquet or arrow, which have no limit, a shorter range, or solimon export"
            )
        yield page


def build_facts(experiment: ExperimentRow, fresh: Freshness, about: Facts) -> Facts:
    """Return the facts of an exported file: ``about``, and test, present time, recorder and version."""
    return {
        **about,
        "test": experiment.name,
        "epoch_utc": format_utc(experiment.epoch_utc_ns),
        "now_utc": format_utc(fresh.now_utc_ns),
        "now_h": fresh.now_h,
        "recorder": fresh.recorder.status,
        "configuration_hash": experiment.configuration_hash,
        "solimon_version": version("solimon"),
    }
