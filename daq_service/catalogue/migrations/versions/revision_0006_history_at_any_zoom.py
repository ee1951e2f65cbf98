"""Blocks of trends, so that no chart reads a whole test; alarms of a set are found in an index.

The blocks are filled when all migrations are done (`trends.rebuild_trends`).
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Create the index of alarms by set and the empty table ``trend_blocks``."""
    op.create_index("ix_alarms_position_raised_set_index", "alarms", ["position", "raised_set_index"])
    op.create_table(
        "trend_blocks",
        sa.Column("place", sa.String(), nullable=False),
        sa.Column("block", sa.LargeBinary(), nullable=False),
        sa.Column("row_crc32", sa.BigInteger(), nullable=True),
        sa.PrimaryKeyConstraint("place", name=op.f("pk_trend_blocks")),
    )
