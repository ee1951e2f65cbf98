"""The migrations make exactly the tables that the code describes."""

import json
import re
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory
from sqlalchemy import event

import daq_service.catalogue.migrations as migrations
from daq_service.catalogue import connection, open_catalogue, stored_rows
from daq_service.catalogue.earlier_names import derive_uuid, to_current_row
from daq_service.catalogue.errors import CatalogueError, SchemaVersionError
from daq_service.catalogue.rows import (
    AlarmRow,
    AssessmentRow,
    AssessorStateRow,
    BaselineRow,
    CommandRow,
    EnvironmentRow,
    EventRow,
    FeatureRow,
    SetRow,
    ShotRow,
    ThicknessRow,
    as_dict,
)
from daq_service.catalogue.stored_rows import compute_row_crc32
from daq_service.commands.deadline import read_command_state
from daq_service.settings.alarm_delays import EARLIER_ALARM_KINDS
from daq_service.settings.notifications import RuleSettings
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import SetKey

EARLIER = json.loads(
    (Path(__file__).parents[3] / "fixtures" / "earlier_catalogues.json").read_text(encoding="utf-8")
)
"""Rows as recorders of earlier schemas stored them, and what they are called now."""


def schema_of(path):
    """Return the definition of every table and index as text without layout."""
    database = sqlite3.connect(path)
    rows = database.execute("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL").fetchall()
    database.close()
    return {
        name: re.sub(r"\s+", " ", sql)
        .replace('"', "")
        .replace("( ", "(")
        .replace(" )", ")")
        .replace(" ,", ",")
        for name, sql in rows
        if name != "alembic_version" and not name.startswith("sqlite_")
    }


def columns_and_constraints(sql):
    """Return the parts of a definition sorted, as constraints may be anywhere."""
    first, last = sql.index("("), sql.rindex(")")
    # A comma inside a pair of brackets separates nothing.
    return sql[:first], sorted(re.split(r", (?![^(]*\))", sql[first + 1 : last])), sql[last:]


def upgrade(path, revision):
    """Migrate a file to a revision by the migrations alone."""
    engine = connection.create_sqlite_engine(path, writable=True)
    config = Config()
    config.set_main_option("script_location", str(Path(migrations.__file__).parent))
    with stored_rows.begin_write(engine) as opened:
        config.attributes["connection"] = opened
        command.upgrade(config, revision)
    engine.dispose()


def test_migrated_and_described_schema_are_the_same(tmp_path):
    """A new catalogue is created as described, an older one is migrated."""
    open_catalogue(tmp_path, writer=True).close()
    upgrade(tmp_path / "migrated.sqlite", "head")
    migrated = schema_of(tmp_path / "migrated.sqlite")
    expected = schema_of(tmp_path / "catalogue.sqlite")
    assert migrated.keys() == expected.keys()
    for name in expected:
        assert columns_and_constraints(migrated[name]) == columns_and_constraints(expected[name]), name
    version = "SELECT sql FROM sqlite_master WHERE name = 'alembic_version'"
    versions = []
    for name in ("migrated.sqlite", "catalogue.sqlite"):
        with closing(sqlite3.connect(tmp_path / name)) as opened:
            ((sql,),) = opened.execute(version)
            versions.append(("".join(sql.split()), *opened.execute("SELECT * FROM alembic_version")))
    assert versions[0] == versions[1]


def test_the_revision_the_code_expects_is_the_only_newest():
    config = Config()
    config.set_main_option("script_location", str(Path(migrations.__file__).parent))
    assert ScriptDirectory.from_config(config).get_heads() == [migrations.SCHEMA_REVISION]


def test_opening_again_migrates_nothing(tmp_path, monkeypatch):
    open_catalogue(tmp_path, writer=True).close()

    def refuse(*arguments):
        raise AssertionError("migrated a current catalogue")

    monkeypatch.setattr("daq_service.catalogue.store.migrate_schema", refuse)
    open_catalogue(tmp_path, writer=True).close()


