"""The life of a baseline: its state, who signed or retired it, and when.

Those of an earlier version were approved automatically as they were frozen.
"""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0010"

ADDED: dict[str, sa.types.TypeEngine[Any]] = {
    "approved_utc_ns": sa.BigInteger(),
    "retired_utc_ns": sa.BigInteger(),
    "retired_by": sa.String(),
    "retired_because": sa.String(),
}


def upgrade() -> None:
    """Add state, approval and retirement of a baseline; stored baselines become approved."""
    op.add_column("baselines", sa.Column("state", sa.String(), nullable=False, server_default="approved"))
    for name, of_type in ADDED.items():
        op.add_column("baselines", sa.Column(name, of_type, nullable=True))
    op.execute("UPDATE baselines SET approved_utc_ns = created_utc_ns, row_crc32 = NULL")
