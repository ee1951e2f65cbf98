"""Orders have a deadline; what an older version left open has none, and the next recorder closes it."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("commands", sa.Column("deadline_wall_utc_ns", sa.BigInteger(), nullable=True))
    op.add_column("commands", sa.Column("deadline_boot_ns", sa.BigInteger(), nullable=True))
    op.add_column("commands", sa.Column("boot_id", sa.String(), nullable=True))


def downgrade() -> None:
    op.drop_column("commands", "boot_id")
    op.drop_column("commands", "deadline_boot_ns")
    op.drop_column("commands", "deadline_wall_utc_ns")
