"""``verify``: check every frame and file, and compare the catalogue's rows with them; nothing is written.

The order avoids false findings while a recorder runs: list of sets in the catalogue, journal, files. A set
moves from the journal to a file and never back.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from daq_service.archive import SetNotFoundError, SetRecord, SetReference
from daq_service.archive.errors import BACK
from daq_service.archive.journal.checking import CheckedJournal, check_journal
from daq_service.archive.records import (
    QUARANTINE_FOLDER,
    SETS_FOLDER,
    TEMPORARY_SUFFIX,
    parse_due_utc_ns,
    parse_set_keys,
    to_references,
)
from daq_service.archive.verification import check_set_file
from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.errors import CatalogueDamagedError, CatalogueError, NoDataYetError
from daq_service.catalogue.experiment_file import EXPERIMENT_FILE, HISTORY_FILE, read_experiment_file
from daq_service.catalogue.history import describe_lost_event, parse_history_lines, read_history
from daq_service.catalogue.verification import UnchangedCatalogue
from daq_service.cli.maintenance.rows import Found, RowsOfSet, find_row_differences
from daq_service.clock import format_utc
from daq_service.commands.audit import AUDIT_FILE
from daq_service.errors import StorageError
from daq_service.processes.data_folder import CACHES, is_held
from daq_service.processes.notifications.delivery_log import LOG_FILE
from daq_service.processes.recorder_state import FAREWELLS
from daq_service.shared_file import read_shared
from hardware_drivers.measurement import SetKey
from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S

DamageKind = Literal[
    "set_missing",
    "set_unreadable",
    "set_touched",
    "shot",
    "metadata",
    "frame",
    "file_without_rows",
    "row",
    "catalogue",
    "experiment",
    "history",
    "audit",
    "notifications",
]
"""Kinds of corruption.

set_missing
    rows point at a set that is neither a file nor in the journal
set_unreadable
    a set's file cannot be read as a whole
set_touched
    a set's file is not the one that was written: its SHA-256 differs
shot
    a record of a set does not match its checksums
metadata
    another part of a set's file is corrupt or contradicts the rest
frame
    a frame of the journal is corrupt
file_without_rows
    a set has no rows, though later ones do
row
    a row differs from what was stored or from what the set's file says, or is missing
catalogue
    SQLite finds the catalogue corrupt, or it is gone
experiment
    experiment.json is corrupt, or is of another experiment than the catalogue
history
    lines of history.jsonl are corrupt or missing
audit
    lines of audit.jsonl are corrupt or missing
notifications
    lines of notifications.jsonl are corrupt or missing
