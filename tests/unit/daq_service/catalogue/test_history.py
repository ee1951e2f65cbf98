"""The history follows the catalogue; if a line is corrupt, the others are read."""

import os
from dataclasses import replace

import pytest
from support import invented_rows
from support.machine import clock_in_seconds
from support.new_experiment import add_events, new_catalogue

from daq_service.catalogue import SetCommit, history
from daq_service.catalogue.errors import CatalogueDamagedError, OtherExperimentError
from daq_service.catalogue.experiment_file import HISTORY_FILE
from daq_service.catalogue.history import (
    HistoryFollower,
    encode_history_line,
    parse_history_lines,
    read_history,
)
from daq_service.catalogue.rows import CommandRow, EventRow, SetRow
from hardware_drivers.measurement import SetKey


@pytest.fixture
def catalogue(tmp_path):
    with new_catalogue(tmp_path) as catalogue:
        yield catalogue


@pytest.fixture
def follower(catalogue, tmp_path):
    now = iter(range(0, 10**6, 10))
    follower = HistoryFollower(tmp_path, catalogue, machine=clock_in_seconds(lambda: next(now)))
    follower.begin()
    return follower


def set_row(position, **columns):
    return invented_rows.set_row(0, position, **columns)


def test_the_history_holds_experiment_events_command_states_and_files(catalogue, follower, tmp_path):
    add_events(catalogue, "one", "two")
    order = catalogue.add_command("Ada", "pause", {})
    follower.follow()
    catalogue.start_command(order)
    follower.follow()
    catalogue.finish_command(order, "done", "paused")
    catalogue.commit_set(SetCommit(sets=[set_row("A", file="sets/a.h5"), set_row("B", state="missed")]))
    follower.follow()
    catalogue.store_digest(SetKey(0), "sets/a.h5", "ab" * 32)
    follower.add_digest("sets/a.h5", "ab" * 32)
    follower.follow()
    follower.follow()
    history = read_history(tmp_path)
    assert history.experiment == catalogue.read_experiment()
    assert list(history.events.values()) == catalogue.rows(EventRow)
    assert list(history.commands.values()) == catalogue.rows(CommandRow)
    assert history.digests == {"sets/a.h5": "ab" * 32}
    assert history.damage == []
    content = (tmp_path / HISTORY_FILE).read_bytes()
    assert all(f'"state":"{state}"'.encode() in content for state in ("pending", "started", "done"))
    assert content.count(b"\n") == history.last_number == 7


def stored(catalogue, set_index, sha256=None):
    """Commit the row and event of a set as the recorder does."""
    row = replace(set_row("A", file=f"sets/{set_index}.h5", file_sha256=sha256), set_index=set_index)
    event = EventRow(utc_ns=0, topic="sets", kind="set_done", position="A", set_index=set_index, payload={})
    catalogue.commit_set(SetCommit(sets=[row], events=[event]))
    return row.file


def test_without_a_journal_digests_are_written_with_the_rows(catalogue, follower, tmp_path):
    files = {stored(catalogue, index, f"{index}" * 64): f"{index}" * 64 for index in range(3)}
    follower.follow()
    assert read_history(tmp_path).digests == files


def test_a_digest_missing_after_a_crash_is_written_at_the_next_start(catalogue, follower, tmp_path):
    files = {stored(catalogue, index): f"{index}" * 64 for index in range(3)}
    follower.follow()
    for index, (file, sha256) in enumerate(files.items()):
        catalogue.store_digest(SetKey(index), file, sha256)
    assert read_history(tmp_path).digests == {}
    for _ in range(2):
        HistoryFollower(tmp_path, catalogue).begin()
        assert read_history(tmp_path).digests == files
        assert read_history(tmp_path).last_number == 1 + 3 + 3


def test_a_start_reads_only_the_end_of_a_long_history(catalogue, follower, tmp_path, monkeypatch):
    for index in range(20):
        file = stored(catalogue, index)
        catalogue.store_digest(SetKey(index), file, f"{index:064d}")
        follower.add_digest(file, f"{index:064d}")
        follower.follow()
    path = tmp_path / HISTORY_FILE
    before, asked, rows = path.read_bytes(), [], catalogue.rows

    def noting(kind, **filters):
        asked.append((kind, filters.get("first_set")))
        return rows(kind, **filters)

    monkeypatch.setattr(history, "TAIL_BYTES", len(b"".join(before.splitlines(keepends=True)[-5:])))
    monkeypatch.setattr(catalogue, "rows", noting)
    HistoryFollower(tmp_path, catalogue).begin()
    assert path.read_bytes() == before
    assert [first for kind, first in asked if kind is SetRow] == [18]


def test_a_folder_without_a_history_is_followed_in_blocks(catalogue, tmp_path, monkeypatch):
    files = {stored(catalogue, index, f"{index}" * 64): f"{index}" * 64 for index in range(7)}
    monkeypatch.setattr(history, "EVENTS_AT_ONCE", 3)
    follower = HistoryFollower(tmp_path, catalogue)
    follower.begin()
    found = read_history(tmp_path)
    assert (list(found.events.values()), found.digests) == (catalogue.rows(EventRow), files)
    assert found.last_number == 1 + 7 + 7
    assert (len(follower._known.events), len(follower._known.digests)) == (1, 1), "memory stays flat"


