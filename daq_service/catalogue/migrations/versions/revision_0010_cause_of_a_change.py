"""Columns of the diagnosis of each assessment."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"


def upgrade() -> None:
    """Add the diagnosis of an assessment, its probability and its details; NULL in older rows."""
    op.add_column("verdicts", sa.Column("cause", sa.String(), nullable=True))
    op.add_column("verdicts", sa.Column("cause_probability", sa.Float(), nullable=True))
    op.add_column("verdicts", sa.Column("cause_told", sa.JSON(none_as_null=True), nullable=True))
