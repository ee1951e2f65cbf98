"""Give the number of an unscheduled set its own column: it was part of ``set_index``.

SQLite cannot change a unique constraint, so tables with the key are copied. Rows of scheduled sets keep their
checksums, those of unscheduled sets get theirs when all migrations are done (`migrate_schema`).
"""

from __future__ import annotations

import re

import orjson
import sqlalchemy as sa
from alembic import op

from daq_service.catalogue.earlier_names import to_current_row
from daq_service.catalogue.stored_rows import to_json_text

revision = "0016"
down_revision = "0015"

_KEY = "position, set_index, unscheduled_index"
_OF_SETS = ("sets", "shots", "features", "thickness", "assessments")
"""Tables with the key; one that refers to another follows it."""
_SETS_OF_A_PLAN = 10_000_000
"""An unscheduled set had the index of the scheduled one before it and this number times its own number."""
_LARGE = [f'*set_index":{space}{"[0-9]" * 8}*' for space in ("", " ")]
"""JSON texts with such an index."""


def upgrade() -> None:
    """Copy the tables of sets with the new key, and split the set indices of alarms and events.

    Each copy gets column ``unscheduled_index``, its unique constraint and a partial index of unscheduled
    sets.
    """
    indices = [sql for table in _OF_SETS for sql in _list_create_statements("index", table)]
    for table in _OF_SETS:
        _add_unscheduled_column(table, "unscheduled_index")
        (definition,) = _list_create_statements("table", table)
        copy = re.sub(
            rf"CONSTRAINT uq_{table}_\w+ UNIQUE \(position, set_index",
            f"CONSTRAINT uq_{table}_{_KEY.replace(', ', '_')} UNIQUE ({_KEY}",
            definition.replace(table, f"{table}_0016", 1).replace(
                "REFERENCES shots ", "REFERENCES shots_0016 "
            ),
        )
        _execute(copy)
        _execute(f"INSERT INTO {table}_0016 SELECT * FROM {table}")
        _split_set_indices(f"{table}_0016", "set_index", "unscheduled_index")
    for table in reversed(_OF_SETS):
        op.drop_table(table)
    for table in _OF_SETS:
        op.rename_table(f"{table}_0016", table)
    for definition in indices:
        renamed = definition.replace("position_set_index", "position_set_index_unscheduled_index")
        _execute(renamed.replace("(position, set_index", f"({_KEY}"))
    for table in _OF_SETS:
        few = sa.text("unscheduled_index > 0")
        op.create_index(f"ix_{table}_unscheduled", table, _KEY.split(", ")[1:], sqlite_where=few)
    _split_set_keys("alarms", "raised_set_index", "raised_unscheduled_index", "evidence")
    _split_set_keys("events", "set_index", "unscheduled_index", "payload")


def _split_set_keys(table: str, index: str, number: str, nested: str) -> None:
    """Add column ``number`` to a table, split its combined set index, and convert keys in a JSON column.

    ``index`` names the column of the set index, ``nested`` the JSON column. Checksums of changed rows are
    cleared.
    """
    driver = op.get_bind().connection.driver_connection
    assert driver is not None
    driver.create_function("current_json", 1, _to_current_json, deterministic=True)
    _add_unscheduled_column(table, number)
    _split_set_indices(table, index, number)
    has_large = " OR ".join(f"{nested} GLOB '{large}'" for large in _LARGE)
    _execute(f"UPDATE {table} SET {nested} = current_json({nested}), row_crc32 = NULL WHERE {has_large}")


def _to_current_json(text: str) -> str:
    """Convert the combined set numbers in a JSON text to pairs of set index and unscheduled index."""
    return to_json_text(to_current_row("", orjson.loads(text)))


def _add_unscheduled_column(table: str, name: str) -> None:
    """Add an integer column for the number of an unscheduled set, 0 for a scheduled one."""
    op.add_column(table, sa.Column(name, sa.Integer(), nullable=False, server_default="0"))


def _split_set_indices(table: str, index: str, number: str) -> None:
    """Split each combined number in column ``index`` into set index and, for column ``number``, set number.

    The set number is that of an unscheduled set after the scheduled one. Clears the checksums of these rows.
    """
    _execute(
        f"UPDATE {table} SET {number} = {index} / {_SETS_OF_A_PLAN}, {index} = {index} % {_SETS_OF_A_PLAN}, "
        f"row_crc32 = NULL WHERE {index} >= {_SETS_OF_A_PLAN}"
    )


def _list_create_statements(kind: str, table: str) -> list[str]:
    """List the SQL statements that created a table (``kind`` "table") or its indices ("index"), if any."""
    statement = "SELECT sql FROM sqlite_master WHERE type = ? AND tbl_name = ? AND sql IS NOT NULL"
    return [sql for (sql,) in op.get_bind().exec_driver_sql(statement, (kind, table))]


def _execute(statement: str) -> None:
    """Execute a SQL statement unchanged: a colon in it is no parameter."""
    op.get_bind().exec_driver_sql(statement)
