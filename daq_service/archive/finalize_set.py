"""Finalize sets: write a journaled set to its own file, read it back and compare it."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from daq_service.archive.errors import CorruptArchiveError, SetNotFoundError
from daq_service.archive.journal.reader import read_journal
from daq_service.archive.layout import Record, build_set_image
from daq_service.archive.reader import read_records
from daq_service.archive.records import TEMPORARY_SUFFIX, Places, SetReference
from daq_service.shared_file import read_shared, write_durably
from hardware_drivers.measurement import Results, SetKey, SetRecord


def finalize_set(
    folder: Path,
    set_key: SetKey,
    places: Places | None = None,
    results: Results = MappingProxyType({}),
    also: Callable[[SetRecord], str] | None = None,
) -> tuple[SetReference, str, str]:
    """Write a complete set of the journal to its own file, or compare the file that it has.

    Reads the file back and compares it; the journal is unchanged, since only the recorder removes its frames.

    Parameters
    ----------
    places
        Where the journal has the set (`Archive.places`); None: search all segments.
    results
         Tables of results computed from the set; they are written to a new file.
    also
        Called with the set after its file is compared; returns an error text, empty on success.

    Returns
    -------
    tuple
        The file, its SHA-256 in hexadecimal, and the text of ``also`` (empty without it).

    Raises
    ------
    SetNotFoundError
        The journal has no such set.
    CorruptArchiveError
        The set has no end, a record of it is damaged, or the file differs from the journal.
    OSError
        The disk refuses.
    """
    journaled = read_journal(folder, of_set=set_key, places=places).get(set_key)
    if journaled is None:
        raise SetNotFoundError(f"the journal of {folder} has no set {set_key}")
    if (reference := journaled.reference) is None:
        raise CorruptArchiveError(f"set {set_key} in the journal has no end; the journal keeps it")
    if damages := journaled.damages():
        raise CorruptArchiveError(f"set {set_key} in the journal: {'; '.join(map(str, damages))}")
    record, path = replace(journaled.record(), results=results), folder / reference
    image = build_set_image(record)
    if is_new := not path.exists():
        # A worker of a killed recorder may still write the same set, so each uses its own temporary name.
        temporary = path.with_suffix(f".{os.getpid()}{TEMPORARY_SUFFIX}")
        write_durably(path, image, temporary=temporary)
    content = read_shared(path)
    if is_new and content != image:
        raise CorruptArchiveError(f"{path} does not read as it was written; the journal keeps the set")
    if not _records_match(read_records(path, content, is_own=content == image), record.records):
        raise CorruptArchiveError(f"{path} is not what the journal holds; the journal keeps the set")
    return reference, hashlib.sha256(content).hexdigest(), also(record) if also else ""


def _records_match(stored: Sequence[Record], records: Sequence[Record]) -> bool:
    """Return whether two lists have the same records in order: sequence, key, time stamp and counts."""
    return len(stored) == len(records) and all(
        (a.sequence, a.key, a.stamp) == (b.sequence, b.key, b.stamp)
        and np.array_equal(a.waveform.counts, b.waveform.counts)
        for a, b in zip(stored, records, strict=True)
    )
