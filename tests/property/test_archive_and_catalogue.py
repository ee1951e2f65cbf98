"""However sets are stored, committed and cut short: what was acknowledged is there, and rows fit it.

The model is a dictionary of sets and a list of events. A crash comes before the rename of a file, between
rename and acknowledgement, or between acknowledgement and commit; the next recorder takes over what lies
in the archive without rows.
"""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from unittest import mock

import pytest
from hypothesis import HealthCheck, Phase, assume, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from support.archived_sets import SET_INDEX, make_set, other_set
from support.filed_archive import FiledArchive
from support.memory_archive import MemoryArchive, bits

from daq_service import shared_file
from daq_service.archive import (
    ConflictingSetError,
    FolderSetReader,
    SetReference,
)
from daq_service.assessment.transaction import shot_row
from daq_service.catalogue import RecorderCatalogue, SetCommit, open_catalogue
from daq_service.catalogue.errors import CatalogueError
from daq_service.catalogue.rows import AlarmRow, EventRow, SetRow, ShotRow

INDICES = range(SET_INDEX, SET_INDEX + 5)
RECORDS = {index: other_set(make_set(), index) for index in INDICES}
BITS = {index: bits(record) for index, record in RECORDS.items()}
sets = st.sampled_from(INDICES)


class Killed(BaseException):
    """End of the process."""


# Rows of the catalogue: the only lines that know their form.


def column(row, name):
    return getattr(row, name)


def event(kind, set_index):
    return EventRow(utc_ns=0, topic="sets", kind=kind, set_index=set_index, payload={})


def commit_of(record, file):
    due = {"set_index": record.set_index, "due_h": record.due_h, "due_utc_ns": record.due_utc_ns}
    planned = {"state": "done", "n_planned": 2}
    return SetCommit(
        sets=[
            SetRow(position=place.position, method=place.method, file=file, **due, **planned)
            for place in record.positions
        ],
        shots=[shot_row(item, valid=True, flags=()) for item in record.records],
        events=[event("set_done", record.set_index)],
    )


def impossible():
    """Return what no commit can hold: a change of an alarm that was never raised."""
    alarm = AlarmRow(
        id=999,
        position="B",
        kind="no_reflection",
        alarm_class="damage",
        priority="critical",
        state="normal",
        raised_utc_ns=0,
        raised_h=0.0,
        changed_utc_ns=0,
        message="never raised",
        evidence={},
    )
    return {"alarms": [alarm]}


