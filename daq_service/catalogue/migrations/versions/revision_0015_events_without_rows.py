"""Events that report a row of a set have no payload; words for rejected commands and lost connections.

Events of earlier versions keep their payload, with the current words.
"""

from __future__ import annotations

from alembic import op

revision = "0015"
down_revision = "0014"

NO_COMMUNICATION = ("lost", "no_communication")
_QUALITIES = ("supply_quality", "climate_quality")


def upgrade() -> None:
    """Replace the values "refused" and "lost" by "rejected" and "no_communication".

    Changes states of commands and qualities of supply and climate, in columns, evidence and event payloads.
    """
    _replace_column_value("commands", "state", "refused", "rejected")
    for name in _QUALITIES:
        _replace_column_value("environment", name, *NO_COMMUNICATION)
        _replace_json_value("alarms", "evidence", name, *NO_COMMUNICATION)
        for key in (name, f"evidence.{name}"):
            _replace_json_value("events", "payload", key, *NO_COMMUNICATION)


def _replace_column_value(table: str, name: str, old: str, new: str) -> None:
    """Replace the value ``old`` of a column by ``new`` and clear the checksums of these rows."""
    op.execute(f"UPDATE {table} SET {name} = '{new}', row_crc32 = NULL WHERE {name} = '{old}'")


def _replace_json_value(table: str, name: str, key: str, old: str, new: str) -> None:
    """Replace the value ``old`` at the path ``key`` of a JSON column by ``new``.

    Clears the checksums of the changed rows.
    """
    op.execute(
        f"UPDATE {table} SET {name} = json_set({name}, '$.{key}', '{new}'), row_crc32 = NULL "
        f"WHERE json_extract({name}, '$.{key}') = '{old}'"
    )