"""

TABLES = ("sets", "shots", "features", "assessments", "thickness")
"""Whose rows belong to a position and a set."""
MOST_BEHIND_S = 60.0
"""A history with a longer delay was truncated or not written: it normally follows within a second."""
NOWHERE = "rows point at it, but it is neither a file nor in the journal"
MADE_AGAIN = "solimon rebuild makes rows again from the files"
LOGS: Mapping[DamageKind, tuple[str, str]] = {
    "audit": (AUDIT_FILE, "no other file has these entries: keep it, and check a backup"),
    "notifications": (
        LOG_FILE,
        "only the receivers know what was sent now, and a message may be repeated: keep it",
    ),
}
"""By the kind of damage: a file of numbered lines, and what to do about one that is damaged."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One corruption.

    Attributes
    ----------
    file
        Relative to the data folder.
    description
        What was found and what helps.
    shot_id
        `shots.sequence`; None where it is no shot's.
    """

    kind: DamageKind
    file: str
    description: str
    shot_id: int | None = None


@dataclass(slots=True, kw_only=True, eq=False)
class FolderCheck:
    """State of the check of a data folder.

    Attributes
    ----------
    catalogue
        None: there is none that can be read.
     experiment, sets_with_rows
        Its row, and the sets that had rows at the start of the check.
    checked
        What was looked at, by its name.
    unreadable
        What of the catalogue cannot be read.
    progress
        Called with how many files are done, and of how many.
    """

    folder: Path
    catalogue: UnchangedCatalogue | None
    experiment: Found | None = None
    sets_with_rows: frozenset[SetKey] = frozenset()
    journal: CheckedJournal = field(default_factory=CheckedJournal)
    checked: Counter[str] = field(default_factory=Counter)
    unreadable: set[str] = field(default_factory=set)
    progress: Callable[[int, int], None] = lambda done, planned: None


def check_catalogue(state: FolderCheck) -> Iterator[Finding]:
    """Yield the findings of the catalogue: corrupt rows, shots without a set, or that it is missing.

    SQLite checks pages, indices and foreign keys. Damage without a row goes to ``state.unreadable`` and is
    reported by `check_references`.
    """
    if state.catalogue is None:
        yield Finding("catalogue", FILE_NAME, f"it is not there; {MADE_AGAIN} in its place")
        return
    for damage in state.catalogue.troubles():
        if damage.table is None or damage.row_id is None:
            state.unreadable.add(damage.description)
        else:
            shot_id = damage.row_id if damage.table == "shots" else None
            yield Finding("row", FILE_NAME, f"{damage}; {MADE_AGAIN}", shot_id)
    try:
        state.checked["rows"] = state.catalogue.n_rows()
        for sequence in state.catalogue.list_stray_shots():
            description = f"shots, sequence {sequence}: its set has no row; {MADE_AGAIN}"
            yield Finding("row", FILE_NAME, description, sequence)
    except CatalogueDamagedError as error:
        state.unreadable.add(str(error))


def check_experiment(state: FolderCheck) -> Iterator[Finding]:
    """Yield damage of experiment.json and history.jsonl, and disagreements with the catalogue.

    The latter are another configuration or hour 0, and events that only one of catalogue and history has.
    """
    try:
        stored = read_experiment_file(state.folder)
    except CatalogueError as error:
        yield Finding("experiment", EXPERIMENT_FILE, str(error))
    else:
        if stored is not None and state.experiment is not None:
            in_file = {"configuration_hash": stored.configuration_hash, "epoch_utc_ns": stored.epoch_utc_ns}
            in_catalogue = {name: state.experiment[name] for name in in_file}
            if in_file != in_catalogue:
                values = f"it is of {in_file}, the catalogue of {in_catalogue}"
                description = f"{values}: one is foreign or corrupt; {BACK}"
                yield Finding("experiment", EXPERIMENT_FILE, description)
    running = is_held(state.folder) is not False
    try:
        history = read_history(state.folder)
    except OSError as error:
        yield Finding("history", HISTORY_FILE, f"it cannot be read: {error}")
        return
    state.checked["lines_of_history"] = history.last_number
    last_id = max(history.events, default=0)
    if last_id and state.catalogue is not None and not state.catalogue.has_event(history.events[last_id]):
        # A recorder, too, appends to the history what the catalogue has.
        yield Finding("catalogue", FILE_NAME, describe_lost_event(last_id))
    # A folder from before there was either gets them with its next start.
    older = history.last_number == 0 and not (state.folder / EXPERIMENT_FILE).exists()
    cut_off = [] if older else _find_missing_events(state, last_id, running=running)
    for line in [*history.damage, *cut_off]:
        yield Finding(
            "history", HISTORY_FILE, f"{line}; the catalogue has it still: back it up, and keep both"
        )


def _find_missing_events(state: FolderCheck, last_id: int, *, running: bool) -> Iterator[str]:
    """Yield at most one text on events of the catalogue after ``last_id``, the last one in the history.

    A recorder appends them to the history within a second and before it ends, after a crash at the next
    start. So missing events count only if they span more than `MOST_BEHIND_S`, or include the end of a
    recorder that is not ``running``. A damaged catalogue is noted in ``state.unreadable``.
    """
    try:
        lacking = [] if state.catalogue is None else state.catalogue.read_events_after(last_id)
    except CatalogueDamagedError as error:
        state.unreadable.add(str(error))
        return
    if not lacking:
        return
    behind_s = (lacking[-1]["wall_utc_ns"] - lacking[0]["wall_utc_ns"]) / NS_PER_S
    ended = not running and not FAREWELLS.keys().isdisjoint(event["kind"] for event in lacking)
    if ended or behind_s > MOST_BEHIND_S:
        first, last = lacking[0]["id"], lacking[-1]["id"]
        yield f"{HISTORY_FILE} ends before events {first} to {last}, which are {behind_s:.0f} s apart"


def check_logs(state: FolderCheck) -> Iterator[Finding]:
    """Yield changed, missing or unreadable lines of audit log and notification log; skip a missing log."""
    for kind, (file, remedy) in LOGS.items():
        try:
            damage = parse_history_lines(read_shared(state.folder / file), name=file).damage
        except FileNotFoundError:
            continue
        except OSError as error:
            damage = [f"{file} cannot be read: {error}"]
        for line in damage:
            yield Finding(kind, file, f"{line}; {remedy}")


def check_frames(state: FolderCheck) -> Iterator[Finding]:
    """Check the frames of the journal and yield damage that a second reading shows, too.

    A frame may be incomplete while it is written. Stores the journal in ``state``. Raises OSError if a
    segment of the journal cannot be read.
    """
    first = check_journal(state.folder)
    state.journal = check_journal(state.folder) if first.damages else first
    state.checked |= {"frames": state.journal.n_frames, "bytes": state.journal.n_bytes}
    before = {(file, str(damage)) for file, damage in first.damages}
    for file, damage in state.journal.damages:
        if (file, str(damage)) in before:
            remedy = "the others of its set are safe; the damaged one is lost but for a backup's"
            yield Finding("frame", file, f"{damage}; {remedy}", damage.sequence)


def check_sets(state: FolderCheck) -> Iterator[Finding]:
    """Check every set's file, and every set that is only in the journal, and compare each with its rows.

    Yields the findings; reports the number of files to ``state.progress``.
    """
    paths = sorted(path for path in (state.folder / SETS_FOLDER).glob("*.h5") if to_references([path.name]))
    for number, path in enumerate(paths):
        state.progress(number, len(paths))
        ((set_key, reference),) = to_references([path.name]).items()
        yield from _check_set_file(state, set_key, reference)
    state.progress(len(paths), len(paths))
    for set_key, item in state.journal.sets.items():
        file = item.reference
        if file is None or (state.folder / file).exists():
            continue
        state.checked["sets_in_journal"] += 1
        if item.has_records:
            lost = frozenset(damage.sequence or 0 for damage in item.damages())
            yield from _compare_with_rows(state, _read_set_rows(state, set_key), file, item.record(), lost)


def _check_set_file(state: FolderCheck, set_key: SetKey, reference: SetReference) -> Iterator[Finding]:
    """Check the file of a set, compare it with its rows, and yield the findings; none if it is missing.

    Counts files, bytes and shots in ``state.checked``.
    """
    rows = _read_set_rows(state, set_key)
    sha256 = None if rows is None else find_stored_sha256(rows.sets, reference)
    try:
        found = check_set_file(state.folder / reference, sha256=sha256)
    except SetNotFoundError:
        return  # its rows decide whether it should exist
    state.checked["files"] += 1
    state.checked["bytes"] += found.n_bytes
    if found.touched:
        description = f"its SHA-256 is not that of the file that was written; {BACK}"
        yield Finding("set_touched", reference, description)
    for damage in found.damages:
        kind: DamageKind = (
            "set_unreadable" if found.record is None else "metadata" if damage.sequence is None else "shot"
        )
        yield Finding(kind, reference, f"{damage}; {BACK}", damage.sequence)
    if found.record is not None:
        state.checked["shots"] += len(found.record.records)
        lost = frozenset(damage.sequence for damage in found.damages if damage.sequence is not None)
        yield from _compare_with_rows(state, rows, reference, found.record, lost)


def find_stored_sha256(rows: Sequence[Found], reference: SetReference) -> str | None:
    """Return the SHA-256 of a set's file that its rows contain, in hexadecimal; None if there is none."""
    return next((row.get("file_sha256") for row in rows if row["file"] == reference), None)


