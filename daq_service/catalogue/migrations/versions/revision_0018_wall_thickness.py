"""Table of the wall thickness from solitary waves."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"


def upgrade() -> None:
    """Create the table ``wall``; it is empty."""
    numbers = (
        *("thickness_m", "interval_low_m", "interval_high_m", "loss_rate_m_per_s"),
        *("minimum_m", "below_minimum_probability", "time_to_minimum_s", "time_to_minimum_low_s"),
    )
    op.create_table(
        "wall",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("set_index", sa.Integer(), nullable=False),
        sa.Column("unscheduled_index", sa.Integer(), server_default="0", nullable=False),
        sa.Column("position", sa.String(), nullable=False),
        sa.Column("due_h", sa.Float(), nullable=False),
        sa.Column("extractor_version", sa.String(), nullable=False),
        sa.Column("quality", sa.String(), nullable=False),
        *(sa.Column(name, sa.Float()) for name in numbers),
        sa.Column("reason", sa.String()),
        sa.Column("row_crc32", sa.BigInteger()),
        sa.PrimaryKeyConstraint("id", name="pk_wall"),
        sa.UniqueConstraint(
            "position", "set_index", "unscheduled_index", name="uq_wall_position_set_index_unscheduled_index"
        ),
    )
    op.create_index("ix_wall_set_index", "wall", ["set_index"])