def test_migrations_are_found_from_any_working_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    open_catalogue(Path(), writer=True).close()
    assert "shots" in schema_of(tmp_path / "catalogue.sqlite")


def make_first_catalogue(path):
    """Fill a catalogue of revision 0001 as the recorder of that version left it."""
    upgrade(path, "0001")
    rows = {table: [tuple(row) for row in rows] for table, rows in EARLIER["0001"].items()}
    with sqlite3.connect(path) as database:
        for table, values in rows.items():
            marks = ", ".join("?" * len(values[0]))
            database.executemany(f"INSERT INTO {table} VALUES ({marks})", values)
    database.close()
    return rows


def rows_of(path, table, columns="*"):
    database = sqlite3.connect(path)
    found = database.execute(f"SELECT {columns} FROM {table} ORDER BY 1").fetchall()
    database.close()
    return found


def test_a_filled_catalogue_of_revision_0001_keeps_its_rows(tmp_path):
    path = tmp_path / "catalogue.sqlite"
    before = make_first_catalogue(path)
    with pytest.raises(SchemaVersionError, match="schema 0001"):
        open_catalogue(tmp_path)
    open_catalogue(tmp_path, writer=True).close()
    before["alarms"] = [(*before["alarms"][0][:2], "no_reflection", *before["alarms"][0][3:])]
    for table, rows in before.items():
        # New columns are at the end.
        assert [row[: len(rows[0])] for row in rows_of(path, table)] == rows, table
    # In an old row no shot was repeated, and all records count.
    assert rows_of(path, "sets", "n_missed, n_restrikes") == [(0, 0)] * 2
    assert rows_of(path, "shots", "outcome") == [("accepted",)] * 2
    assert rows_of(path, "alembic_version") == [(migrations.SCHEMA_REVISION,)]
    assert rows_of(path, "experiment", "uuid, site") == [(derive_uuid("ab" * 32, 0), None)]
    with open_catalogue(tmp_path) as catalogue:
        assert catalogue.rows(EnvironmentRow) == []
        # A command from before the update is not executed.
        order, left_s = read_command_state(catalogue, 5)
        assert (order.state, left_s) == ("expired", 0.0)
        assert [row.outcome for row in catalogue.rows(ShotRow, position="B", set_index=0)] == ["accepted"] * 2


def test_every_earlier_kind_of_alarm_and_its_settings_have_current_names():
    assert not EARLIER_ALARM_KINDS.keys() & set(EARLIER_ALARM_KINDS.values())
    rule = RuleSettings.model_validate({"severity": "high", "kinds": ["hole"]})
    assert (rule.priority, rule.kinds) == ("high", ("no_reflection",))
    assert Settings(alarms={"kinds": {"thickness": {"on_delay_s": 60.0}}}).alarms.kinds.keys() == {
        "thickness_low"
    }


def insert(database, table, **values):
    stored = [json.dumps(value) if isinstance(value, dict | list) else value for value in values.values()]
    marks = ", ".join("?" * len(stored))
    database.execute(f"INSERT INTO {table} ({', '.join(values)}) VALUES ({marks})", stored)


