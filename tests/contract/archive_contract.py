"""Contract of every archive: inherit `ArchiveContract` and return its fixtures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from support.archived_sets import (
    DUE_UTC_NS,
    SET_INDEX,
    assert_same_set,
    assert_same_waveform,
    make_set,
    make_shot,
    other_set,
)
from support.memory_archive import bits

from daq_service.archive import (
    Archive,
    ConflictingSetError,
    CorruptArchiveError,
    SetNotFoundError,
    SetReader,
    SetRecord,
    SetReference,
    compute_crc32,
    parse_due_utc_ns,
)
from hardware_drivers.measurement import SetKey


class ArchiveContract:
    """Contract of complete sets: acknowledged for good, read back to the last bit."""

    @pytest.fixture
    def archive(self) -> Archive:
        """Return the archive under test, empty."""
        raise NotImplementedError

    @pytest.fixture
    def reopened(self) -> Callable[[], Archive]:
        """Return a function that opens the same archive again, as after the end of its process."""
        raise NotImplementedError

    @pytest.fixture
    def reader(self) -> SetReader:
        """Return a reader of the same archive, opened before anything is stored."""
        raise NotImplementedError

    @pytest.fixture
    def damage(self) -> Callable[[SetReference, int], None]:
        """Return a function that corrupts the record of a sequence number."""
        raise NotImplementedError

    @pytest.fixture
    def lose(self) -> Callable[[SetReference], None]:
        """Return a function that removes a set."""
        raise NotImplementedError

    @pytest.fixture
    def crash_while_storing(self) -> Callable[[SetRecord], None]:
        """Return a function that stores a set in a process that ends before the set is complete."""
        raise NotImplementedError

    def test_is_an_archive(self, archive, reader):
        assert isinstance(archive, Archive)
        assert isinstance(reader, SetReader)
        assert archive.name == reader.name != ""

    def test_an_empty_archive_has_no_sets(self, archive):
        assert (dict(archive.sets()), archive.n_bytes()) == ({}, 0)

    def test_a_set_comes_back_to_the_last_bit(self, archive, reader):
        stored = archive.store_set(make_set())
        for one in (archive, reader):
            assert_same_set(one.read_set(stored.file), make_set())
            assert bits(one.read_set(stored.file)) == bits(make_set())
            assert one.verify_set(stored.file) == []

    def test_a_truth_that_is_no_number_comes_back(self, archive):
        shots = [make_shot("B", 0, 1, truth={"depth_m": float("nan")}), make_shot("B", 1, 2)]
        record = replace(make_set(), shots=shots, outcomes={})
        assert bits(archive.read_set(archive.store_set(record).file)) == bits(record)

    def test_a_set_of_pulse_echo_alone_is_a_set(self, archive):
        record = replace(make_set(), shots=[], outcomes={})
        assert_same_set(archive.read_set(archive.store_set(record).file), record)

    def test_the_acknowledgement_names_set_size_and_checksums(self, archive):
        stored = archive.store_set(make_set())
        assert stored.file == "sets/set_000007_20240101T040000Z.h5"
        assert parse_due_utc_ns(stored.file) == DUE_UTC_NS // 10**9 * 10**9
        assert stored.n_bytes == archive.n_bytes() > 0
        assert stored.crc32 == {item.sequence: compute_crc32(item.waveform) for item in make_set().records}

    def test_the_same_set_again_is_the_same_set(self, archive, reopened):
        stored = archive.store_set(make_set())
        for one in (archive, reopened()):
            again = one.store_set(make_set())
            assert (again.file, again.n_bytes, again.crc32) == (stored.file, stored.n_bytes, stored.crc32)
            assert one.sets() == {SetKey(SET_INDEX): stored.file}

    @pytest.mark.parametrize(
        "change",
        [
            {"due_h": 4.5},
            {"due_utc_ns": DUE_UTC_NS + 3_600_000_000_000},
            {"trouble": ""},
            {"outcomes": {43: "superseded"}},
            {"missed": ()},
            {"provenance": {}},
            {"shots": make_set().shots[:-1]},
        ],
        ids=lambda change: next(iter(change)),
    )
    def test_other_content_never_replaces_a_stored_set(self, archive, reopened, change):
        stored = archive.store_set(make_set())
        for one in (archive, reopened()):
            with pytest.raises(ConflictingSetError, match="set 7 is stored already"):
                one.store_set(replace(make_set(), **change))
            assert one.sets() == {SetKey(SET_INDEX): stored.file}
            assert_same_set(one.read_set(stored.file), make_set())

    def test_provenance_that_json_cannot_hold_is_refused(self, archive):
        with pytest.raises(ValueError, match="JSON"):
            archive.store_set(replace(make_set(), provenance={"limit": float("inf")}))
        assert archive.sets() == {}

    def test_sets_are_listed_in_their_order(self, archive, reopened, reader):
        keys = [SetKey(12), SetKey(7, 2), SetKey(7), SetKey(1_000_001), SetKey(999_999)]
        records = {key: other_set(make_set(), *key) for key in keys}
        files = {index: archive.store_set(record).file for index, record in records.items()}
        for one in (archive, reopened(), reader):
            assert list(one.sets().items()) == sorted(files.items())
        for index, record in records.items():
            assert_same_set(reader.read_set(files[index]), record)

    def test_stored_records_survive_the_process(self, archive, reopened):
        stored = archive.store_set(make_set())
        assert_same_set(reopened().read_set(stored.file), make_set())

    def test_only_complete_sets_are_listed(self, archive, reopened, reader, crash_while_storing):
        whole = archive.store_set(make_set())
        crash_while_storing(other_set(make_set(), SET_INDEX + 1))
        assert reader.sets() == reopened().sets() == {SetKey(SET_INDEX): whole.file}
        assert reopened().n_bytes() == whole.n_bytes
        again = other_set(make_set(), SET_INDEX + 1)
        assert_same_set(reader.read_set(reopened().store_set(again).file), again)

    def test_one_record_can_be_read_alone(self, archive):
        stored = archive.store_set(make_set())
        records = {item.sequence: item.waveform for item in make_set().records}
        for place, sequence in ((("A", 0), 40), (("B", 0), 41), (("C", 0), 44)):
            assert_same_waveform(archive.read_waveform(stored.file, *place), records[sequence])

    @pytest.mark.parametrize(("superseded", "accepted"), [(42, 43), (43, 42)])
    def test_of_several_attempts_the_accepted_one_is_the_shot(self, archive, superseded, accepted):
        record = replace(make_set(), outcomes={superseded: "superseded"})
        stored = archive.store_set(record)
        shots = {item.sequence: item for item in record.shots}
        assert_same_waveform(archive.read_waveform(stored.file, "B", 1), shots[accepted].waveform)

    @pytest.mark.parametrize(("position", "shot_index"), [("B", 2), ("D", 0), ("X", 0)])
    def test_a_record_that_was_never_taken_is_not_found(self, archive, position, shot_index):
        stored = archive.store_set(make_set())
        with pytest.raises(SetNotFoundError, match=f"no shot {shot_index} of position '{position}'"):
            archive.read_waveform(stored.file, position, shot_index)

    def test_a_set_that_is_gone_is_not_found(self, archive, reader, lose):
        stored = archive.store_set(make_set())
        lose(stored.file)
        for read in (reader.read_set, reader.verify_set, lambda file: reader.read_waveform(file, "B", 0)):
            with pytest.raises(SetNotFoundError, match=f"there is no file .*{stored.file[5:]}"):
                read(stored.file)
        assert reader.sets() == {}

    def test_corruption_costs_one_record_and_names_it(self, archive, reader, damage):
        stored = archive.store_set(make_set())
        damage(stored.file, 42)
        message = r"shot 1 of B \(sequence 42\)"
        with pytest.raises(CorruptArchiveError, match=message):
            reader.read_set(stored.file)
        whole = make_set()
        rest = replace(whole, shots=[shot for shot in whole.shots if shot.sequence != 42], outcomes={})
        assert_same_set(reader.read_set(stored.file, skip_damaged=True), rest)
        (found,) = reader.verify_set(stored.file)
        assert (found.position, found.shot_index, found.sequence) == ("B", 1, 42)
        # Attempt 42 was superseded: the shot can still be read.
        assert_same_waveform(reader.read_waveform(stored.file, "B", 1), whole.shots[2].waveform)

    def test_a_set_that_is_set_aside_is_no_set_and_still_there(self, archive, reader, reopened):
        stored = archive.store_set(make_set())
        assert archive.list_quarantined() == []
        archive.set_aside(stored.file)
        assert dict(reader.sets()) == dict(archive.sets()) == {}
        (name,) = reopened().list_quarantined()
        assert stored.file.rpartition("/")[2] in name
        again = archive.store_set(replace(make_set(), due_h=4.5))  # it may be taken once more
        assert archive.read_set(again.file).due_h == 4.5
        archive.set_aside(again.file)
        assert len(archive.list_quarantined()) == 2, "nothing there is overwritten"

    def test_a_corrupt_record_cannot_be_read_alone(self, archive, reader, damage):
        stored = archive.store_set(make_set())
        damage(stored.file, 41)
        with pytest.raises(CorruptArchiveError, match=r"shot 0 of B \(sequence 41\)"):
            reader.read_waveform(stored.file, "B", 0)

    def test_a_set_without_one_sound_record_cannot_be_read(self, archive, reader, damage):
        stored = archive.store_set(make_set())
        for record in make_set().records:
            damage(stored.file, record.sequence)
        with pytest.raises(CorruptArchiveError, match="sequence 44"):
            reader.read_set(stored.file, skip_damaged=True)
        assert [item.sequence for item in reader.verify_set(stored.file)] == [40, 41, 42, 43, 44]


class JournalContract(ArchiveContract):
    """Contract of records that are acknowledged one by one, before their set."""

    def begin(self, archive, n_records):
        """Store the first records of the set, and its missed shots, as a recorder does."""
        whole = make_set()
        archive.begin_set(
            SetKey(SET_INDEX),
            due_utc_ns=DUE_UTC_NS,
            started_utc_ns=whole.started_utc_ns,
            disabled={"D": "disabled by ann"},
        )
        for record in whole.records[:n_records]:
            archive.append(record, record.stamp.utc_ns)
        for missed in whole.missed:
            archive.append(missed, DUE_UTC_NS)

    def test_records_are_acknowledged_once_and_outlive_the_process(self, archive, reopened):
        self.begin(archive, 3)
        assert archive.sync() == [record.sequence for record in make_set().records[:3]]
        assert archive.sync() == []
        (opened,) = reopened().open_sets().values()
        whole = make_set()
        assert (opened.set_key, opened.due_utc_ns) == (SetKey(SET_INDEX), DUE_UTC_NS)
        assert (opened.started_utc_ns, opened.disabled) == (whole.started_utc_ns, {"D": "disabled by ann"})
        assert bits(list(opened.records)) == bits(whole.records[:3])
        assert list(opened.missed) == list(whole.missed)
        assert opened.last_utc_ns >= max(record.stamp.utc_ns for record in opened.records)
        assert reopened().sets() == {}

    def test_unsynced_data_may_be_lost(self, archive, reopened):
        self.begin(archive, 3)
        archive.sync()
        archive.append(make_set().records[3], DUE_UTC_NS)
        (opened,) = reopened().open_sets().values()
        assert [record.sequence for record in opened.records] == [
            record.sequence for record in make_set().records[:3]
        ]

    def test_an_open_set_is_continued_and_completed(self, archive, reopened, reader):
        self.begin(archive, 3)
        archive.sync()
        again = reopened()
        (opened,) = again.open_sets().values()
        again.resume_set(opened)
        stored = again.store_set(make_set())
        for one in (again, reader, reopened()):
            assert bits(one.read_set(stored.file)) == bits(make_set())
            assert one.verify_set(stored.file) == []
        assert reopened().open_sets() == {}

    def test_a_finalized_set_is_removed_from_memory(self, archive, reopened):
        self.begin(archive, 0)
        archive.sync()
        archive.settle(SetKey(SET_INDEX))
        archive.close()
        assert reopened().open_sets() == {}
