"""The migrations make exactly the tables that the code describes, or nothing."""

import re
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import create_engine, event

import daq_service.catalogue.migrations as migrations
from daq_service.catalogue import connection, open_catalogue
from daq_service.catalogue.errors import CatalogueError, SchemaVersionError
from daq_service.catalogue.tables import metadata


def schema_of(path):
    """Definition of every table and index as text without layout."""
    database = sqlite3.connect(path)
    rows = database.execute("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL").fetchall()
    database.close()
    return {
        name: re.sub(r"\s+", " ", sql).replace('"', "").replace("( ", "(").replace(" )", ")")
        for name, sql in rows
        if name != "alembic_version" and not name.startswith("sqlite_")
    }


def columns_and_constraints(sql):
    """Parts of a definition in any order: constraints may stand where they like."""
    first, last = sql.index("("), sql.rindex(")")
    # A comma inside a pair of brackets separates nothing.
    return sql[:first], sorted(re.split(r", (?![^(]*\))", sql[first + 1 : last])), sql[last:]


def test_migrated_and_described_schema_are_the_same(tmp_path):
    open_catalogue(tmp_path, writer=True).close()
    described = tmp_path / "described.sqlite"
    engine = create_engine(f"sqlite:///{described}")
    metadata.create_all(engine)
    engine.dispose()
    migrated = schema_of(tmp_path / "catalogue.sqlite")
    expected = schema_of(described)
    assert migrated.keys() == expected.keys()
    for name in expected:
        assert columns_and_constraints(migrated[name]) == columns_and_constraints(expected[name]), name


def test_alembic_finds_no_difference_either(tmp_path):
    open_catalogue(tmp_path, writer=True).close()
    engine = create_engine(f"sqlite:///{tmp_path / 'catalogue.sqlite'}")
    with engine.connect() as opened:
        context = MigrationContext.configure(opened, opts={"compare_type": True})
        assert compare_metadata(context, metadata) == []
    engine.dispose()


def test_the_revision_the_code_expects_is_the_only_newest():
    config = Config()
    config.set_main_option("script_location", str(Path(migrations.__file__).parent))
    assert ScriptDirectory.from_config(config).get_heads() == [migrations.SCHEMA_REVISION]


def test_opening_again_migrates_nothing(tmp_path, monkeypatch):
    open_catalogue(tmp_path, writer=True).close()

    def refuse(*arguments):
        raise AssertionError("migrated a current catalogue")

    monkeypatch.setattr("daq_service.catalogue.store.migrate", refuse)
    open_catalogue(tmp_path, writer=True).close()


def test_migrations_are_found_from_any_working_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    open_catalogue(Path(), writer=True).close()
    assert "shots" in schema_of(tmp_path / "catalogue.sqlite")


@pytest.mark.parametrize("statement", [1, 5, 10, 14])
def test_a_migration_that_is_cut_short_leaves_nothing(tmp_path, statement):
    engine = connection.make_engine(tmp_path / "catalogue.sqlite", writable=True)
    seen = 0

    @event.listens_for(engine, "before_cursor_execute")
    def cut(_connection, _cursor, sql, *_rest):
        nonlocal seen
        seen += sql.lstrip().upper().startswith(("CREATE", "INSERT"))
        if seen > statement:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        migrations.migrate(engine, tmp_path / "catalogue.sqlite", None)
    engine.dispose()
    assert schema_of(tmp_path / "catalogue.sqlite") == {}
    open_catalogue(tmp_path, writer=True).close()
    assert "shots" in schema_of(tmp_path / "catalogue.sqlite")


@pytest.mark.parametrize("writer", [False, True])
def test_a_catalogue_of_a_newer_version_is_refused_and_left_alone(tmp_path, writer):
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
