"""A row of a set is stored once: its event holds no copy, and every reader gets the row with the event."""

import sqlite3
from contextlib import closing
from dataclasses import replace

import pytest
from sqlalchemy import event
from support.table_rows import execute, table_rows

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.corruption import find_catalogue_corruption
from daq_service.catalogue.errors import CatalogueDamagedError
from daq_service.catalogue.history import describe_lost_newest_event, read_history
from daq_service.catalogue.reported_rows import ROW_OF_EVENT, to_payload
from daq_service.catalogue.rows import MEASURED, AlarmRow, AssessmentRow, EventRow, FeatureRow
from daq_service.catalogue.salvage import read_sound_rows
from daq_service.catalogue.trends import compute_trend_part
from daq_service.recording.reassessment.rebuild import rebuild_folder_catalogue


def row_key(row):
    return type(row), row.position, row.set_index


def test_an_event_of_a_set_is_stored_without_its_row_and_read_with_it(life):
    with life.catalogue() as catalogue:
        events = catalogue.rows(EventRow)
        rows = {
            row_key(row): row
            for kind in set(ROW_OF_EVENT.values())
            for row in catalogue.rows(kind, **({"scope": "set"} if kind is FeatureRow else {}))
            if hasattr(row, "position")
        }
    stored = {row[0]: row[-2] for row in table_rows(life.folder, "events")["events"]}
    of_rows = [row for row in events if row.kind in ROW_OF_EVENT]
    final = [row for row in of_rows if not row.payload.get("in_baseline")]
    assert {row.kind for row in final} >= ROW_OF_EVENT.keys() - {"environment_read", "wall_estimated"}
    assert {stored[row.id] for row in final} == {"{}"}
    for row in final:
        assert row.payload == to_payload(rows[ROW_OF_EVENT[row.kind], row.position, row.set_index])
        assert row.payload.keys() == set(ROW_OF_EVENT[row.kind].__slots__) - {"id"}


def test_an_event_whose_row_changes_later_keeps_what_was_reported(life):
    with life.catalogue() as catalogue:
        assessed = catalogue.rows(EventRow, topic="assessments", kind="set_assessed", position="B")
        first, row = assessed[0], catalogue.rows(AssessmentRow, position="B")[0]
        alarm_events = catalogue.rows(EventRow, topic="alarms")
        states = {alarm.id: alarm.state for alarm in catalogue.rows(AlarmRow)}
    assert (first.set_index, row.set_index) == (0, 0)
    assert first.payload["baseline_id"] is None
    assert row.baseline_id is not None
    alarm_events = [item for item in alarm_events if "alarm_id" in item.payload]
    changed = [item for item in alarm_events if item.payload["state"] != states[item.payload["alarm_id"]]]
    assert {item.kind for item in changed} >= {"alarm_raised"}


def test_lines_of_the_history_hold_the_rows(life):
    with life.catalogue() as catalogue:
        events = {row.id: row for row in catalogue.rows(EventRow)}
    assert read_history(life.folder).events == events


def test_a_start_accepts_a_history_whose_newest_row_has_changed_since(line):
    history = read_history(line.folder)
    with line.catalogue() as catalogue:
        newest = max(row.id for row in catalogue.rows(EventRow) if row.kind == "set_assessed")
        history.events = {number: row for number, row in history.events.items() if number <= newest}
        history.events[newest] = replace(history.events[newest], payload={"in_baseline": True})
        assert describe_lost_newest_event(history, catalogue) == ""
        history.events[newest] = replace(history.events[newest], wall_utc_ns=1)
        assert "has lost rows" in describe_lost_newest_event(history, catalogue)


def test_an_event_whose_row_is_lost_is_reported_and_rebuilt_from_the_history(line):
    before = table_rows(line.folder)
    execute(line.folder, "DELETE FROM assessments WHERE position = 'B' AND NOT in_baseline")
    with (
        open_catalogue(line.folder) as catalogue,
        pytest.raises(CatalogueDamagedError, match="lacks its row"),
    ):
        catalogue.rows(EventRow)
    lost = [found for found in find_catalogue_corruption(line.folder) if found.table == "events"]
    assert lost
    assert all("lacks its row of table assessments" in found.description for found in lost)
    sound = read_sound_rows(line.folder).events
    assert not sound.keys() & {found.row_id for found in lost}
    rebuild_folder_catalogue(line.folder, features_of=line.features_of)
    assert table_rows(line.folder) == before


def test_a_page_of_events_reads_each_table_once(life):
    with life.catalogue() as catalogue:
        statements = []

        @event.listens_for(catalogue._engine, "before_cursor_execute")
        def count(connection, cursor, sql, *_rest):
            statements.append(sql)

        page = catalogue.read_events_after(0, limit=500)
    kinds = {ROW_OF_EVENT[row.kind] for row in page if row.kind in ROW_OF_EVENT}
    assert len({row.set_index for row in page}) > 10
    assert len([sql for sql in statements if sql.startswith("SELECT")]) == 1 + len(kinds)


OF_SETS, EVERY = "uq_features_set", "ix_features_position_set_index_unscheduled_index_shot_index"
"""Indices of features."""


def corrupt(line, name, columns, other):
    """Make an index of features lead to the first shot of each set instead of the set."""
    with closing(sqlite3.connect(line.folder / FILE_NAME)) as database, database:
        (sql,) = database.execute("SELECT sql FROM sqlite_master WHERE name = ?", (name,)).fetchone()
        assert columns in sql
        database.execute(f"DROP INDEX {name}")
        database.execute(sql.replace("UNIQUE ", "").replace(columns, other))
        database.execute("PRAGMA writable_schema = ON")
        database.execute("UPDATE sqlite_master SET sql = ? WHERE name = ?", (sql, name))


def test_a_corrupt_index_does_not_give_the_row_of_a_shot_to_the_event_of_a_set(line):
    """SQLite does not compare the rows that a partial index leads to with its condition."""
    corrupt(line, OF_SETS, "shot_index IS NULL", "shot_index = 0")
    with line.catalogue() as catalogue, pytest.raises(CatalogueDamagedError, match="lacks its row"):
        catalogue.rows(EventRow, topic="features")


@pytest.mark.parametrize(
    "read",
    [
        lambda catalogue: catalogue.rows(FeatureRow, position="B", scope="set"),
        lambda catalogue: catalogue.read_last_rows(FeatureRow, "B", 1, scope="set"),
        lambda catalogue: catalogue.columns(FeatureRow, ["id"], position="B", scope="set"),
        lambda catalogue: compute_trend_part(
            catalogue, "B", MEASURED[FeatureRow][0], first_h=None, last_h=None
        ),
    ],
    ids=["rows", "last_rows", "columns", "trend"],
)
def test_a_corrupt_index_does_not_give_the_row_of_a_shot_for_that_of_a_set(line, read):
    corrupt(line, OF_SETS, "shot_index IS NULL", "shot_index = 0")
    with (
        line.catalogue() as catalogue,
        pytest.raises(CatalogueDamagedError, match="index of table features is corrupt"),
    ):
        read(catalogue)


def test_a_corrupt_index_does_not_give_the_row_of_a_shot_for_the_newest_of_a_position(line):
    corrupt(line, EVERY, "shot_index)", "iif(shot_index IS NULL, 0, nullif(shot_index, 0)))")
    with (
        line.catalogue() as catalogue,
        pytest.raises(CatalogueDamagedError, match="index of table features is corrupt"),
    ):
        catalogue.read_latest_rows()
