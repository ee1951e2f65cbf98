"""Store the finished rows of a running sweep as lines of a work file.

A line is the SHA-256 of its JSON, a blank and that JSON. The first line identifies the sweep. A last line
that a crash truncated is removed; a row whose line fails its checksum is computed again.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import json
import logging
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from daq_service.cli.sweep.plan import Plan
from daq_service.cli.sweep.shot import RESULTS, Outcome
from daq_service.errors import BusyError, StorageError
from daq_service.processes.data_folder import try_lock
from daq_service.shared_file import retry

log = logging.getLogger(__name__)

WORK_SUFFIX = ".work"
FORMAT = 1


def build_work_file_path(output: Path) -> Path:
    """Return the path of the work file for the (first) output of a sweep: ``.work`` is appended."""
    return output.with_name(output.name + WORK_SUFFIX)


@dataclass(slots=True, kw_only=True)
class WorkFile:
    """An open work file of one sweep.

    Attributes
    ----------
    path
        Where it is.
    finished
        Outcomes found in it when it was opened, by index.
    damaged_lines
        Lines whose checksum failed.
    """

    path: Path
    finished: dict[int, Outcome]
    damaged_lines: int
    _plan: Plan
    _file: IO[bytes]

    def keep(self, outcomes: Iterable[Outcome]) -> None:
        """Append outcomes durably: after the return they survive the end of this process.

        Raises
        ------
        StorageError
            The disk is full or refuses.
        """
        lines = b"".join(_format_checksum_line(_outcome_to_json(self._plan, outcome)) for outcome in outcomes)
        try:
            _write_all(self._file, lines)
        except OSError as error:
            raise StorageError(
                f"cannot write {self.path}: {error.strerror}; what it holds is kept: free some space, then "
                "give the same command again"
            ) from error


@contextlib.contextmanager
def open_work_file(path: Path, plan: Plan) -> Iterator[WorkFile]:
    """Open or create the work file of a plan and lock it; the lock ends with the context.

    Raises
    ------
    StorageError
        It belongs to another sweep or cannot be written.
    BusyError
        The same sweep is running.
    """
    try:
        file = retry(lambda: path.open("a+b", buffering=0))
    except OSError as error:
        raise StorageError(
            f"cannot write {path}: {error.strerror}; choose another place with --out"
        ) from error
    with file:
        file.seek(0)
        try:
            try_lock(file)
        except OSError as error:
            raise BusyError(f"{path} is in use: the same sweep is running; wait for its end") from error
        yield _read_or_create_work_file(path, file, plan)


def _read_or_create_work_file(path: Path, file: IO[bytes], plan: Plan) -> WorkFile:
    """Read the finished rows of a work file and remove a truncated last line, or write its header.

    Corrupt lines are counted and logged. Raises StorageError if it belongs to another sweep or cannot be
    written.
    """
    file.seek(0)
    stored = file.read()
    whole = stored.rfind(b"\n") + 1
    lines = stored[:whole].splitlines()
    header = _parse_checksum_line(lines[0]) if lines else None
    if lines and (header is None or header.get("sweep") != plan.identity):
        raise StorageError(
            f"{path} holds rows of another sweep, or of another version of solimon; finish that sweep with "
            "its own command, remove the file, or choose another --out"
        )
    finished: dict[int, Outcome] = {}
    damaged = 0
    for line in lines[1:]:
        content = _parse_checksum_line(line)
        outcome = None if content is None else _outcome_from_json(plan, content)
        if outcome is None:
            damaged += 1
        else:
            finished[outcome.index] = outcome
    if damaged:
        log.warning("%s: %d damaged lines; their rows are computed again", path, damaged)
    work = WorkFile(path=path, finished=finished, damaged_lines=damaged, _plan=plan, _file=file)
    try:
        file.truncate(whole)
        if not lines:
            header_line = {"format": FORMAT, "sweep": plan.identity, "rows": len(plan.rows)}
            _write_all(file, _format_checksum_line(header_line))
    except OSError as error:
        raise StorageError(f"cannot write {path}: {error.strerror}; free some space") from error
    return work


def is_work_file_of(path: Path, plan: Plan) -> bool:
    """Return whether a file is the unfinished work file of the plan; False if missing or unreadable."""
    try:
        with path.open("rb") as file:
            header = _parse_checksum_line(file.readline().rstrip(b"\n"))
    except OSError:
        return False  # none there, or not ours to read: then it proves nothing
    return header is not None and header.get("sweep") == plan.identity


def _outcome_to_json(plan: Plan, outcome: Outcome) -> dict[str, object]:
    """Convert an outcome to a JSON object; the force is compressed and encoded as base64."""
    content = {
        "row": outcome.index,
        "key": plan.rows[outcome.index].key,
        "numbers": outcome.numbers,
        "status": outcome.status,
    }
    if outcome.force_n is not None:
        packed = zlib.compress(outcome.force_n.astype("<f8").tobytes(), 1)
        content |= {
            "force_n": base64.b64encode(packed).decode("ascii"),
            "sample_interval_s": outcome.sample_interval_s,
        }
    return content


def _outcome_from_json(plan: Plan, content: Mapping[str, Any]) -> Outcome | None:
    """Convert a JSON object to an outcome; None if its row or number of results does not fit the plan."""
    index = content["row"]
    if not 0 <= index < len(plan.rows) or plan.rows[index].key != content["key"]:
        return None
    if len(content["numbers"]) != len(RESULTS[plan.model]):
        return None
    force = content.get("force_n")
    samples = None if force is None else np.frombuffer(zlib.decompress(base64.b64decode(force)), dtype="<f8")
    return Outcome(
        index=index,
        numbers=tuple(float(number) for number in content["numbers"]),
        status=content["status"],
        force_n=samples,
        sample_interval_s=content.get("sample_interval_s", float("nan")),
    )


def _write_all(file: IO[bytes], content: bytes) -> None:
    """Write all bytes to an unbuffered file, which may take several calls; raise OSError if one fails."""
    rest = memoryview(content)
    while rest:
        rest = rest[file.write(rest) :]


def _format_checksum_line(content: Mapping[str, object]) -> bytes:
    """Encode an object as a line: SHA-256, blank, compact JSON."""
    text = json.dumps(content, separators=(",", ":")).encode()
    return hashlib.sha256(text).hexdigest().encode() + b" " + text + b"\n"


def _parse_checksum_line(line: bytes) -> Mapping[str, Any] | None:
    """Parse the JSON of a line; None if its checksum is wrong."""
    digest, _, text = line.partition(b" ")
    if hashlib.sha256(text).hexdigest().encode() != digest:
        return None
    content: Mapping[str, Any] = json.loads(text)
    return content
