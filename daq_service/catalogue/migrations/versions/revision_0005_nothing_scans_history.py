"""Counts are kept instead of counted, and indices find what everyday questions ask for."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"

_INDICES = (
    ("sets", "set_index"),
    ("sets", "due_h"),
    ("sets", "ended_utc_ns"),
    ("sets", "state", "set_index"),
    ("sets", "position", "state", "set_index"),
    ("features", "set_index"),
    ("thickness", "set_index"),
    ("environment", "due_h"),
    ("verdicts", "set_index"),
    ("alarms", "state"),
    ("commands", "state"),
)
_COUNTED = ("sets", "missed_sets", "partial_sets", "shots", "pulse_echo_records", "events")
_TOPICS = ("service", "alarms")
_ECHO_POSITIONS = "SELECT position FROM sets WHERE method = 'pulse_echo'"


def upgrade() -> None:
    """Create indices of everyday queries and table ``counts``, and count the stored rows into it."""
    for table, *columns in _INDICES:
        op.create_index(f"ix_{table}_{'_'.join(columns)}", table, columns)
    for topic in _TOPICS:
        op.create_index(
            f"ix_events_{topic}", "events", ["kind", "position"], sqlite_where=sa.text(f"topic = '{topic}'")
        )
    op.create_table(
        "counts",
        sa.Column("id", sa.Integer(), nullable=False),
        *(sa.Column(name, sa.Integer(), nullable=False) for name in _COUNTED),
        sa.Column("row_crc32", sa.BigInteger(), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_counts")),
    )
    op.execute(
        f"""
        WITH due_times AS (
            SELECT sum(n_taken) AS taken, sum(state IN ('partial', 'missed')) AS lacking,
                   sum(state = 'missed') AS missed
            FROM sets GROUP BY set_index
        )
        INSERT INTO counts SELECT
            1,
            (SELECT count(*) FROM due_times WHERE taken > 0),
            (SELECT count(*) FROM due_times WHERE NOT taken > 0 AND missed > 0),
            (SELECT count(*) FROM due_times WHERE taken > 0 AND lacking > 0),
            (SELECT count(*) FROM shots WHERE position NOT IN ({_ECHO_POSITIONS})),
            (SELECT count(*) FROM shots WHERE position IN ({_ECHO_POSITIONS})),
            (SELECT count(*) FROM events),
            NULL
        """
    )
