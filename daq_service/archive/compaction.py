"""From the journal to a set's own file: written, read back, compared; only then may its frames go."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import numpy as np

from daq_service.archive.errors import CorruptArchiveError, SetNotFoundError
from daq_service.archive.journal.reader import read_journal
from daq_service.archive.layout import build_image
from daq_service.archive.reader import read_file
from daq_service.archive.records import TEMPORARY_SUFFIX, SetRecord, SetReference
from daq_service.shared_file import read_shared, write_durably


def compact_set(folder: Path, set_index: int) -> tuple[SetReference, str]:
    """Give a whole set of the journal its own file; one that it has is compared and left.

    Runs in a process of its own beside the recorder, who alone takes frames away.

    Returns
    -------
    tuple
        The file and its SHA-256.

    Raises
    ------
    SetNotFoundError
        The journal has no such set.
    CorruptArchiveError
        A record of it is damaged, or the file differs from the journal.
    OSError
        The disk refuses.
    """
    journaled = read_journal(folder, of_set=set_index).get(set_index)
    if journaled is None:
        raise SetNotFoundError(f"the journal of {folder} has no set {set_index}")
    if (reference := journaled.reference) is None:
        raise CorruptArchiveError(f"set {set_index} in the journal has no end; the journal keeps it")
    if damages := journaled.damages():
        raise CorruptArchiveError(f"set {set_index} in the journal: {'; '.join(map(str, damages))}")
    record, path = journaled.record(), folder / reference
    image = build_image(record)
    if not path.exists():
        # Another worker may still be at it, whose recorder was killed: each has its own name.
        temporary = path.with_suffix(f".{os.getpid()}{TEMPORARY_SUFFIX}")
        write_durably(path, image, temporary=temporary)
        if read_shared(path) != image:
            raise CorruptArchiveError(f"{path} does not read as it was written; the journal keeps the set")
    if not _same(_read_back(path), record):
        raise CorruptArchiveError(f"{path} is not what the journal holds; the journal keeps the set")
    return reference, hashlib.sha256(read_shared(path)).hexdigest()


def _read_back(path: Path) -> SetRecord:
    """Read the file; what the system refuses is no damage, and may go better another time."""
    try:
        return read_file(path)
    except (CorruptArchiveError, SetNotFoundError) as error:
        if isinstance(error.__cause__, OSError) and error.__cause__.errno is not None:
            raise error.__cause__ from error
        raise


def _same(found: SetRecord, record: SetRecord) -> bool:
    """Whether every record came back with its counts."""
    pairs = list(zip(found.records, record.records, strict=False))
    return len(found.records) == len(record.records) == len(pairs) and all(
        (left.sequence, left.key, left.stamp) == (right.sequence, right.key, right.stamp)
        and np.array_equal(left.waveform.counts, right.waveform.counts)
        for left, right in pairs
    )
