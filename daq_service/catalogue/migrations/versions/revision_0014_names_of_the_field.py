"""Names of the field, identity of a test, thickness intervals, states of assessors.

Rows whose names or values change get their checksums when all migrations are done (`migrate_schema`).
"""

from __future__ import annotations

import orjson
import sqlalchemy as sa
from alembic import op

from daq_service.catalogue.earlier_names import COLUMNS, derive_uuid, to_current_row
from daq_service.catalogue.stored_rows import to_json_text

revision = "0014"
down_revision = "0013"

_NESTED = {"baselines": ("baseline_quality",), "assessments": (), "alarms": ("evidence",)}
_VALUES = {"sets": ("state",), "assessments": ("diagnosis",), "alarms": ("kind", "alarm_class")}
_VALUES |= {"commands": ("kind",)}


def upgrade() -> None:
    """Convert names and values of all tables to the current terms; add new columns and a table.

    Adds the UUID and site of the test, thickness intervals and table ``assessor_states``; renames
    ``verdicts`` to ``assessments``. Clears the checksums of the rows that change.
    """
    connection = op.get_bind()
    driver = connection.connection.driver_connection
    assert driver is not None

    def to_current_value(table: str, name: str, value: str | None) -> str | None:
        """Convert one text value of a column to its current name; None stays None."""
        return None if value is None else to_current_row(table, {name: value})[name]

    def to_current_json(table: str, name: str, text: str | None) -> str | None:
        """Convert the keys and values of a JSON column to current names; None stays None."""
        return None if text is None else to_json_text(to_current_row(table, {name: orjson.loads(text)})[name])

    def to_current_event(topic: str, kind: str, payload: str) -> str:
        """Convert the JSON payload of an event to current names; topic and kind may be earlier names."""
        event = {"topic": topic, "kind": kind, "payload": orjson.loads(payload)}
        return to_json_text(to_current_row("events", event)["payload"])

    driver.create_function("current_value", 3, to_current_value, deterministic=True)
    driver.create_function("current_json", 3, to_current_json, deterministic=True)
    driver.create_function("current_event", 3, to_current_event, deterministic=True)
    driver.create_function("derived_uuid", 2, derive_uuid, deterministic=True)
    _rename_assessments()
    for table, columns in COLUMNS.items():
        for old, new in columns.items():
            op.execute(f"ALTER TABLE {table} RENAME COLUMN {old} TO {new}")
    for table, names in _VALUES.items():
        for name in names:
            op.execute(
                f"UPDATE {table} SET {name} = current_value('{table}', '{name}', {name}), row_crc32 = NULL "
                f"WHERE {name} IS NOT current_value('{table}', '{name}', {name})"
            )
    for table, names in _NESTED.items():
        changes = [f"{name} = current_json('{table}', '{name}', {name})" for name in names]
        op.execute(f"UPDATE {table} SET {', '.join([*changes, 'row_crc32 = NULL'])}")
    op.execute(
        "UPDATE events SET payload = current_event(topic, kind, payload), "
        "topic = current_value('events', 'topic', topic), kind = current_value('events', 'kind', kind), "
        "row_crc32 = NULL WHERE topic IN ('sets', 'verdicts', 'alarms', 'service')"
    )
    op.add_column("experiment", sa.Column("uuid", sa.String(), nullable=False, server_default=""))
    op.add_column("experiment", sa.Column("site", sa.String(), nullable=True))
    identity = "derived_uuid(configuration_hash, epoch_utc_ns)"
    op.execute(f"UPDATE experiment SET uuid = {identity}, row_crc32 = NULL")
    for name in ("interval_low_m", "interval_high_m"):
        op.add_column("thickness", sa.Column(name, sa.Float(), nullable=True))
    # The recorder computes the states of an older folder once.
    op.create_table(
        "assessor_states",
        sa.Column("place", sa.String(), nullable=False),
        sa.Column("position", sa.String(), nullable=False),
        sa.Column("baseline_id", sa.Integer(), nullable=True),
        sa.Column("configuration_hash", sa.String(64), nullable=False),
        sa.Column("format", sa.Integer(), nullable=False),
        sa.Column("state", sa.String(), nullable=False),
        sa.Column("row_crc32", sa.BigInteger(), nullable=True),
        sa.PrimaryKeyConstraint("place", name=op.f("pk_assessor_states")),
    )


def _rename_assessments() -> None:
    """Copy table ``verdicts`` to a new table ``assessments``, with its index, and drop the old one.

    A renamed table would keep constraints that are named after ``verdicts``.
    """
    op.create_table(
        "assessments",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("set_index", sa.Integer(), nullable=False),
        sa.Column("position", sa.String(), nullable=False),
        sa.Column("due_h", sa.Float(), nullable=False),
        sa.Column("baseline_id", sa.Integer(), nullable=True),
        sa.Column("in_baseline", sa.Boolean(), nullable=False),
        sa.Column("distance_squared", sa.Float(), nullable=True),
        sa.Column("limit_name", sa.String(), nullable=False),
        sa.Column("limit_f", sa.Float(), nullable=True),
        sa.Column("limit_paper", sa.Float(), nullable=True),
        sa.Column("outlier", sa.Boolean(), nullable=True),
        sa.Column("outlier_paper", sa.Boolean(), nullable=True),
        sa.Column("reason", sa.String(), nullable=True),
        sa.Column("contributions", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("row_crc32", sa.BigInteger(), nullable=True),
        sa.Column("statistics", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("limits", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("averages", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("chart", sa.Float(), nullable=True),
        sa.Column("chart_alarm", sa.Boolean(), nullable=True),
        sa.Column("cause", sa.String(), nullable=True),
        sa.Column("cause_probability", sa.Float(), nullable=True),
        sa.Column("cause_told", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("confirms", sa.Boolean(), nullable=True),
        sa.ForeignKeyConstraint(
            ["baseline_id"], ["baselines.id"], name=op.f("fk_assessments_baseline_id_baselines")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_assessments")),
        sa.UniqueConstraint("position", "set_index", name="uq_assessments_position_set_index"),
    )
    # By name: a folder that 0013 created and one that it migrated differ in the order of their columns.
    names = ", ".join(column["name"] for column in sa.inspect(op.get_bind()).get_columns("assessments"))
    op.execute(f"INSERT INTO assessments ({names}) SELECT {names} FROM verdicts")
    op.drop_table("verdicts")
    op.create_index("ix_assessments_set_index", "assessments", ["set_index"])