def _read_set_rows(state: FolderCheck, set_key: SetKey) -> RowsOfSet | None:
    """Read the rows of a set; None if the catalogue is missing or unreadable, noted in ``state``."""
    if state.catalogue is None:
        return None
    try:
        return RowsOfSet(**{table: state.catalogue.of_set(table, set_key) for table in TABLES})
    except CatalogueDamagedError as error:
        state.unreadable.add(str(error))
        return None


def _compare_with_rows(
    state: FolderCheck,
    rows: RowsOfSet | None,
    reference: SetReference,
    record: SetRecord,
    lost: frozenset[int],
) -> Iterator[Finding]:
    """Compare the name, configuration and rows of a set with its record and yield the differences.

    A record with a foreign name or configuration is not compared further. Missing rows are damage only if
    later sets have some. ``lost`` has the ids of unreadable shots.
    """
    named, due_s = parse_set_keys([reference.rpartition("/")[2]]), record.due_utc_ns // NS_PER_S
    if (named, parse_due_utc_ns(reference)) != ({record.set_key}, due_s * NS_PER_S):
        description = (
            f"it holds set {record.set_key} of {format_utc(record.due_utc_ns)}: the file was renamed"
        )
        yield Finding("metadata", reference, f"{description}; {BACK}")
        return
    if rows is None or state.experiment is None:
        return
    file_hash = record.provenance.get("configuration_hash")
    catalogue_hash = state.experiment["configuration_hash"]
    if file_hash is not None and file_hash != catalogue_hash:
        hashes = f"its configuration is {file_hash}, the catalogue's {catalogue_hash}"
        description = f"{hashes}: one of the two is foreign or damaged; move it out, or {BACK}"
        yield Finding("metadata", reference, description)
        return
    hour_0, epoch_ns = record.due_utc_ns - round(record.due_h * NS_PER_H), state.experiment["epoch_utc_ns"]
    if hour_0 != epoch_ns:
        description = f"experiment: hour 0 is {epoch_ns}, by {reference} it is {hour_0} ns"
        yield Finding("row", FILE_NAME, f"{description}; {MADE_AGAIN}")
    if rows.sets:
        for shot_id, description in find_row_differences(rows, record, reference, lost):
            yield Finding("row", FILE_NAME, f"{description}; {MADE_AGAIN}", shot_id)
    elif record.set_index < max((key.set_index for key in state.sets_with_rows), default=0):
        description = (
            f"it has no rows, though later sets have: the recorder's next start makes them, or {MADE_AGAIN}"
        )
        yield Finding("file_without_rows", reference, description)
    else:
        state.checked["sets_without_rows"] += 1


