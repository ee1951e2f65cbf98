"""From the journal to a set's own file: written, read back, compared; only then may its frames go."""

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
from daq_service.archive.layout import Record, build_image
from daq_service.archive.reader import read_records
from daq_service.archive.records import TEMPORARY_SUFFIX, Places, Results, SetRecord, SetReference
from daq_service.shared_file import read_shared, write_durably


def compact_set(
    folder: Path,
    set_index: int,
    places: Places | None = None,
    results: Results = MappingProxyType({}),
    also: Callable[[SetRecord], str] | None = None,
) -> tuple[SetReference, str, str]:
    """Give a whole set of the journal its own file; one that it has is compared and left.

    Runs in a process of its own beside the recorder, who alone takes frames away.

    Parameters
    ----------
    places
        Where the journal has the set (`Archive.places`); None: anywhere.
    results
        What was computed of the set.
    also
        Done with the set once its file is compared; says what kept it from that.

    Returns
    -------
    tuple
        The file, its SHA-256, and what ``also`` said.

    Raises
    ------
    SetNotFoundError
        The journal has no such set.
    CorruptArchiveError
        A record of it is damaged, or the file differs from the journal.
    OSError
        The disk refuses.
    """
    journaled = read_journal(folder, of_set=set_index, places=places).get(set_index)
    if journaled is None:
        raise SetNotFoundError(f"the journal of {folder} has no set {set_index}")
    if (reference := journaled.reference) is None:
        raise CorruptArchiveError(f"set {set_index} in the journal has no end; the journal keeps it")
    if damages := journaled.damages():
        raise CorruptArchiveError(f"set {set_index} in the journal: {'; '.join(map(str, damages))}")
    record, path = replace(journaled.record(), results=results), folder / reference
    image = build_image(record)
    if is_new := not path.exists():
        # Another worker may still be at it, whose recorder was killed: each has its own name.
        temporary = path.with_suffix(f".{os.getpid()}{TEMPORARY_SUFFIX}")
        write_durably(path, image, temporary=temporary)
    content = read_shared(path)
    if is_new and content != image:
        raise CorruptArchiveError(f"{path} does not read as it was written; the journal keeps the set")
    if not _same(read_records(path, content, is_own=content == image), record.records):
        raise CorruptArchiveError(f"{path} is not what the journal holds; the journal keeps the set")
    return reference, hashlib.sha256(content).hexdigest(), also(record) if also else ""


def _same(found: Sequence[Record], records: Sequence[Record]) -> bool:
    """Whether every record came back with its counts."""
    return len(found) == len(records) and all(
        (left.sequence, left.key, left.stamp) == (right.sequence, right.key, right.stamp)
        and np.array_equal(left.waveform.counts, right.waveform.counts)
        for left, right in zip(found, records, strict=True)
    )