class ArchiveAndCatalogue(RuleBasedStateMachine):
    """Folder of a recorder, a reader that stays open, and what both must show."""

    @initialize()
    def begin(self):
        self.cleaning = ExitStack()
        self.folder = Path(self.cleaning.enter_context(tempfile.TemporaryDirectory()))
        self.stored: dict[int, SetReference] = {}
        self.committed: list[int] = []
        self.events: list[tuple[int, str, int | None]] = []
        self.catalogue: RecorderCatalogue | None = None
        self.reopen()
        self.catalogue.create_experiment(
            name="", configuration_hash="", configuration={}, epoch_utc_ns=0, clock="simulated",
            solimon_version="",
        )  # fmt: skip
        self.reading = self.cleaning.enter_context(open_catalogue(self.folder))
        self.reader = FolderSetReader(self.folder)

    @rule()
    def reopen(self):
        """Reopen after the end of the process."""
        if self.catalogue is not None:
            self.catalogue.close()
            self.archive.close()
        self.catalogue = open_catalogue(self.folder, writer=True)
        self.archive = FiledArchive(self.folder)

    @rule(index=sets)
    def store(self, index):
        """Store a set; its rows are never written if the process ends now."""
        stored = self.archive.store_set(RECORDS[index])
        expected = MemoryArchive().store_set(RECORDS[index])
        assert (stored.file, stored.crc32) == (expected.file, expected.crc32)
        assert self.stored.setdefault(index, stored.file) == stored.file

    @rule(index=sets)
    def store_and_commit(self, index):
        self.store(index)
        self.commit(index)

    @rule(index=sets, call=st.sampled_from(["os.open", "os.fsync", "os.replace", "sync_folder"]))
    def crash_while_storing(self, index, call):
        """End the process before a call: the set is complete, though not acknowledged, or absent."""
        assume(index not in self.stored)  # a repeated store makes no file
        killed = mock.patch.object(shared_file, call.removeprefix("os."), side_effect=Killed)
        if call.startswith("os."):
            killed = mock.patch.object(shared_file.os, call.removeprefix("os."), side_effect=Killed)
        with killed, pytest.raises(Killed):
            self.archive.store_set(RECORDS[index])
        found = self.reader.sets()
        if index in found:
            self.stored[index] = MemoryArchive().store_set(RECORDS[index]).file
        assert found == dict(sorted(self.stored.items()))
        self.reopen()

    @precondition(lambda self: self.stored)
    @rule(data=st.data())
    def store_other_content(self, data):
        index = data.draw(st.sampled_from(sorted(self.stored)))
        with pytest.raises(ConflictingSetError):
            self.archive.store_set(replace(RECORDS[index], due_h=-1.0))

    @precondition(lambda self: self.stored)
    @rule(data=st.data())
    def fail_to_commit(self, data):
        """Check that a commit is not stored if any part of it is refused."""
        index = data.draw(st.sampled_from(sorted(self.stored)))
        with pytest.raises(CatalogueError):
            self.catalogue.commit_set(replace(commit_of(RECORDS[index], self.stored[index]), **impossible()))

    @rule()
    def add_event(self):
        """Add an event that belongs to no set."""
        added_id = self.catalogue.add_event(utc_ns=0, topic="service", kind="told", payload={})
        self.events.append((added_id, "told", None))

    @rule()
    def adopt(self):
        """Write the rows of every set that has none, as a restarted recorder does."""
        done = self.catalogue.committed_sets()
        for index, file in self.archive.sets().items():
            if index not in done:
                assert bits(self.archive.read_set(file)) == BITS[index]
                self.commit(index)
        assert self.catalogue.committed_sets() == set(self.archive.sets())

    @precondition(lambda self: self.stored)
    @rule(data=st.data())
    def read_back(self, data):
        index = data.draw(st.sampled_from(sorted(self.stored)))
        assert bits(self.reader.read_set(self.stored[index])) == BITS[index]
        assert self.reader.verify_set(self.stored[index]) == []

    def commit(self, index):
        rows = commit_of(RECORDS[index], self.stored[index])
        if index in self.committed:
            with pytest.raises(CatalogueError):
                self.catalogue.commit_set(rows)
            return
        (event_id,) = self.catalogue.commit_set(rows).event_ids
        self.committed.append(index)
        self.events.append((event_id, "set_done", index))

    @invariant()
    def the_archive_lists_whole_sets_in_order(self):
        assert list(self.reader.sets().items()) == sorted(self.stored.items())
        assert self.archive.sets() == self.reader.sets()

    @invariant()
    def rows_and_files_belong_together(self):
        """Check the order of the commits for the recorder and for a concurrent reader."""
        for catalogue in (self.catalogue, self.reading):
            rows = catalogue.rows(SetRow)
            per_set = len(RECORDS[SET_INDEX].positions)
            found = [(column(row, "set_index"), column(row, "file")) for row in rows[::per_set]]
            assert found == [(index, self.stored[index]) for index in self.committed]
            assert len(rows) == per_set * len(self.committed)
            ids = [column(row, "id") for row in rows]
            assert ids == sorted(set(ids))
        assert self.catalogue.committed_sets() == set(self.committed)
        sequences = [item.sequence for index in self.committed for item in RECORDS[index].records]
        assert self.catalogue.next_sequence() == max(sequences, default=0) + 1

    @invariant()
    def events_have_their_order(self):
        ids = [event_id for event_id, *_ in self.events]
        assert ids == sorted(set(ids))
        for catalogue in (self.catalogue, self.reading):
            rows = catalogue.events_after(0, limit=None)
            found = [tuple(column(row, name) for name in ("id", "kind", "set_index")) for row in rows]
            assert found == self.events
            half = ids[len(ids) // 2] if ids else 0
            assert [column(row, "id") for row in catalogue.events_after(half)] == [
                one for one in ids if one > half
            ]

    def teardown(self):
        """Check that every acknowledged record is complete and its rows name the same counts."""
        with self.cleaning:
            for index, file in self.stored.items():
                assert bits(self.reader.read_set(file)) == BITS[index]
            for index in self.committed:
                crc32 = self.archive.store_set(RECORDS[index]).crc32
                for place in RECORDS[index].positions:
                    for row in self.reading.rows(ShotRow, position=place.position, set_index=index):
                        assert column(row, "crc32") == crc32[column(row, "sequence")]
            self.catalogue.close()


ArchiveAndCatalogue.TestCase.settings = settings(
    max_examples=6,
    stateful_step_count=15,
    # The same runs every time: a changed result in the default suite is a changed program.
    derandomize=True,
    database=None,
    # No shrinking: it would take minutes of fsyncs, and fifteen steps can be read as they are.
    phases=[Phase.generate],
    # A step waits for fsync, which takes as long as the disk pleases.
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
TestArchiveAndCatalogue = ArchiveAndCatalogue.TestCase
