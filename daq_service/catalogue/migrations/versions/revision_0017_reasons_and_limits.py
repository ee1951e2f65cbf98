"""Reason of an incomplete set, name of the MEWMA limit, key of a pause.

Rows that change get their checksums when all migrations are done (`migrate_schema`).
"""

from __future__ import annotations

from alembic import op

revision = "0017"
down_revision = "0016"

_WITH_LIMITS = {"baselines": ("limits",), "assessments": ("limits", "averages")}


def upgrade() -> None:
    """Rename the reason of a set, the MEWMA limit and the key of a pause, in columns and JSON."""
    op.execute("ALTER TABLE sets RENAME COLUMN cause TO reason")
    op.execute("UPDATE sets SET row_crc32 = NULL WHERE reason IS NOT NULL")
    for table, names in _WITH_LIMITS.items():
        for name in names:
            _rename_json_key(table, name, "chart", "mewma")
    _rename_json_key("assessor_states", "state", "chart", "mewma")
    # An object of this name is the chart itself, not its limit or average.
    op.execute("""UPDATE assessor_states SET state = replace(state, '"mewma"\\:{', '"chart"\\:{')""")
    op.execute("UPDATE assessments SET limit_name = 'mewma', row_crc32 = NULL WHERE limit_name = 'chart'")
    for name in ("limit_name", "raised_by"):
        _rename_limit_value("alarms", "evidence", name)
        _rename_limit_value("events", "payload", f"evidence.{name}")
    _rename_json_key("events", "payload", "chart", "mewma", "topic = 'assessments'")
    _rename_json_key("events", "payload", "held", "paused", "kind IN ('pause', 'resume')")


def _rename_json_key(table: str, name: str, old: str, new: str, where: str = "1") -> None:
    """Rename a key in a column of JSON text, in the rows that match ``where``; clear their checksums."""
    before, after = f'"{old}"\\:', f'"{new}"\\:'  # the colon of a key, not of a parameter
    op.execute(
        f"UPDATE {table} SET {name} = replace({name}, '{before}', '{after}'), row_crc32 = NULL "
        f"WHERE {name} LIKE '%{before}%' AND {where}"
    )


def _rename_limit_value(table: str, name: str, key: str) -> None:
    """Replace the limit name ``chart`` at a key of a JSON column by ``mewma``; clear the checksums."""
    op.execute(
        f"UPDATE {table} SET {name} = json_set({name}, '$.{key}', 'mewma'), row_crc32 = NULL "
        f"WHERE json_extract({name}, '$.{key}') = 'chart'"
    )
