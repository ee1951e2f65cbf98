"""Error classes of a vendor's statuses, from a table that lies next to its driver."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from pathlib import Path

from hardware_drivers.errors import InstrumentError


def read_status_classes(
    file: Path, classes: Iterable[type[InstrumentError]]
) -> dict[int, type[InstrumentError]]:
    """Read the error class of each vendor status number from a TOML file with one table per class.

    Parameters
    ----------
    classes
        Error classes; the file names each of its tables after one of them.

    Raises
    ------
    KeyError
        A table is named after no class of `classes`.
    OSError, ValueError
        The file cannot be read, is no TOML, or a status is no integer.
    """
    tables: dict[str, dict[str, str]] = tomllib.loads(file.read_text(encoding="utf-8"))
    by_name = {kind.__name__: kind for kind in classes}
    return {int(status): by_name[name] for name, table in tables.items() for status in table}