def check_references(state: FolderCheck) -> Iterator[Finding]:
    """Yield each file that rows refer to and that is missing, also from the journal, and catalogue damage.

    The latter is `state.unreadable`, so this check must be the last.
    """
    for set_key in sorted(state.sets_with_rows):
        rows = _read_set_rows(state, set_key)
        files = {row["file"] for row in rows.sets if isinstance(row["file"], str)} if rows else set()
        state.checked["sets_with_rows"] += 1
        journaled = state.journal.sets.get(set_key)
        for file in sorted(files):
            if not (state.folder / file).exists() and (journaled is None or journaled.reference != file):
                yield Finding("set_missing", file, f"{NOWHERE}; {BACK}")
    for description in sorted(state.unreadable):
        yield Finding("catalogue", FILE_NAME, f"{description}; bring it back from a backup, or {MADE_AGAIN}")


CHECKS: tuple[Callable[[FolderCheck], Iterator[Finding]], ...] = (
    check_catalogue,
    check_experiment,
    check_logs,
    check_frames,
    check_sets,
    check_references,
)
"""In this order; each may yield any kind of damage."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """Checked items, corruption, and notes."""

    checked: dict[str, int]
    damage: list[Finding]
    notes: list[str]


def verify_folder(folder: Path, progress: Callable[[int, int], None] = lambda done, planned: None) -> Report:
    """Check all data in a data folder and return the report; nothing is written, a test may run.

    ``progress`` is called with the number of set files that are done, and of all.

    Raises
    ------
    StorageError
        The folder is missing or holds no test: corruption cannot be distinguished from an unmounted disk.
    """
    if not any((folder / name).exists() for name in (SETS_FOLDER, FILE_NAME)):
        raise StorageError(
            f"{folder} holds no test of solimon; see that it is the right one and its disk is there"
        )
    with ExitStack() as stack:
        state = FolderCheck(folder=folder, catalogue=None, progress=progress)
        try:
            state.catalogue = stack.enter_context(UnchangedCatalogue(folder))
            state.experiment = state.catalogue.experiment()
            state.sets_with_rows = frozenset(state.catalogue.list_set_keys())
        except NoDataYetError:
            pass
        except CatalogueDamagedError as error:
            state.unreadable.add(str(error))
        damage = list(dict.fromkeys(finding for check in CHECKS for finding in check(state)))
    return Report(checked=dict(state.checked), damage=damage, notes=_list_notes(state))


def _list_notes(state: FolderCheck) -> list[str]:
    """List notes on unfinished, foreign or quarantined files, caches, and sets without rows yet."""
    others = [path.name for path in (state.folder / SETS_FOLDER).glob("*") if not to_references([path.name])]
    unfinished = sorted(name for name in others if name.endswith(TEMPORARY_SUFFIX))
    foreign = sorted(set(others) - set(unfinished))
    quarantined = sorted(path.name for path in (state.folder / QUARANTINE_FOLDER).glob("*"))
    notes = []
    if number := state.checked["sets_without_rows"]:
        notes.append(f"{number} sets have no rows yet; the recorder's next start makes them")
    if unfinished:
        notes.append(f"left over in {SETS_FOLDER}: {', '.join(unfinished)}; solimon repair removes them")
    if foreign:
        notes.append(f"not solimon's, in {SETS_FOLDER}: {', '.join(foreign)}")
    if quarantined:
        notes.append(f"set aside in {QUARANTINE_FOLDER}: {', '.join(quarantined)}; remove what is not needed")
    if caches := sorted(name for name in CACHES if (state.folder / name).exists()):
        notes.append(f"caches, not checked and safe to delete: {', '.join(caches)}")
    return notes