@pytest.mark.parametrize("created", [False, True], ids=["migrated to 0013", "created by 0013"])
def test_a_catalogue_of_revision_0013_is_read_with_the_names_of_the_field(tmp_path, created):
    path, earlier = tmp_path / "catalogue.sqlite", EARLIER["0013"]
    upgrade(path, "0013")
    with closing(sqlite3.connect(path)) as database, database:
        if created:  # its columns stand in another order: the checksum is the last
            names = [name for _, name, *_ in database.execute("PRAGMA table_info(verdicts)")]
            names.append(names.pop(names.index("row_crc32")))
            database.execute(f"CREATE TABLE copied AS SELECT {', '.join(names)} FROM verdicts")
            database.execute("DROP TABLE verdicts")
            database.execute("ALTER TABLE copied RENAME TO verdicts")
        insert(database, "experiment", id=1, name="t", configuration_hash="ab", configuration={},
               created_utc_ns=1, epoch_utc_ns=7, clock="wall", solimon_version="0")  # fmt: skip
        for table, row in earlier["rows"].items():
            insert(database, table, **row)
        for number, (topic, kind, payload) in enumerate(earlier["events"], start=1):
            insert(database, "events", id=number, utc_ns=1, wall_utc_ns=2, topic=topic, kind=kind,
                   payload=payload)  # fmt: skip
        insert(database, "commands", id=1, wall_utc_ns=1, author="ann", kind="retire", arguments={},
               state="refused")  # fmt: skip
    open_catalogue(tmp_path, writer=True).close()
    with open_catalogue(tmp_path) as catalogue:  # which compares every row with its checksum
        (alarm,) = catalogue.rows(AlarmRow)
        assert {name: getattr(alarm, name) for name in earlier["current_alarm"]} == earlier["current_alarm"]
        (baseline,) = catalogue.rows(BaselineRow)
        assert (baseline.limit_f_predictive, baseline.limit_mean_3sd) == (24.0, 30.0)
        assert baseline.baseline_quality == {"rate_verified": True, "default_reason": ""}
        assert (baseline.state, baseline.retired_reason) == ("retired", "coupled anew")
        (assessment,) = catalogue.rows(AssessmentRow)
        assert (assessment.diagnosis, assessment.diagnosis_details) == (
            "undetermined",
            {"probabilities": {"wall": 0.97}},
        )
        assert (assessment.mewma_statistic, assessment.mewma_alarm) == (72.0, True)
        assert (assessment.outlier, assessment.outlier_mean_3sd) == (True, False)
        (its_set,) = catalogue.rows(SetRow)
        assert its_set.state == "disabled"
        (command,) = catalogue.rows(CommandRow)
        assert (command.kind, command.state) == ("disable", "rejected")
        events = catalogue.rows(EventRow)
        assert [(event.topic, event.kind) for event in events] == [
            *(("sets", "set_disabled"), ("assessments", "set_assessed"), ("assessments", "baseline_retired")),
            *(("alarms", "alarm_reactivated"), ("service", "pause"), ("service", "confirmation_asked")),
            ("environment", "environment"),
        ]
        assert events[0].payload["state"] == "disabled"
        assert events[1].payload["diagnosis"] == "undetermined"
        assert events[2].payload["retired_reason"] == "coupled anew"
        assert events[2].payload["state"] == "retired"
        assert events[3].payload == earlier["current_alarm"]
        assert events[5].payload["reason"] == "x"
        assert events[6].payload["supply_quality"] == "no_communication"
        assert catalogue.read_experiment().uuid == derive_uuid("ab", 7)
        # A line of the history is the same row, and a current row stays as it is.
        for event, (topic, kind, payload) in zip(events, earlier["events"], strict=True):
            line = {**as_dict(event), "topic": topic, "kind": kind, "payload": payload}
            assert (
                to_current_row("events", line) == as_dict(event) == to_current_row("events", as_dict(event))
            )


NUMBER = 20_000_003
"""Set 3.2 in schema 0015 and earlier."""


SET_0015 = EARLIER["0015"]["set"]


def insert_first_set(database, crc32):
    """Insert a test and its set 3 at position B."""
    insert(database, "experiment", id=1, name="t", configuration_hash="ab", configuration={}, uuid="u",
           created_utc_ns=1, epoch_utc_ns=7, clock="wall", solimon_version="0")  # fmt: skip
    insert(database, "sets", id=1, set_index=3, position="B", due_h=1.5, row_crc32=crc32, **SET_0015)


