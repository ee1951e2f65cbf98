"""Columns of confirmation sets and their results."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"


def upgrade() -> None:
    """Add the purpose of a set and the result of a confirmation set; NULL in older rows."""
    op.add_column("sets", sa.Column("purpose", sa.String(), nullable=True))
    op.add_column("verdicts", sa.Column("confirms", sa.Boolean(), nullable=True))