def test_a_new_follower_appends_missing_lines_once(catalogue, follower, tmp_path):
    add_events(catalogue, "one")
    follower.follow()
    add_events(catalogue, "two")
    for _ in range(2):
        HistoryFollower(tmp_path, catalogue).begin()
    history = read_history(tmp_path)
    assert [event.kind for event in history.events.values()] == ["one", "two"]
    assert history.last_number == 3


def test_the_history_is_written_at_most_once_per_second(catalogue, tmp_path):
    now = [0.0]
    follower = HistoryFollower(tmp_path, catalogue, machine=clock_in_seconds(lambda: now[0]))
    follower.begin()
    add_events(catalogue, "one")
    now[0] = 0.9
    follower.follow()
    assert not read_history(tmp_path).events
    now[0] = 1.1
    follower.follow()
    assert len(read_history(tmp_path).events) == 1


def test_a_torn_last_line_is_removed_and_no_corruption(catalogue, follower, tmp_path):
    add_events(catalogue, "one", "two")
    follower.follow()
    path = tmp_path / HISTORY_FILE
    path.write_bytes(path.read_bytes()[:-9])
    assert read_history(tmp_path).damage == []
    assert len(read_history(tmp_path).events) == 1
    HistoryFollower(tmp_path, catalogue).begin()
    history = read_history(tmp_path)
    assert [event.kind for event in history.events.values()] == ["one", "two"]
    assert history.damage == []


@pytest.mark.parametrize(
    ("damaged", "lacking"),
    [
        (lambda lines: [lines[0], lines[1].replace(b"one", b"One"), *lines[2:]], {1}),
        (lambda lines: [lines[0], *lines[2:]], {1}),
        (lambda lines: [*lines[:2], lines[2][:-1] + b" " + lines[3]], {2, 3}),
        (lambda lines: lines[1:], set()),
    ],
)
def test_a_corrupt_or_missing_line_is_reported_and_the_others_are_read(
    catalogue, follower, tmp_path, damaged, lacking
):
    add_events(catalogue, "one", "two", "three")
    follower.follow()
    path = tmp_path / HISTORY_FILE
    path.write_bytes(b"".join(damaged(path.read_bytes().splitlines(keepends=True))))
    history = read_history(tmp_path)
    assert set(history.events) == {1, 2, 3} - lacking
    assert len(history.damage) == 1


def test_a_write_error_only_delays_the_history(catalogue, follower, tmp_path, monkeypatch, caplog):
    add_events(catalogue, "one")
    written = os.write

    def half(descriptor, content):
        written(descriptor, bytes(content)[: len(content) // 2])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "write", half)
    for _ in range(2):
        follower.follow()
    monkeypatch.undo()
    add_events(catalogue, "two")
    follower.follow()
    history = read_history(tmp_path)
    assert ([event.kind for event in history.events.values()], history.damage) == (["one", "two"], [])
    assert sum("behind the catalogue" in record.message for record in caplog.records) == 1


def test_a_history_with_more_events_reveals_a_catalogue_that_lost_rows(catalogue, follower, tmp_path):
    add_events(catalogue, "one")
    follower.follow()
    with (tmp_path / HISTORY_FILE).open("ab") as file:
        event = {"id": 2, "utc_ns": 0, "topic": "service", "kind": "two", "payload": {}}
        file.write(encode_history_line(3, "events", event))
    with pytest.raises(CatalogueDamagedError, match=r"knows event 2.*solimon rebuild"):
        HistoryFollower(tmp_path, catalogue).begin()


def test_a_history_of_another_experiment_is_refused_with_both(catalogue, follower, tmp_path):
    path = tmp_path / HISTORY_FILE
    (line,) = path.read_bytes().splitlines()
    experiment = parse_history_lines(line + b"\n").experiment
    row = {name: getattr(experiment, name) for name in experiment.__slots__}
    path.write_bytes(encode_history_line(1, "experiment", {**row, "epoch_utc_ns": 10**18}))
    with pytest.raises(OtherExperimentError, match=r"1970-01-01.*2001-09-09"):
        HistoryFollower(tmp_path, catalogue).begin()


@pytest.mark.parametrize(
    ("last", "is_damage"),
    [
        (b"\0" * 60 + b'e"}}\n', False),  # a page not written because of a power cut
        (b'{"crc32":"00000000","n":2}\n', True),
        (b'{"crc32":"00000000","n":2', False),
    ],
    ids=["with a hole", "changed", "without an end"],
)
def test_only_an_incomplete_last_line_is_no_corruption(last, is_damage):
    first = encode_history_line(1, "files", {"file": "a", "file_sha256": "b"})
    assert bool(parse_history_lines(first + last).damage) is is_damage
    assert parse_history_lines(
        first + last + encode_history_line(3, "files", {"file": "c", "file_sha256": "d"})
    ).damage
