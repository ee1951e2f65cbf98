"""Alarms that a person shelved, or took out of service."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"

TEXTS = ("suppressed", "suppressed_by", "suppressed_because")
TIMES = ("shelved_until_utc_ns", "shelved_until_wall_utc_ns")


def upgrade() -> None:
    """Add the suppression of an alarm: kind, person, reason and end of the shelving in ns.

    All are NULL in older rows.
    """
    for name in TEXTS:
        op.add_column("alarms", sa.Column(name, sa.String(), nullable=True))
    for name in TIMES:
        op.add_column("alarms", sa.Column(name, sa.BigInteger(), nullable=True))
