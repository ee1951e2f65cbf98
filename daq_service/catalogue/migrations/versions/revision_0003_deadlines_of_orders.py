"""Orders have a deadline; what an older version left open has none, and the next recorder closes it."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    """Add the deadline of a command by wall clock and by boot clock; both stay NULL in older rows."""
    op.add_column("commands", sa.Column("deadline_wall_utc_ns", sa.BigInteger(), nullable=True))
    op.add_column("commands", sa.Column("deadline_boot_ns", sa.BigInteger(), nullable=True))
    op.add_column("commands", sa.Column("boot_id", sa.String(), nullable=True))
