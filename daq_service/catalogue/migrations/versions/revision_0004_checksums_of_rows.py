"""Each row carries a checksum, a set the SHA-256 of its file.

Rows of an older catalogue get their checksums when all migrations are done (`migrations.migrate_schema`).
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"

_TABLES = (
    "experiment", "sets", "shots", "features", "thickness", "environment", "baselines", "verdicts", "alarms",
    "events", "commands",
)  # fmt: skip


def upgrade() -> None:
    """Add the column of a checksum to each table and that of the file's SHA-256 to ``sets``, still NULL."""
    op.add_column("sets", sa.Column("file_sha256", sa.String(), nullable=True))
    for name in _TABLES:
        op.add_column(name, sa.Column("row_crc32", sa.BigInteger(), nullable=True))