def test_an_unscheduled_set_of_revision_0015_gets_its_own_column(tmp_path):
    path, earlier = tmp_path / "catalogue.sqlite", EARLIER["0015"]
    upgrade(path, "0015")
    scheduled = SetRow(id=1, set_index=3, position="B", due_h=1.5, **SET_0015)
    crc32 = compute_row_crc32(scheduled)
    with closing(sqlite3.connect(path)) as database, database:
        insert_first_set(database, crc32)
        for number, (table, row) in enumerate(earlier["rows"].items(), start=2):
            key = {"sequence": 7} if table == "shots" else {"id": number}
            reference = {"sequence": 7} if table in ("features", "thickness") else {}
            insert(database, table, **key, **reference, set_index=NUMBER, position="B", **row)
        insert(
            database,
            "alarms",
            id=1,
            raised_set_index=NUMBER,
            evidence={"set_index": NUMBER},
            **EARLIER["0015"]["alarm"],
        )
        for number, (topic, kind, payload) in enumerate(earlier["events"], start=1):
            insert(database, "events", id=number, utc_ns=1, wall_utc_ns=2, topic=topic, kind=kind,
                   payload=payload, set_index=NUMBER)  # fmt: skip
    open_catalogue(tmp_path, writer=True).close()
    assert rows_of(path, "sets", "row_crc32")[0] == (crc32,), "the row of a scheduled set stays as it is"
    with open_catalogue(tmp_path) as catalogue:  # which compares every row with its checksum
        assert catalogue.rows(SetRow) == [scheduled]
        for kind in (SetRow, ShotRow, FeatureRow, ThicknessRow, AssessmentRow):
            (row,) = catalogue.rows(kind, purpose="confirmation")
            assert row.set_key == SetKey(3, 2)
            assert catalogue.rows(kind, set_index=3, unscheduled_index=2) == [row]
        (alarm,) = catalogue.rows(AlarmRow)
        assert alarm.raised_set_key == SetKey(3, 2)
        assert alarm.evidence == {"set_index": 3, "unscheduled_index": 2}
        events = catalogue.rows(EventRow)
        assert [event.set_key for event in events] == [SetKey(3, 2)] * 3
        assert [event.payload for event in events] == earlier["current_payloads"]
        for event, (topic, kind, payload) in zip(events, earlier["events"], strict=True):
            line = {
                **as_dict(event),
                "topic": topic,
                "kind": kind,
                "payload": payload,
                "set_index": NUMBER,
            }
            del line["unscheduled_index"]
            assert EventRow(**to_current_row("events", line)) == event, (
                "a line of the history is the same row"
            )


STATES_0016 = {
    "B/running": '{"averages":{"chart":[0.25]}}',
    "B/frozen": '{"limits":{"chart":59.0},"chart":{"mean":0}}',
}
"""An object `chart` is the chart itself."""


def test_reasons_limits_and_pauses_of_revision_0016_have_current_names(tmp_path):
    path, earlier = tmp_path / "catalogue.sqlite", EARLIER["0016"]
    upgrade(path, "0016")
    done = SetRow(id=1, set_index=3, position="B", due_h=1.5, **SET_0015)
    crc32 = compute_row_crc32(done)
    with closing(sqlite3.connect(path)) as database, database:
        insert_first_set(database, crc32)
        insert(database, "sets", id=2, set_index=4, position="B", due_h=2.0, cause="no trigger", **SET_0015)
        insert(
            database,
            "assessments",
            id=1,
            set_index=3,
            position="B",
            **EARLIER["0015"]["rows"]["assessments"],
            **earlier["assessment"],
        )
        insert(database, "alarms", id=1, evidence=earlier["evidence"], **EARLIER["0015"]["alarm"])
        for place, state in STATES_0016.items():
            insert(database, "assessor_states", place=place, position="B", configuration_hash="ab",
                   format=1, state=state)  # fmt: skip
        for number, (topic, kind, payload) in enumerate(earlier["events"], start=1):
            insert(database, "events", id=number, utc_ns=1, wall_utc_ns=2, topic=topic, kind=kind,
                   payload=payload)  # fmt: skip
    open_catalogue(tmp_path, writer=True).close()
    assert rows_of(path, "sets", "id, row_crc32")[0] == (1, crc32), "the row of a complete set stays as it is"
    with open_catalogue(tmp_path) as catalogue:  # which compares every row with its checksum
        assert [row.reason for row in catalogue.rows(SetRow)] == [None, "no trigger"]
        (assessment,) = catalogue.rows(AssessmentRow)
        assert (assessment.limit_name, assessment.limits) == ("mewma", {"mewma": 59.0})
        assert assessment.averages == {"mewma_textbook": [0.5], "mewma": [0.25]}
        (alarm,) = catalogue.rows(AlarmRow)
        assert alarm.evidence == {"limit_name": "mewma", "raised_by": "mewma", "limit": 59.0}
        assert {row.place: row.state for row in catalogue.rows(AssessorStateRow)} == {
            "B/running": '{"averages":{"mewma":[0.25]}}',
            "B/frozen": '{"limits":{"mewma":59.0},"chart":{"mean":0}}',
        }
        assert catalogue.paused() == "held by ann: door open"
        events = catalogue.rows(EventRow)
        for event, (topic, kind, payload) in zip(events[:3], earlier["events"], strict=False):
            line = {**as_dict(event), "topic": topic, "kind": kind, "payload": payload}
            assert EventRow(**to_current_row("events", line)) == event, (
                "a line of the history is the same row"
            )
        assert to_current_row("sets", earlier["events"][3][2]) == {"reason": "no trigger"}


