"""Table of the states of assessors; the recorder computes those of an older folder once."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"


def upgrade() -> None:
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