def test_an_interrupted_migration_leaves_a_filled_catalogue_unchanged(tmp_path):
    path = tmp_path / "catalogue.sqlite"
    before = make_first_catalogue(path)
    schema = schema_of(path)
    engine = connection.create_sqlite_engine(path, writable=True)

    @event.listens_for(engine, "before_cursor_execute")
    def cut(_connection, _cursor, sql, *_rest):
        if sql.lstrip().upper().startswith("CREATE TABLE ENVIRONMENT"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        migrations.migrate_schema(engine, path, "0001")
    engine.dispose()
    assert schema_of(path) == schema
    assert rows_of(path, "sets") == before["sets"]
    open_catalogue(tmp_path, writer=True).close()
    assert rows_of(path, "alembic_version") == [(migrations.SCHEMA_REVISION,)]


@pytest.mark.parametrize("statement", [1, 5, 10, 14])
def test_an_interrupted_migration_leaves_no_tables(tmp_path, statement):
    engine = connection.create_sqlite_engine(tmp_path / "catalogue.sqlite", writable=True)
    seen = 0

    @event.listens_for(engine, "before_cursor_execute")
    def cut(_connection, _cursor, sql, *_rest):
        nonlocal seen
        seen += sql.lstrip().upper().startswith(("CREATE", "INSERT"))
        if seen > statement:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        migrations.migrate_schema(engine, tmp_path / "catalogue.sqlite", None)
    engine.dispose()
    assert schema_of(tmp_path / "catalogue.sqlite") == {}
    open_catalogue(tmp_path, writer=True).close()
    assert "shots" in schema_of(tmp_path / "catalogue.sqlite")


@pytest.mark.parametrize("writer", [False, True])
def test_a_catalogue_of_a_newer_version_is_rejected_and_unchanged(tmp_path, writer):
    open_catalogue(tmp_path, writer=True).close()
    path = tmp_path / "catalogue.sqlite"
    database = sqlite3.connect(path)
    with database:
        database.execute("UPDATE alembic_version SET version_num = '9999'")
    database.close()
    before = schema_of(path)
    with pytest.raises(SchemaVersionError, match="schema 9999"):
        open_catalogue(tmp_path, writer=writer)
    assert schema_of(path) == before
    assert issubclass(SchemaVersionError, CatalogueError)


def test_reading_needs_no_alembic_and_the_network_check_no_sql():
    program = (
        "import sys; import daq_service.catalogue.network_folder; assert 'sqlalchemy' not in sys.modules;"
        "import daq_service.catalogue.store; assert 'sqlalchemy' in sys.modules;"
        "assert 'alembic' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)
